"""`ha2g web` writes, atomically, a folder that any static host can serve, and says what it lacks."""

import json
import os
import pathlib
import re
import tomllib

import pytest

from ha2g_jax import cli
from ha2g_jax.apps.web import site as site_module
from ha2g_jax.apps.web.site import write_site
from ha2g_jax.errors import UserError

ROOT = pathlib.Path(__file__).parents[3]


@pytest.fixture
def program(tmp_path, monkeypatch):
    """A function from a name and a line of shell to a program of that name, the only programs beside those of /bin."""
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    (tmp_path / "bin").mkdir()

    def program(name, line):
        (tmp_path / "bin" / name).write_text(f"#!/bin/sh\n{line}\n")
        (tmp_path / "bin" / name).chmod(0o755)

    return program


def test_the_site_has_what_the_page_asks_for(site):
    page = (site / "index.html").read_text()
    asked = set(re.findall(r'(?:src|href)="([^"]+)"', page))
    assert {"app.js", "three.min.js", "viewer.js", "style.css"} < asked
    assert [name for name in asked if not (site / name).is_file()] == []
    for name in ("worker.js", "vrm.js", "sw.js", "ort.wasm.gz", "model/model.json", "model/figure.glb", "hello.wav"):
        assert (site / name).is_file(), name
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy and "default-src 'none'" in policy[1]
    assert "unsafe-inline" not in page and "unsafe-eval'" not in policy[1].replace("'wasm-unsafe-eval'", "")
    assert not re.search(r"<script(?![^>]*src)|<style|\son\w+=|style=", page)


def test_every_file_is_kept_for_use_offline(site):
    (text,) = re.findall(r"\Aself\.FILES = (.*);\n", (site / "sw.js").read_text())
    hashes = json.loads(text)
    files = {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()}
    assert set(hashes) == files - {"sw.js", "site.json"}
    assert all(value.startswith("sha256-") for value in hashes.values())
    assert set(json.loads((site / "site.json").read_text())["files"]) == files


def test_licences_of_all_parts_are_there(site):
    text = (site / "LICENSES.txt").read_text()
    parts = "ha2g-web", "three.js r130", "onnxruntime-web", "@pixiv/three-vrm", "Apache License", "WITHOUT WARRANTY"
    assert all(part in text for part in parts)


def test_a_site_takes_the_place_of_a_site_and_of_nothing_else(site, tmp_path, capsys):
    out = tmp_path / "site"
    assert cli.main(["web", "demo", "-o", str(out), "--weights", "int8"]) == 0
    first = (out / "model" / "model.onnx").stat().st_size
    write_site("demo", out, weights="float16")
    assert (out / "model" / "model.onnx").stat().st_size > first
    assert oct(out.stat().st_mode)[-3:] == "755"
    (out / "CNAME").write_text("example.org")
    with pytest.raises(UserError, match="has CNAME, which ha2g web has not written"):
        write_site("demo", out)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").touch()
    assert cli.main(["web", "-o", str(tmp_path / "photos")]) == 2
    assert "photos exists and is not a site" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photos", "site"]


def test_nothing_is_left_of_a_site_that_cannot_be_made(site, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="no model in"):
        write_site(tmp_path / "nowhere", tmp_path / "new" / "site")
    with pytest.raises(UserError, match="no model in"):
        write_site(tmp_path / "nowhere", tmp_path / "empty")
    assert [path.name for path in (tmp_path / "empty").iterdir()] == []
    assert not (tmp_path / "new" / "site").exists()


@pytest.mark.parametrize(
    ("node", "npm", "message"),
    [
        (None, None, "node is not installed; install Node.js 20 or newer"),
        ("echo v16.20.0", "exit 1", "node is v16.20.0; install 20 or newer"),
        ("echo v22.1.0", "echo npm error code ENOTFOUND; exit 1", "npm cannot reach its registry"),
    ],
)
def test_what_the_build_lacks_is_said_in_a_line(node, npm, message, program, tmp_path):
    for name, line in (("node", node), ("npm", npm)):
        if line:
            program(name, line)
    with pytest.raises(UserError, match=message):
        site_module.build_scripts()
    assert [path.name for path in tmp_path.glob("cache/web/*") if path.suffix != ".lock"] == []


def test_the_cache_is_of_the_sources(tmp_path):
    """Other sources are built again, and the files that the scripts import are among them."""
    folder = site_module.copy_sources(site_module.find_sources(), tmp_path)
    assert site_module.hash_sources(folder) == site_module.hash_sources(site_module.find_sources())
    (folder / "site" / "app.ts").write_text("")
    assert site_module.hash_sources(folder) != site_module.hash_sources(site_module.find_sources())
    imported = [
        folder / os.path.relpath(path.parent / name, folder)
        for path in (folder / "src").rglob("*.ts")
        for name in re.findall(r'from "([^"]+\.json)"', path.read_text())
    ]
    assert imported and all(path.is_file() for path in imported)


def test_the_wheel_has_the_sources_and_grows_little():
    included = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    inside = included["force-include"]
    web = {source: target for source, target in inside.items() if source.startswith("integrations/web/")}
    assert web == {f"integrations/web/{part}": f"ha2g_jax/assets/web/{part}" for part in site_module.PARTS}
    paths = [ROOT / source for source in inside]
    files = [file for path in paths for file in ([path] if path.is_file() else path.rglob("*")) if file.is_file()]
    assert sum(file.stat().st_size for file in files) < 2e6


def test_a_site_stays_if_its_replacement_is_interrupted(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "index.html").write_text("old")
    (tmp_path / "new").mkdir()
    rename = pathlib.Path.rename

    def interrupt(path, target):
        if path.name == "new":
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(pathlib.Path, "rename", interrupt)
    with pytest.raises(KeyboardInterrupt):
        site_module._put(tmp_path / "new", tmp_path / "out")
    assert (tmp_path / "out" / "index.html").read_text() == "old"

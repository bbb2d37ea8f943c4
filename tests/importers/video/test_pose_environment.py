"""The pose estimator's environment is whole or not there, made once, and asked for where it is missing."""

import importlib.resources
import os
import pathlib
import re
import subprocess
import sys

import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import pose

PINS = (importlib.resources.files("ha2g_jax") / "assets" / "pose_requirements.txt").read_text()


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    """Nothing is made yet, and MediaPipe is taken to have wheels for the Python of the tests."""
    running = ".".join(map(str, sys.version_info[:2]))
    monkeypatch.setattr(pose, "_PYTHONS", (*pose._PYTHONS, running))
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("HA2G_POSE_PYTHON", raising=False)
    return tmp_path / "cache"


@pytest.fixture
def made(monkeypatch) -> list[pathlib.Path]:
    """Environments are pretended to be made, and noted."""
    made = []

    def make(folder: pathlib.Path, interpreter: str, pins: str) -> None:
        made.append(folder)
        python = pose._interpreter(folder)
        python.parent.mkdir(parents=True)
        python.touch()
        (folder / "pyvenv.cfg").touch()

    monkeypatch.setattr(pose, "_make", make)
    return made


def test_it_is_made_once_under_the_cache(empty_cache, made):
    folder = pose.install()
    assert folder == empty_cache / "pose-0.10.21"
    assert pose.install() == folder
    assert len(made) == 1
    assert os.listdir(empty_cache) == [folder.name]  # noqa: PTH208
    python, *_, script = pose.holistic_command()
    assert python == str(pose._interpreter(folder))
    assert pathlib.Path(script).is_file()


def test_other_pins_make_it_anew(made):
    folder = pose.install()
    (folder / "requirements.txt").write_text("mediapipe==0.10.20\n")
    (folder / "old").touch()
    pose.install()
    assert len(made) == 2
    assert not (folder / "old").exists()


def test_a_folder_of_something_else_is_left_alone(empty_cache, made):
    folder = empty_cache / "pose-0.10.21"
    folder.mkdir(parents=True)
    (folder / "thesis.txt").touch()
    with pytest.raises(UserError, match="is not an environment"):
        pose.install()
    assert not made
    assert (folder / "thesis.txt").exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, UserError("no connection")])
def test_what_stops_it_leaves_nothing_behind(empty_cache, monkeypatch, error):
    def stop(folder: pathlib.Path, interpreter: str, pins: str) -> None:
        (folder / "lib").mkdir(parents=True)
        raise error

    monkeypatch.setattr(pose, "_make", stop)
    with pytest.raises((KeyboardInterrupt, UserError)):
        pose.install()
    assert not list(empty_cache.iterdir())


def test_without_a_connection_one_line_says_so(empty_cache, monkeypatch, capfd):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(UserError, match=r"mediapipe==0\.10\.21") as caught:
        pose.install()
    assert "\n" not in str(caught.value)
    assert "PyPI" in str(caught.value)
    assert not list(empty_cache.iterdir())
    assert "ERROR" not in "".join(capfd.readouterr())  # of pip


def test_a_python_without_wheels_is_refused(tmp_path, monkeypatch):
    old = tmp_path / "python3.8"
    old.write_text("#!/bin/sh\necho 3 8 /usr/bin/python3.8\n")
    old.chmod(0o755)
    for name in (old, tmp_path / "absent", "no-such-python"):
        with pytest.raises(UserError, match=r"Python 3\.11 or 3\.12"):
            pose.install(python=name)
    monkeypatch.setattr(sys, "executable", str(old))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match=r"python3\.12"):
        pose.install()


def test_another_environment_may_be_named(monkeypatch):
    monkeypatch.setenv("HA2G_POSE_PYTHON", sys.executable)
    assert pose.holistic_command()[0] == sys.executable
    monkeypatch.setenv("HA2G_POSE_PYTHON", "/no/such/python")
    with pytest.raises(UserError, match="/no/such/python"):
        pose.holistic_command()


def test_the_pins_are_complete_and_need_no_display():
    pins = dict(line.split("==") for line in PINS.splitlines() if line and not line.startswith("#"))
    assert pins["mediapipe"] == "0.10.21"
    assert pins["numpy"].startswith("1.")
    assert all(re.fullmatch(r"[0-9.]+(post[0-9]+)?", version) for version in pins.values())
    assert not {"jax", "jaxlib", "scipy", "opencv-python", "opencv-contrib-python"} & set(pins)


def test_the_estimator_needs_nothing_of_this_package():
    """Its environment has none of it: the program must not even try to import it."""
    script = importlib.resources.files("ha2g_jax") / "importers" / "video" / "holistic.py"
    code = f"""
import sys
sys.modules.update(dict.fromkeys(["ha2g_jax", "jax", "av", "scipy"]))
import runpy
runpy.run_path({str(script)!r})
"""
    subprocess.run([sys.executable, "-I", "-c", code], check=True)

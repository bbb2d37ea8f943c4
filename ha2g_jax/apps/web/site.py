"""The folder of a site: page, scripts, model, and the list of files that a browser caches to work offline."""

import base64
import hashlib
import importlib.resources
import json
import os
import pathlib
import re
import shutil
import subprocess
from collections.abc import Sequence

from ha2g_jax import __version__
from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import cache_folder, one_maker
from ha2g_jax.files.reading import read_json, shown
from ha2g_jax.files.writing import temporary_folder, writing
from ha2g_jax.progress import stage
from ha2g_jax.viewer.packing import pack_body
from ha2g_jax.viewer.page import read_asset

LIST = "site.json"  # names the files of a site, so that another site may replace it
_FORMAT = "ha2g-site 1"
_MAX_LIST_BYTES = 2**20
# Scripts of the viewer that the page uses; it has its own for sound, controls and keys.
_VIEWER = ("motion.js", "body.js", "stage.js", "arriving.js", "acting.js", "timeline.js")
_STYLES = ("style.css", "live.css")
_THREE_LICENSE = "three.js r130 (three.min.js): MIT, Copyright 2010-2021 three.js authors, see three below."
_OLDEST_NODE = 20
_RESULT = pathlib.Path("build") / "site"
_UNREACHABLE = (
    *("ENOTFOUND", "EAI_AGAIN", "ECONNREFUSED", "ECONNRESET"),
    *("ETIMEDOUT", "ENETUNREACH", "ERR_SOCKET_TIMEOUT"),
)
_SECONDS = 900  # time limit of one run of npm
# What the site is built from; the tests of the npm package and what npm installs are left out.
PARTS = ("package.json", "package-lock.json", "tsconfig.json", "build.mjs", "LICENSE", "src", "site")
_ASSETS = ("skeletons", "rigs", "joint_limits.json")  # of this package


def write_site(
    checkpoint: str | pathlib.Path, out: str | pathlib.Path, *, weights: str = "float32", license: str = ""
) -> pathlib.Path:
    """Write a site that generates motion in the browser atomically, and return its folder.

    Args:
        checkpoint: model, see `checkpoint.onnx.export.export`.
        out: folder to write; it does not exist, is empty, or is a site, which is replaced.
        weights: form of large weights in the ONNX file, one of `graph.WEIGHTS`.
        license: licence of the model, which the page shows; that of the demo is known.

    Raises:
        UserError: the folder holds something else or cannot be written, or the model or the scripts cannot be made.
    """
    out = pathlib.Path(out)
    _check_place(out)
    scripts = build_scripts()
    with writing(out):
        out.absolute().parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(out.absolute()) as folder:
            _add_page(folder, scripts)
            with stage("exporting the model"):
                _add_model(folder / "model", checkpoint, weights, license)
            _add_lists(folder)
            folder.chmod(0o755)
            _check_place(out)
            _put(folder, out.absolute())
    return out


def _add_page(folder: pathlib.Path, scripts: pathlib.Path) -> None:
    shutil.copytree(scripts, folder, dirs_exist_ok=True)
    (folder / "three.min.js").write_bytes(read_asset("three.min.js").encode())
    (folder / "viewer.js").write_text("".join(read_asset(name) for name in _VIEWER), encoding="utf-8")
    styles = "".join(read_asset(name) for name in _STYLES)
    (folder / "style.css").write_text(styles + (scripts / "style.css").read_text("utf-8"), encoding="utf-8")
    example = _installed("hello.wav", _package().parent / "examples") / "hello.wav"
    shutil.copyfile(example, folder / "hello.wav")
    licenses = folder / "LICENSES.txt"
    licenses.write_text(f"{_THREE_LICENSE}\n\n{licenses.read_text('utf-8')}", encoding="utf-8")


def _add_model(folder: pathlib.Path, checkpoint: str | pathlib.Path, weights: str, license: str) -> None:
    # JAX is imported only when everything else is in place.
    from ha2g_jax.checkpoint.onnx.export import export
    from ha2g_jax.checkpoint.onnx.reading import read
    from ha2g_jax.motion.formats.gltf import write_figure
    from ha2g_jax.synthesis.onnx_model import write_page_description

    model = export(checkpoint, folder / "model.onnx", weights=weights, license=license)
    write_page_description(model)
    skeleton = read(model)[0].assets.skeleton
    write_figure(folder / "figure.glb", skeleton)
    (folder / "body.json").write_text(json.dumps(pack_body(skeleton)), encoding="utf-8")


def _add_lists(folder: pathlib.Path) -> None:
    """Write the hashes of the files, for the service worker, and their names, for the next `write_site`."""
    worker = folder / "sw.js"
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != worker)
    hashes = {path.relative_to(folder).as_posix(): integrity_of(path) for path in files}
    worker.write_text(f"self.FILES = {json.dumps(hashes)};\n{worker.read_text('utf-8')}", encoding="utf-8")
    content = {"format": _FORMAT, "version": __version__, "files": sorted([*hashes, worker.name, LIST])}
    (folder / LIST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def integrity_of(path: pathlib.Path) -> str:
    """Return the hash of a file in the form of the Subresource Integrity of browsers."""
    return f"sha256-{base64.b64encode(hashlib.sha256(path.read_bytes()).digest()).decode()}"


def _check_place(out: pathlib.Path) -> None:
    """Check that a folder may be replaced: a site has a list, and no file that the list does not name."""
    with writing(out):
        if not out.exists() or (out.is_dir() and not any(out.iterdir())):
            return
        found = [path.relative_to(out).as_posix() for path in out.rglob("*") if not path.is_dir()]
    content = read_json(out / LIST, "the list of the files of a site", _MAX_LIST_BYTES) if LIST in found else None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise UserError(f"{shown(out)} exists and is not a site of ha2g web; choose another folder or remove it")
    if others := sorted(set(found) - set(content["files"])):
        raise UserError(f"{shown(out)} has {shown(others[0])}, which ha2g web has not written; choose another folder")


def _put(folder: pathlib.Path, out: pathlib.Path) -> None:
    """Rename a folder to `out`; a site that was there is removed afterwards, or stays if the renaming fails."""
    if not out.exists():
        folder.rename(out)
        return
    with temporary_folder(out) as aside:
        old = aside / "old"
        try:
            out.rename(old)
            folder.rename(out)
        except BaseException:  # Ctrl-C as well
            if old.exists() and not out.exists():
                old.rename(out)
            raise


def build_scripts() -> pathlib.Path:
    """Return the folder of the built files, in the cache folder; they are built unless these sources were before.

    Raises:
        UserError: node or npm is missing or too old, npm cannot reach its registry, or the build fails.
    """
    found = find_sources()
    folder = cache_folder() / "web" / hash_sources(found)
    if folder.is_dir():
        return folder
    npm = _find_npm()
    with one_maker(folder):
        if folder.is_dir():  # another process has built it meanwhile
            return folder
        with writing(folder, "set HA2G_CACHE to another folder"), temporary_folder(folder) as temporary:
            project = copy_sources(found, temporary)
            with stage("installing what ha2g-web is built with"):
                _run([npm, "ci", "--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error"], project)
            with stage("building the site"):
                _run([npm, "run", "--silent", "build:site"], project)
            (project / _RESULT).rename(folder)
    return folder


def _find_npm() -> str:
    node, npm = shutil.which("node"), shutil.which("npm")
    if not node or not npm:
        missing = "node" if not node else "npm"
        raise UserError(f"{missing} is not installed; install Node.js {_OLDEST_NODE} or newer, which has npm")
    answer = subprocess.run([node, "--version"], capture_output=True, text=True, check=False).stdout.strip()
    version = re.match(r"v(\d+)\.", answer)
    if not version or int(version[1]) < _OLDEST_NODE:
        raise UserError(f"node is {shown(answer) or 'of an unknown version'}; install {_OLDEST_NODE} or newer")
    return npm


def _run(command: Sequence[str], folder: pathlib.Path) -> None:
    """Run npm in a folder; if it fails, show the most informative line of its output."""
    environment = os.environ | {"npm_config_update_notifier": "false", "NO_COLOR": "1", "NODE_ENV": ""}
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UserError(f"npm {command[1]} took more than {_SECONDS // 60} minutes; try again") from error
    if done.returncode == 0:
        return
    if any(code in done.stdout for code in _UNREACHABLE):
        raise UserError("npm cannot reach its registry; connect to the network, or set the registry with npm config")
    lines = [line.strip() for line in done.stdout.splitlines() if line.strip()]
    told = next((line for line in lines if re.search(r"\berror\b", line, re.IGNORECASE)), lines[-1] if lines else "")
    raise UserError(
        f"npm {command[1]} failed ({shown(told) or 'no output'}); run it in a checkout, in integrations/web/"
    )


def find_sources() -> pathlib.Path:
    """Return the folder of the sources of ha2g-web."""
    return _installed("package-lock.json", _package().parent / "integrations" / "web")


def _installed(name: str, checkout: pathlib.Path) -> pathlib.Path:
    """Return the folder of the sources of a site: that of the installed package, or one of a checkout.

    Raises:
        UserError: neither has a file of this name.
    """
    for folder in (_package() / "assets" / "web", checkout):
        if (folder / name).is_file():
            return folder
    raise UserError("the sources of ha2g-web are not installed; install ha2g-jax again, or use a checkout")


def hash_sources(sources: pathlib.Path) -> str:
    """Return a hash of the names and the contents of the sources, 16 hexadecimal digits."""
    total = hashlib.sha256()
    for name, path in _files(sources).items():
        content = path.read_bytes()
        total.update(b"%d %d " % (len(name.encode()), len(content)) + name.encode() + content)
    return total.hexdigest()[:16]


def copy_sources(sources: pathlib.Path, folder: pathlib.Path) -> pathlib.Path:
    """Copy the sources, and what they import of this package, to a folder; return the folder of package.json."""
    for name, path in _files(sources).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / name)
    return folder / "integrations" / "web"


def _package() -> pathlib.Path:
    return pathlib.Path(str(importlib.resources.files("ha2g_jax")))


def _files(sources: pathlib.Path) -> dict[str, pathlib.Path]:
    roots = {"integrations/web": (sources, PARTS), "ha2g_jax/assets": (_package() / "assets", _ASSETS)}
    found = {}
    for root, (folder, parts) in roots.items():
        for part in parts:
            paths = [folder / part] if (folder / part).is_file() else (folder / part).rglob("*")
            found |= {f"{root}/{path.relative_to(folder).as_posix()}": path for path in paths if path.is_file()}
    return {name: found[name] for name in sorted(found) if not name.rpartition("/")[2].startswith(".")}

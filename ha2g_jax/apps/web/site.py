"""The folder of the site: page, scripts, model, and what a browser keeps of them to work offline."""

import base64
import hashlib
import json
import pathlib
import shutil

from ha2g_jax import __version__
from ha2g_jax.apps.web import sources
from ha2g_jax.apps.web.build import build_scripts
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_json, shown
from ha2g_jax.files.writing import temporary_folder, writing
from ha2g_jax.progress import stage
from ha2g_jax.viewer.page import read_asset, three_library

LIST = "site.json"  # names the files of a site, so that another site may take its place
_FORMAT = "ha2g-site 1"
_MAX_LIST_BYTES = 2**20
# Scripts of the viewer that the page uses; it has its own for sound, controls and keys.
_VIEWER = ("motion.js", "loft.js", "head.js", "arm.js", "body.js", "stage.js", "arriving.js", "timeline.js")
_STYLES = ("style.css", "live.css")
_THREE_LICENSE = "three.js r130 (three.min.js): MIT, Copyright 2010-2021 three.js authors, see three below."


def write_site(
    checkpoint: str | pathlib.Path, out: str | pathlib.Path, *, weights: str = "float32", license: str = ""
) -> pathlib.Path:
    """Write a site that generates motion in the browser, completely or not at all.

    Args:
        checkpoint: model, see `checkpoint.onnx.export.export`.
        out: folder to write; it does not exist, is empty, or is a site, which is replaced.
        weights: form of large weights in the ONNX file, one of `graph.WEIGHTS`.
        license: licence of the model, which the page shows; that of the demo is known.

    Returns:
        The folder.

    Raises:
        UserError: the folder holds something else or cannot be written, the model cannot be exported, or the scripts
            cannot be built, see `build_scripts`.
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
    """Write all but the model and the lists of files."""
    shutil.copytree(scripts, folder, dirs_exist_ok=True)
    (folder / "three.min.js").write_bytes(three_library())
    (folder / "viewer.js").write_text("".join(read_asset(name) for name in _VIEWER), encoding="utf-8")
    styles = "".join(read_asset(name) for name in _STYLES)
    (folder / "style.css").write_text(styles + (scripts / "style.css").read_text("utf-8"), encoding="utf-8")
    shutil.copyfile(sources.find_example(), folder / "hello.wav")
    licenses = folder / "LICENSES.txt"
    licenses.write_text(f"{_THREE_LICENSE}\n\n{licenses.read_text('utf-8')}", encoding="utf-8")


def _add_model(folder: pathlib.Path, checkpoint: str | pathlib.Path, weights: str, license: str) -> None:
    # JAX is imported when all else is there.
    from ha2g_jax.checkpoint.onnx.export import export
    from ha2g_jax.checkpoint.onnx.reading import read
    from ha2g_jax.motion.formats.gltf import write_figure
    from ha2g_jax.synthesis.onnx_model import page_description

    model = export(checkpoint, folder / "model.onnx", weights=weights, license=license)
    (folder / "model.json").write_text(json.dumps(page_description(model), separators=(",", ":")), encoding="utf-8")
    write_figure(folder / "figure.glb", read(model)[0].assets.skeleton)


def _add_lists(folder: pathlib.Path) -> None:
    """Write the hashes of the files, for the service worker, and their names, for the next `write_site`."""
    worker = folder / "sw.js"
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != worker)
    hashes = {path.relative_to(folder).as_posix(): hash_of(path) for path in files}
    worker.write_text(f"self.FILES = {json.dumps(hashes)};\n{worker.read_text('utf-8')}", encoding="utf-8")
    content = {"format": _FORMAT, "version": __version__, "files": sorted([*hashes, worker.name, LIST])}
    (folder / LIST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def hash_of(path: pathlib.Path) -> str:
    """Return the hash of a file in the form of the Subresource Integrity of browsers."""
    return f"sha256-{base64.b64encode(hashlib.sha256(path.read_bytes()).digest()).decode()}"


def _check_place(out: pathlib.Path) -> None:
    """Check that a folder may be replaced: a site has a list, and no file that the list does not name."""
    with writing(out):
        if not out.exists() or (out.is_dir() and not any(out.iterdir())):
            return
        found = [path.relative_to(out).as_posix() for path in out.rglob("*") if not path.is_dir()]
    if LIST not in found:
        raise UserError(f"{shown(out)} exists and is not a site of ha2g web; choose another folder or remove it")
    content = read_json(out / LIST, "the list of the files of a site", _MAX_LIST_BYTES)
    listed = content.get("files") if isinstance(content, dict) and content.get("format") == _FORMAT else None
    if not isinstance(listed, list):
        raise UserError(f"{shown(out / LIST)} is not the list of a site; choose another folder or remove it")
    if others := sorted(set(found) - {name for name in listed if isinstance(name, str)}):
        raise UserError(f"{shown(out)} has {shown(others[0])}, which ha2g web has not written; choose another folder")


def _put(folder: pathlib.Path, out: pathlib.Path) -> None:
    """Rename a folder to `out`; what was there is removed afterwards, or stays if the renaming fails."""
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

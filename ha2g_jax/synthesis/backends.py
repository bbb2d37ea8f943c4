"""What computes the motion of `ha2g generate`: JAX, or ONNX Runtime, which starts without JAX."""

import hashlib
import importlib.metadata
import importlib.resources
import pathlib
from typing import Any

from ha2g_jax.checkpoint import hub
from ha2g_jax.checkpoint.onnx.reading import BY, SUFFIX
from ha2g_jax.errors import UserError, require
from ha2g_jax.files.cache import cache_folder, one_maker
from ha2g_jax.files.reading import read_json, shown
from ha2g_jax.limits import MAX_ASSETS_BYTES
from ha2g_jax.synthesis.generator import Generator

BACKENDS = ("jax", "onnx")


def load(checkpoint: str | pathlib.Path, backend: str | None = None) -> Generator[Any]:
    """Load a model for a backend.

    Args:
        checkpoint: a file of `ha2g export-onnx`, or a model, see `synthesis.load`.
        backend: one of `BACKENDS`; by default "onnx" for a file of `ha2g export-onnx`, and "jax" for any other model.
            With "onnx", the demo or a model folder is exported to the cache folder once.

    Raises:
        UserError: there is no model, it is damaged, or the backend cannot use it.
    """
    is_file = pathlib.Path(checkpoint).suffix.lower() == SUFFIX and not pathlib.Path(checkpoint).is_dir()
    if backend == "jax" and is_file:
        raise UserError(f"{shown(checkpoint)} is for the backend onnx; give the model that it was exported from")
    if backend == "onnx" or is_file:
        from ha2g_jax.synthesis.onnx_model import load_onnx

        return load_onnx(checkpoint if is_file else exported(checkpoint))
    from ha2g_jax.synthesis.model import load as load_model

    return load_model(checkpoint)


def exported(checkpoint: str | pathlib.Path) -> pathlib.Path:
    """Return the ONNX file of a model in the cache folder, which is written if it is not there.

    Args:
        checkpoint: "demo", a model folder, or a model on the Hub.

    Raises:
        UserError: there is no model folder, the model cannot be exported, or the cache folder cannot be written.
    """
    folder = hub.fetch(str(checkpoint)) if hub.is_hub_name(checkpoint) else pathlib.Path(checkpoint)
    if checkpoint == "demo":
        folder = pathlib.Path(str(importlib.resources.files("ha2g_jax") / "assets" / "demo"))
    assets, config = folder / "assets.json", folder / "config.json"
    if not all(path.is_file() for path in (assets, config, folder / "model.safetensors")):
        raise UserError(
            f"no model folder at {shown(checkpoint)}; write an ONNX file with ha2g export-onnx, and give it as "
            "--checkpoint"
        )
    found = read_json(assets, "the assets of a model", MAX_ASSETS_BYTES)
    name = found.get("hash") if isinstance(found, dict) else None
    if not (isinstance(name, str) and name.isalnum() and name.isascii() and len(name) <= 64):
        raise UserError(f"{shown(assets)} has no hash of the weights; export or download the model again")
    version = importlib.metadata.version("ha2g-jax")
    # The file also has the assets and the config, which may change while the weights stay.
    digest = hashlib.sha256(assets.read_bytes() + config.read_bytes()).hexdigest()[:16]
    path = cache_folder() / "onnx" / f"{name}-{digest}-{version}{SUFFIX}"
    if not path.is_file():
        with one_maker(path):
            if not path.is_file():
                for package in ("onnx", "onnxruntime"):
                    require(package, "onnx", by=BY)
                from ha2g_jax.checkpoint.onnx.export import export

                export(checkpoint if checkpoint == "demo" else folder, path)
    return path

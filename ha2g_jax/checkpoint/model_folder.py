"""Model folders, the form in which models are shipped: config.json, assets.json and model.safetensors; no pickle.

The config contains what `ha2g_jax.methods.build` needs, and neither losses nor settings of training. A model is named
by "demo", by such a folder, or by the workdir of a training run, which stands for its best checkpoint on the validation
split. WORKDIR/latest, WORKDIR/best, WORKDIR/failed and a step below them name a particular checkpoint.
"""

import contextlib
import dataclasses
import hashlib
import importlib.resources
import json
import pathlib
import shutil
import tempfile
from typing import Any, NamedTuple

import jax
import numpy as np
import safetensors
import safetensors.numpy
from flax import traverse_util

from ha2g_jax import config as configs
from ha2g_jax import config_renames
from ha2g_jax.checkpoint import assets as assets_module
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import Config
from ha2g_jax.errors import UserError
from ha2g_jax.methods.build import build, variable_shapes
from ha2g_jax.methods.method import Spec

BEST, LATEST, FAILED = "best", "latest", "failed"
RUN = "run.json"
CONFIG, ASSETS, WEIGHTS = "config.json", "assets.json", "model.safetensors"

_HALF_PRECISION_ABOVE = 20_000_000  # bytes of float32 weights; a package should not be larger


class LoadedModel(NamedTuple):
    """A trained generator.

    Attributes:
        spec: networks and sizes.
        variables: {"params", "batch_stats"} of the generator as numpy arrays.
        assets: skeleton, vocabulary, styles and seed poses.
        config: settings that the networks are built from.
    """

    spec: Spec
    variables: dict[str, Any]
    assets: Assets
    config: Config


def load(spec: str | pathlib.Path) -> LoadedModel:
    """Load a model.

    Args:
        spec: "demo", a model folder, a workdir, or a checkpoint in a workdir.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    if spec == "demo":
        folder = importlib.resources.files("ha2g_jax") / "assets" / "demo"
        with importlib.resources.as_file(folder) as path:
            if not path.is_dir():
                raise UserError("the demo model is not installed; install ha2g-jax again or name a --checkpoint")
            return _load_folder(path)
    path = pathlib.Path(spec)
    if (path / WEIGHTS).is_file():
        return _load_folder(path)
    for workdir in (path, path.parent, path.parent.parent):
        if (workdir / CONFIG).is_file() and any((workdir / name).exists() for name in (BEST, LATEST, FAILED, RUN)):
            return _load_checkpoint(workdir, path)
    found = "nothing is there" if not path.exists() else f"{WEIGHTS} is missing"
    raise UserError(f"no model in {path}: {found}; expected 'demo', a workdir of ha2g train or an exported folder")


def save(folder: str | pathlib.Path, config: Config, assets: Assets, variables: dict[str, Any]) -> pathlib.Path:
    """Write a model folder, completely or not at all; its assets contain the hash of the weights.

    Weights are float32, or float16 if float32 would take more than 20 MB.

    Args:
        folder: folder to write, which does not exist or is empty.
        config: settings of the model; losses and settings of training are left out.
        assets: assets of the model.
        variables: {"params", "batch_stats"} of the generator.

    Returns:
        The folder.

    Raises:
        UserError: `folder` exists and is not empty.
    """
    folder = pathlib.Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"{folder} exists already; choose another folder or remove it")
    weights = _to_bytes(variables)
    assets = dataclasses.replace(assets, hash=_hash(weights))
    folder.absolute().parent.mkdir(parents=True, exist_ok=True)
    temporary = pathlib.Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.absolute().parent))
    try:
        write_description(temporary, _settings_of_model(config), assets)
        (temporary / WEIGHTS).write_bytes(weights)
        temporary.chmod(0o755)
        temporary.replace(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def export(workdir: str | pathlib.Path, out: str | pathlib.Path) -> pathlib.Path:
    """Write the model of a workdir as a model folder.

    Args:
        workdir: workdir of a run, or a checkpoint in it.
        out: folder to write, which does not exist or is empty.

    Returns:
        The model folder.

    Raises:
        UserError: as `load` and `save`.
    """
    model = load(workdir)
    return save(out, model.config, model.assets, model.variables)


def write_description(folder: pathlib.Path, config: Config, assets: Assets) -> None:
    """Write the config and the assets of a model as config.json and assets.json.

    Args:
        folder: model folder or workdir, which exists.
        config: settings of the model.
        assets: assets of the model.
    """
    for name, values in ((CONFIG, config_to_json(config)), (ASSETS, assets_module.to_json(assets))):
        temporary = folder / f"{name}.new"
        temporary.write_text(json.dumps(values, indent=1 if name == CONFIG else None) + "\n")
        temporary.replace(folder / name)


def config_to_json(config: Config) -> dict[str, Any]:
    """Return a config as the plain values of config.json."""
    return json.loads(config.to_json())


def read_description(folder: pathlib.Path) -> tuple[Config, Assets]:
    """Read the config and the assets of a model folder or a workdir.

    Args:
        folder: model folder or workdir.

    Raises:
        UserError: one of the files is missing or damaged.
    """
    with _blame(folder / CONFIG):
        values = json.loads((folder / CONFIG).read_text())
        config = configs.from_json(values)
    config_renames.warn(config_renames.with_new_names(values)[1], str(folder / CONFIG))
    with _blame(folder / ASSETS):
        assets = assets_module.from_json(json.loads((folder / ASSETS).read_text()))
    return config, assets


def _load_folder(folder: pathlib.Path) -> LoadedModel:
    config, assets = read_description(folder)
    spec = _build(folder, config, assets)
    with _blame(folder / WEIGHTS):
        data = (folder / WEIGHTS).read_bytes()
        flat = safetensors.numpy.load(data)
        _check_tensors(flat, _expected_shapes(spec))
    if _hash(data) != assets.hash:
        raise UserError(
            f"{folder / WEIGHTS} has hash {_hash(data)}, {ASSETS} says {assets.hash}: "
            "the files belong to two models; export or download the model again"
        )
    flat = {name: array.astype(np.float32) for name, array in flat.items()}
    variables = {"params": {}, "batch_stats": {}} | traverse_util.unflatten_dict(flat, sep="/")
    return LoadedModel(spec, variables, assets, config)


def _load_checkpoint(workdir: pathlib.Path, path: pathlib.Path) -> LoadedModel:
    """Load the checkpoint that `path`, a workdir or a folder in it, stands for."""
    from ha2g_jax.checkpoint import checkpoint  # Orbax takes seconds to import, and the demo does not need it

    config, assets = read_description(workdir)
    spec = _build(workdir, config, assets)
    kind, number = (*path.relative_to(workdir).parts, "", "")[:2]
    for name in (kind,) if kind else (BEST, LATEST):
        checkpoints = checkpoint.Checkpoints(workdir / name) if (workdir / name).is_dir() else None
        steps = [str(number) for number in checkpoints.steps()] if checkpoints else []
        if checkpoints and steps and number in ("", *steps):
            break
    else:
        raise UserError(f"no checkpoint in {path} yet; train longer, or use another run")
    variables, record = checkpoints.restore_model(int(number or steps[-1]), variable_shapes(spec))
    checkpoints.close()
    with _blame(workdir / name):
        speakers = {speaker: np.asarray(record["speakers"][speaker], np.float32) for speaker in assets.speakers}
    assets = dataclasses.replace(assets, speakers=speakers, hash=_hash(_to_bytes(variables)))
    return LoadedModel(spec, variables, assets, config)


def _build(folder: pathlib.Path, config: Config, assets: Assets) -> Spec:
    with _blame(folder / CONFIG):
        return build(config, assets.skeleton, len(assets.vocabulary), len(assets.speakers))


def _settings_of_model(config: Config) -> Config:
    """Return the part of a config that the model is built from."""
    config = config.copy_and_resolve_references()
    config.unlock()
    for part in ("loss", "train"):
        if part in config:
            del config[part]
    return config


def _expected_shapes(spec: Spec) -> dict[str, tuple[int, ...]]:
    return {name: leaf.shape for name, leaf in _flatten(variable_shapes(spec)).items()}


def _check_tensors(found: dict[str, np.ndarray], expected: dict[str, tuple[int, ...]]) -> None:
    if odd := sorted(found.keys() ^ expected.keys()):
        verb = "is missing" if odd[0] in expected else "does not belong"
        raise ValueError(f"{odd[0]} {verb}" + (f" and {len(odd) - 1} more do not fit" if odd[1:] else ""))
    for name, shape in expected.items():
        if found[name].shape != shape:
            raise ValueError(f"{name} has shape {found[name].shape} instead of {shape}")


def _to_bytes(variables: dict[str, Any]) -> bytes:
    flat = _flatten(jax.tree.map(np.asarray, variables))
    dtype = np.float32 if sum(4 * array.size for array in flat.values()) <= _HALF_PRECISION_ABOVE else np.float16
    return safetensors.numpy.save({name: np.ascontiguousarray(array, dtype) for name, array in flat.items()})


def _flatten(variables: Any) -> dict[str, Any]:
    """Return nested dicts as one dict, with names such as "params/audio/stem/kernel"."""
    return dict(traverse_util.flatten_dict(variables, sep="/"))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


@contextlib.contextmanager
def _blame(path: pathlib.Path):
    """Turn an error during the reading of a file into a `UserError` that names the file."""
    try:
        yield
    except FileNotFoundError:
        raise UserError(f"{path} is missing; export or download the model again") from None
    except (ValueError, KeyError, TypeError, AttributeError, OSError, safetensors.SafetensorError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UserError(
            f"{path} is damaged or of another version ({reason}); export or download the model again"
        ) from error

"""Model folders, the form in which models are shipped: config.json, assets.json and model.safetensors; no pickle.

The config contains what `ha2g_jax.methods.build` needs, and neither losses nor settings of training. A model is named
by "demo", by such a folder, by hf://OWNER/NAME on the Hub, or by the workdir of a training run, which stands for its
best checkpoint on the validation split. WORKDIR/latest, WORKDIR/best, WORKDIR/failed and a step below them name a
particular checkpoint.
"""

import contextlib
import dataclasses
import importlib.resources
import json
import os
import pathlib
import shutil
import tempfile
from collections.abc import Iterator
from typing import Any, NamedTuple

from flax.errors import FlaxError

from ha2g_jax import config as configs
from ha2g_jax import config_renames
from ha2g_jax.checkpoint import assets as assets_module
from ha2g_jax.checkpoint import hub, weights
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import Config
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import parse_json, read_bytes, reading, reason, shown
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.limits import MAX_ASSETS_BYTES, MAX_CONFIG_BYTES
from ha2g_jax.methods.build import build, variable_shapes
from ha2g_jax.methods.method import Spec

BEST, LATEST, FAILED = "best", "latest", "failed"
RUN = "run.json"
CONFIG, ASSETS, WEIGHTS = "config.json", "assets.json", "model.safetensors"


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
        spec: "demo", a model folder, a workdir, a checkpoint in a workdir, or hf://OWNER/NAME@REVISION, a model on the
            Hub, see `hub`.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    if hub.is_hub_name(spec):
        return _load_folder(hub.fetch(str(spec)))
    if spec == "demo":
        folder = importlib.resources.files("ha2g_jax") / "assets" / "demo"
        with importlib.resources.as_file(folder) as path:
            if not path.is_dir():
                raise UserError("the demo model is not installed; install ha2g-jax again or name a --checkpoint")
            return _load_folder(path)
    return load_path(spec, "'demo', a workdir of ha2g train or an exported folder")


def load_path(path: str | os.PathLike, expected: str) -> LoadedModel:
    """Load the model at a path.

    Args:
        path: a model folder, a workdir, or a checkpoint in a workdir.
        expected: what may be named, for the message.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    path = pathlib.Path(path)
    with reading(path, f"a model: {expected}"):
        is_folder, exists = (path / WEIGHTS).is_file(), path.exists()
        workdirs = [folder for folder in (path, path.parent, path.parent.parent) if _is_workdir(folder)]
    if is_folder:
        return _load_folder(path)
    if workdirs:
        return _load_checkpoint(workdirs[0], path)
    if exists and path.suffix.lower() == ".onnx":
        raise UserError(f"{shown(path)} is for ha2g generate alone; give the model that it was exported from")
    found = f"{WEIGHTS} is missing" if exists else "nothing is there"
    raise UserError(f"no model in {shown(path)}: {found}; expected {expected}")


def _is_workdir(folder: pathlib.Path) -> bool:
    return (folder / CONFIG).is_file() and any((folder / name).exists() for name in (BEST, LATEST, FAILED, RUN))


def save(
    folder: str | pathlib.Path,
    config: Config,
    assets: Assets,
    variables: dict[str, Any],
    *,
    is_exact: bool = False,
) -> pathlib.Path:
    """Write a model folder, completely or not at all; its assets contain the hash of the weights.

    Weights are float32, or float16 if float32 would take more than 20 MB.

    Args:
        folder: folder to write, which does not exist or is empty.
        config: settings of the model; losses and settings of training are left out.
        assets: assets of the model.
        variables: {"params", "batch_stats"} of the generator.
        is_exact: whether weights are float32 whatever their size.

    Returns:
        The folder.

    Raises:
        UserError: `folder` exists and is not empty, or cannot be written, for example because the disk is full.
    """
    folder = pathlib.Path(folder)
    with _writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UserError(f"{shown(folder)} exists already; choose another folder or remove it")
        folder.absolute().parent.mkdir(parents=True, exist_ok=True)
        # The name of the folder may have as many letters as a name can have.
        temporary = pathlib.Path(tempfile.mkdtemp(prefix=".model-", dir=folder.absolute().parent))
        try:
            found = weights.write(temporary / WEIGHTS, variables, is_exact=is_exact)
            assets = dataclasses.replace(assets, hash=found)
            write_description(temporary, _settings_of_model(config), assets)
            (temporary / WEIGHTS).chmod(0o644)
            temporary.chmod(0o755)
            temporary.replace(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return folder


def export(workdir: str | pathlib.Path, out: str | pathlib.Path) -> pathlib.Path:
    """Write the model of a workdir as a model folder.

    Args:
        workdir: workdir of a run, a checkpoint in it, a model folder, or "demo".
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

    Raises:
        UserError: a file cannot be written; what was there before stays.
    """
    for name, values in ((CONFIG, config_to_json(config)), (ASSETS, assets_module.to_json(assets))):
        with whole_file(folder / name) as temporary:
            temporary.write_text(json.dumps(values, indent=1 if name == CONFIG else None) + "\n")


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
    config = read_config(folder)
    with _blame(folder / ASSETS):
        return config, assets_module.from_json(_read_json(folder / ASSETS, MAX_ASSETS_BYTES))


def read_config(folder: pathlib.Path) -> Config:
    """Read the config of a model folder or a workdir.

    Args:
        folder: model folder or workdir.

    Raises:
        UserError: config.json is missing or damaged.
    """
    with _blame(folder / CONFIG):
        values = _read_json(folder / CONFIG, MAX_CONFIG_BYTES)
        config = configs.from_json(values)
    config_renames.warn(config_renames.with_new_names(values)[1], shown(folder / CONFIG))
    return config


def check_assets(folder: pathlib.Path, assets: Assets, spec: Spec, *, has_styles: bool) -> None:
    """Check that start poses and styles have the sizes of the networks.

    Args:
        folder: model folder or workdir, for messages.
        assets: assets of the folder.
        spec: networks and sizes.
        has_styles: whether the assets have the styles of the speakers; those of a workdir may be in its checkpoints.

    Raises:
        UserError: a size is another one.
    """
    with _blame(folder / ASSETS):
        style_dims = (spec.style_dim,) if has_styles else (spec.style_dim, 0)
        assets_module.check_fit(assets, spec.num_seed_frames, style_dims)


def _read_json(path: pathlib.Path, max_bytes: int) -> Any:
    if not path.is_file():
        raise UserError(f"{shown(path)} is missing; export or download the model again")
    return parse_json(read_bytes(path, "part of a model", max_bytes))


def _load_folder(folder: pathlib.Path) -> LoadedModel:
    """Load a model folder: only when all sizes are known to fit, tensors are read."""
    config, assets = read_description(folder)
    shapes = weights.read_shapes(folder / WEIGHTS)
    spec = _build(folder, config, assets, has_styles=True)
    with _blame(folder / WEIGHTS):
        found = weights.hash_of_file(folder / WEIGHTS)
    if found != assets.hash:
        raise UserError(
            f"{shown(folder / WEIGHTS)} has hash {found}, {ASSETS} says {assets.hash}: "
            "the files belong to two models; export or download the model again"
        )
    with _blame(folder / WEIGHTS):
        if difference := weights.compare(shapes, _expected_shapes(folder, spec)):
            raise ValueError(difference)
    return LoadedModel(spec, weights.read(folder / WEIGHTS), assets, config)


def _load_checkpoint(workdir: pathlib.Path, path: pathlib.Path) -> LoadedModel:
    """Load the checkpoint that `path`, a workdir or a folder in it, stands for."""
    from ha2g_jax.checkpoint import checkpoint  # Orbax takes seconds to import, and the demo does not need it

    config, assets = read_description(workdir)
    spec = _build(workdir, config, assets, has_styles=False)
    kind, number = (*path.relative_to(workdir).parts, "", "")[:2]
    for name in (kind,) if kind else (BEST, LATEST):
        checkpoints = checkpoint.Checkpoints(workdir / name) if (workdir / name).is_dir() else None
        steps = [str(number) for number in checkpoints.steps()] if checkpoints else []
        if checkpoints and steps and number in ("", *steps):
            break
    else:
        raise UserError(f"no checkpoint in {shown(path)} yet; train longer, or use another run")
    variables, record = checkpoints.restore_model(int(number or steps[-1]), _shapes(workdir, spec))
    checkpoints.close()
    with _blame(workdir / name):
        speakers = {
            speaker: assets_module.style(record["speakers"][speaker], spec.style_dim) for speaker in assets.speakers
        }
    assets = dataclasses.replace(assets, speakers=speakers, hash=weights.hash_of(variables))
    return LoadedModel(spec, variables, assets, config)


def _build(folder: pathlib.Path, config: Config, assets: Assets, *, has_styles: bool) -> Spec:
    """Build the networks of a folder and check that its assets fit."""
    try:
        spec = build(config, assets.skeleton, len(assets.vocabulary), len(assets.speakers))
    except UserError as error:
        raise UserError(f"{shown(folder / CONFIG)} cannot be used: {error}") from error
    check_assets(folder, assets, spec, has_styles=has_styles)
    return spec


def _shapes(folder: pathlib.Path, spec: Spec) -> Any:
    """Return the variables of a model as shapes; sizes that pass all checks but do not fit together are refused."""
    with _blame(folder / CONFIG):
        return variable_shapes(spec)


def _settings_of_model(config: Config) -> Config:
    """Return the part of a config that the model is built from."""
    config = config.copy_and_resolve_references()
    config.unlock()
    for part in ("loss", "train"):
        if part in config:
            del config[part]
    return config


def _expected_shapes(folder: pathlib.Path, spec: Spec) -> weights.Shapes:
    return {name: leaf.shape for name, leaf in weights.flatten(_shapes(folder, spec)).items()}


@contextlib.contextmanager
def _writing(folder: pathlib.Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UserError(
            f"cannot write {shown(folder)} ({reason(error).lower()}); use another folder or free disk space"
        ) from error


@contextlib.contextmanager
def _blame(path: pathlib.Path) -> Iterator[None]:
    """Turn an error during the reading of a file into a `UserError` that names the file."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, OSError, FlaxError) as error:
        cause = f"{reason(error)} is missing" if isinstance(error, KeyError) else reason(error)
        raise UserError(
            f"{shown(path)} is damaged or of another version ({cause}); export or download the model again"
        ) from error

"""Model folders, the form in which models are shipped: config.json, assets.json and model.safetensors; no pickle.

The config contains what `ha2g_jax.methods.build` needs, and neither losses nor settings of training. A workdir has the
same config and assets, and stands for its best checkpoint on the validation split; WORKDIR/latest, WORKDIR/best,
WORKDIR/failed and a step below them name a particular checkpoint.
"""

import contextlib
import dataclasses
import importlib.resources
import json
import os
import pathlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from flax.errors import FlaxError

from ha2g_jax.checkpoint import ASSETS, BEST, CONFIG, FAILED, LATEST, RUN, WEIGHTS, hub, weights
from ha2g_jax.checkpoint import assets as assets_module
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import settings as configs
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import parse_json, read_bytes, reading, reason, shown
from ha2g_jax.files.writing import whole_folder, write_text
from ha2g_jax.limits import MAX_ASSETS_BYTES, MAX_CONFIG_BYTES
from ha2g_jax.methods import build, variable_shapes
from ha2g_jax.methods.method import Spec


class LoadedModel(NamedTuple):
    """A trained generator."""

    spec: Spec
    variables: dict[str, Any]  # {"params", "batch_stats"} as numpy arrays
    assets: Assets
    config: Config  # settings that the networks are built from

    def __repr__(self) -> str:
        return f"LoadedModel({self.config.name!r}, {self.spec!r}, {self.assets!r})"


def load(spec: str | pathlib.Path) -> LoadedModel:
    """Load a model: "demo", a model folder, a workdir, a checkpoint in a workdir, or hf://OWNER/NAME@REVISION.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    if hub.is_hub_name(spec):
        return read(hub.fetch(str(spec)))
    if spec == "demo":
        folder = importlib.resources.files("ha2g_jax") / "assets" / "demo"
        with importlib.resources.as_file(folder) as path:
            if not path.is_dir():
                raise UserError("the demo model is not installed; install ha2g-jax again or name a --checkpoint")
            return read(path)
    return load_path(spec, "'demo', a workdir of ha2g train or an exported folder")


def load_path(path: str | os.PathLike, expected: str) -> LoadedModel:
    """Load a model folder, a workdir, or a checkpoint in a workdir; error messages say that `expected` may be given.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    path = pathlib.Path(path)
    with reading(path, f"a model: {expected}"):
        is_folder, exists = (path / WEIGHTS).is_file(), path.exists()
        whole = path.absolute()
        workdirs = [folder for folder in (whole, whole.parent, whole.parent.parent) if _is_workdir(folder)]
    if is_folder:
        return read(path)
    if exists and path.suffix.lower() == ".onnx":
        raise UserError(f"{shown(path)} is for ha2g generate alone; give the model that it was exported from")
    if workdirs and {*whole.relative_to(workdirs[0]).parts[:1]} <= {BEST, LATEST, FAILED}:
        return _load_checkpoint(workdirs[0], whole)
    found = f"{WEIGHTS} is missing" if exists else "nothing is there"
    raise UserError(f"no model in {shown(path)}: {found}; expected {expected}")


def _is_workdir(folder: pathlib.Path) -> bool:
    return (folder / CONFIG).is_file() and any((folder / name).exists() for name in (BEST, LATEST, FAILED, RUN))


def _load_checkpoint(workdir: pathlib.Path, path: pathlib.Path) -> LoadedModel:
    """Load the checkpoint to which `path`, a workdir or a folder in it, refers."""
    from ha2g_jax.checkpoint.checkpoints import Checkpoints  # Orbax takes seconds to import; the demo does without

    config, assets = read_description(workdir)
    spec = build_networks(workdir, config, assets)
    kind, number = (*path.relative_to(workdir).parts, "", "")[:2]
    for name in (kind,) if kind else (BEST, LATEST):
        checkpoints = Checkpoints(workdir / name) if (workdir / name).is_dir() else None
        steps = [str(number) for number in checkpoints.steps()] if checkpoints else []
        if checkpoints and steps and number in ("", *steps):
            break
    else:
        raise UserError(f"no checkpoint in {shown(path)} yet; train longer, or use another run")
    variables, record = checkpoints.restore_model(int(number or steps[-1]), shapes_of(workdir, spec))
    checkpoints.close()
    speakers = {speaker: np.array(record["speakers"][speaker], np.float32) for speaker in assets.speakers}
    assets = dataclasses.replace(assets, speakers=speakers, hash=weights.hash_of(variables))
    return LoadedModel(spec, variables, assets, config)


def save(
    folder: str | pathlib.Path,
    config: Config,
    assets: Assets,
    variables: dict[str, Any],
    *,
    is_exact: bool = False,
) -> pathlib.Path:
    """Write a model folder atomically; its assets contain the hash of the weights.

    Weights are float32; unless `is_exact`, they are float16 if float32 would take more than 20 MB. Losses and settings
    of training are left out of the config.

    Raises:
        UserError: `folder` exists and is not empty, or cannot be written, for example because the disk is full.
    """
    folder = pathlib.Path(folder)
    with whole_folder(folder) as temporary:
        found = weights.write(temporary / WEIGHTS, variables, is_exact=is_exact)
        write_description(temporary, _settings_of_model(config), dataclasses.replace(assets, hash=found))
        (temporary / WEIGHTS).chmod(0o644)
    return folder


def read(folder: pathlib.Path) -> LoadedModel:
    """Read a model folder; tensors are read only after all sizes have been found to fit.

    Raises:
        UserError: a file is missing or damaged, or the files do not fit together.
    """
    config, assets = read_description(folder)
    shapes = weights.read_shapes(folder / WEIGHTS)
    spec = build_networks(folder, config, assets)
    with blaming(folder / ASSETS):
        assets_module.check_fit(assets, spec.num_seed_frames, spec.style_dim)
    with blaming(folder / WEIGHTS):
        found = weights.hash_of_file(folder / WEIGHTS)
    if found != assets.hash:
        raise UserError(
            f"{shown(folder / WEIGHTS)} has hash {found}, {ASSETS} says {assets.hash}: "
            "the files belong to two models; export or download the model again"
        )
    with blaming(folder / WEIGHTS):
        expected = {name: leaf.shape for name, leaf in weights.flatten(shapes_of(folder, spec)).items()}
        if difference := weights.compare(shapes, expected):
            raise ValueError(difference)
    return LoadedModel(spec, weights.read(folder / WEIGHTS), assets, config)


def write_description(folder: pathlib.Path, config: Config, assets: Assets) -> None:
    """Write the config and the assets of a model as config.json and assets.json.

    Raises:
        UserError: a file cannot be written; existing files then stay as they are.
    """
    for name, values in ((CONFIG, config_to_json(config)), (ASSETS, assets_module.to_json(assets))):
        write_text(folder / name, json.dumps(values, indent=1 if name == CONFIG else None) + "\n")


def config_to_json(config: Config) -> dict[str, Any]:
    """Return a config as the plain values of config.json."""
    return json.loads(config.to_json())


def read_description(folder: pathlib.Path) -> tuple[Config, Assets]:
    """Read the config and the assets of a model folder or a workdir.

    Raises:
        UserError: one of the files is missing or damaged.
    """
    config = read_config(folder)
    with blaming(folder / ASSETS):
        return config, assets_module.from_json(_read_json(folder / ASSETS, MAX_ASSETS_BYTES))


def read_config(folder: pathlib.Path) -> Config:
    """Read the config of a model folder or a workdir.

    Raises:
        UserError: config.json is missing or damaged.
    """
    with blaming(folder / CONFIG):
        return configs.from_json(_read_json(folder / CONFIG, MAX_CONFIG_BYTES))


def build_networks(folder: pathlib.Path, config: Config, assets: Assets) -> Spec:
    """Build the networks of a model folder or a workdir.

    Raises:
        UserError: the networks cannot be built.
    """
    try:
        return build(config, assets.skeleton, len(assets.vocabulary), len(assets.speakers))
    except UserError as error:
        raise UserError(f"{shown(folder / CONFIG)} cannot be used: {error}") from error


def shapes_of(folder: pathlib.Path, spec: Spec) -> Any:
    """Return the variables of a model as shapes.

    Raises:
        UserError: sizes pass all checks but do not fit together.
    """
    with blaming(folder / CONFIG):
        return variable_shapes(spec)


@contextlib.contextmanager
def blaming(path: pathlib.Path) -> Iterator[None]:
    """Turn an error while a file is read into a `UserError` that names the file."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, OSError, FlaxError) as error:
        cause = f"{reason(error)} is missing" if isinstance(error, KeyError) else reason(error)
        raise UserError(
            f"{shown(path)} is damaged or of another version ({cause}); export or download the model again"
        ) from error


def _read_json(path: pathlib.Path, max_bytes: int) -> Any:
    if not path.is_file():
        raise UserError(f"{shown(path)} is missing; export or download the model again")
    return parse_json(read_bytes(path, "part of a model", max_bytes))


def _settings_of_model(config: Config) -> Config:
    """Return the part of a config that the model is built from."""
    config = config.copy_and_resolve_references()
    config.unlock()
    for part in configs.TRAINING:
        if part in config:
            del config[part]
    return config

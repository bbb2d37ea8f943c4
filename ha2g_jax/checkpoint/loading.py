"""Loading of models by name: "demo", a model folder, hf://OWNER/NAME on the Hub, or the workdir of a training run.

A workdir stands for its best checkpoint on the validation split; WORKDIR/latest, WORKDIR/best, WORKDIR/failed and a
step below them name a particular checkpoint.
"""

import dataclasses
import importlib.resources
import os
import pathlib

import numpy as np

from ha2g_jax.checkpoint import BEST, CONFIG, FAILED, LATEST, RUN, WEIGHTS, hub, model_folder, weights
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reading, shown


def load(spec: str | pathlib.Path) -> LoadedModel:
    """Load a model: "demo", a model folder, a workdir, a checkpoint in a workdir, or hf://OWNER/NAME@REVISION.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    if hub.is_hub_name(spec):
        return model_folder.read(hub.fetch(str(spec)))
    if spec == "demo":
        folder = importlib.resources.files("ha2g_jax") / "assets" / "demo"
        with importlib.resources.as_file(folder) as path:
            if not path.is_dir():
                raise UserError("the demo model is not installed; install ha2g-jax again or name a --checkpoint")
            return model_folder.read(path)
    return load_path(spec, "'demo', a workdir of ha2g train or an exported folder")


def load_path(path: str | os.PathLike, expected: str) -> LoadedModel:
    """Load a model folder, a workdir, or a checkpoint in a workdir; a message says that `expected` may be named.

    Raises:
        UserError: there is no model, or it is damaged.
    """
    path = pathlib.Path(path)
    with reading(path, f"a model: {expected}"):
        is_folder, exists = (path / WEIGHTS).is_file(), path.exists()
        workdirs = [folder for folder in (path, path.parent, path.parent.parent) if _is_workdir(folder)]
    if is_folder:
        return model_folder.read(path)
    if workdirs:
        return _load_checkpoint(workdirs[0], path)
    if exists and path.suffix.lower() == ".onnx":
        raise UserError(f"{shown(path)} is for ha2g generate alone; give the model that it was exported from")
    found = f"{WEIGHTS} is missing" if exists else "nothing is there"
    raise UserError(f"no model in {shown(path)}: {found}; expected {expected}")


def _is_workdir(folder: pathlib.Path) -> bool:
    return (folder / CONFIG).is_file() and any((folder / name).exists() for name in (BEST, LATEST, FAILED, RUN))


def _load_checkpoint(workdir: pathlib.Path, path: pathlib.Path) -> LoadedModel:
    """Load the checkpoint that `path`, a workdir or a folder in it, stands for."""
    from ha2g_jax.checkpoint.checkpoints import Checkpoints  # Orbax takes seconds to import; the demo does without

    config, assets = model_folder.read_description(workdir)
    spec = model_folder.build_networks(workdir, config, assets)
    kind, number = (*path.relative_to(workdir).parts, "", "")[:2]
    for name in (kind,) if kind else (BEST, LATEST):
        checkpoints = Checkpoints(workdir / name) if (workdir / name).is_dir() else None
        steps = [str(number) for number in checkpoints.steps()] if checkpoints else []
        if checkpoints and steps and number in ("", *steps):
            break
    else:
        raise UserError(f"no checkpoint in {shown(path)} yet; train longer, or use another run")
    variables, record = checkpoints.restore_model(int(number or steps[-1]), model_folder.shapes_of(workdir, spec))
    checkpoints.close()
    speakers = {speaker: np.array(record["speakers"][speaker], np.float32) for speaker in assets.speakers}
    assets = dataclasses.replace(assets, speakers=speakers, hash=weights.hash_of(variables))
    return LoadedModel(spec, variables, assets, config)

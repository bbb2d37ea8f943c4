"""Check that a config fits its machine, its workdir and its corpus before a run starts rather than after hours."""

import contextlib
import pathlib
import reprlib

import jax
import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import STATISTICS, Assets
from ha2g_jax.config import settings
from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import FILE, Corpus
from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import file_sha256, reading, shown
from ha2g_jax.methods import METHODS, build
from ha2g_jax.methods.method import Spec
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train import run_record
from ha2g_jax.train.sharding import check_batch_size

# Settings that may differ from those that a workdir was made with, because they do not change the updates. A corpus may
# have moved; `check_corpus` checks that it is the same one.
_FREE_SETTINGS = {
    "data.path",
    "data.workers",
    "data.cache_gib",
    "train.steps",
    "train.log_every",
    "train.validate_every",
    "train.checkpoint_every",
    "train.sample_every",
    "train.keep",
    "train.wandb",
    "train.devices",
}
# Settings of the networks that are read with the data, and those that only a method with a discriminator reads.
_READ_WITH_THE_DATA = {"model.audio.weights", "model.text.vectors"}
_ADVERSARIAL = {"train.discriminator_learning_rate", "train.warmup_epochs"}
_NAMES_SHOWN = 6


def check_machine(config: Config) -> None:
    """Check that a config can be trained at all, and on the available devices.

    Raises:
        UserError: a setting is not possible, there are not enough devices, or a batch does not split over them.
    """
    settings.check(config)
    devices = jax.device_count()
    if config.train.devices > devices:
        raise UserError(
            f"there are {devices} devices, not {config.train.devices}: set --config.train.devices=0 to use all"
        )
    check_batch_size(config.train.batch_size, config.train.devices or devices)
    if config.train.devices and jax.process_count() > 1:
        raise UserError(
            f"config.train.devices is {config.train.devices}, but a run of {jax.process_count()} processes uses all "
            "devices: set --config.train.devices=0"
        )
    if config.train.wandb:
        require("wandb", "wandb", by="config.train.wandb")
    if config.train.sample_every and config.method not in METHODS:
        raise UserError(f"{config.method} generates no motion to show: set --config.train.sample_every=0")


def check_augmentation(config: Config, spec: Spec) -> None:
    """Check that the model takes the inputs that augmentation changes.

    Raises:
        UserError: the sound is to be changed, but the model takes no mel spectrogram; or ends of windows are
            hidden, but the model takes an input whose end cannot be hidden.
    """
    changes = [name for name in ("vocal_tract", "equalizer_db", "reverb", "noise", "gain_db") if config.data[name]]
    if changes and "mel" not in spec.training_inputs:
        raise UserError(
            f"{config.method} takes no mel spectrogram, which {', '.join(changes)} would change: set "
            + " ".join(f"--config.data.{name}=0" for name in changes)
        )
    inputs = set(spec.training_inputs)
    if config.data.lookahead and ("mel" not in inputs or inputs - {"mel", "words"}):
        raise UserError(
            f"{config.method} takes {', '.join(spec.training_inputs) or 'no speech'}, but only the end of a mel "
            "spectrogram and of its words can be hidden: set --config.data.lookahead=0"
        )


def check_changes(config: Config, preset: Config) -> None:
    """Check that each changed setting of the networks and of adversarial training has an effect on the method.

    Raises:
        UserError: one of them has none.
    """
    names = [row.name for row in settings.table(config.method)]
    changed = {
        name: value for name in names if (value := settings.value_of(preset, name)) != settings.value_of(config, name)
    }
    networks = [name for name in changed if name.startswith("model.") and name not in _READ_WITH_THE_DATA]
    adversarial = [name for name in changed if name in _ADVERSARIAL]
    if not (networks or adversarial):
        return
    skeleton = load_skeleton(config.skeleton)
    spec = build(config, skeleton, 1, 1)
    unread = [] if spec.discriminator else adversarial
    for name in networks:
        other = settings.change(config.copy_and_resolve_references().unlock(), {name: changed[name]})
        with contextlib.suppress(UserError):  # a change without which the networks are not possible is read
            unread += [name] if build(other, skeleton, 1, 1) == spec else []
    if unread:
        raise UserError(f"config.{unread[0]} changes nothing of {config.method} with these settings; leave it out")


def check_workdir(workdir: pathlib.Path, config: Config) -> None:
    """Check that the folder of a run is new or was made with the same config.

    Raises:
        UserError: the folder was made with another config (the message names the settings that differ), or the path
            cannot be a folder.
    """
    with reading(workdir, "a folder for a run, which --workdir names"):
        is_folder = workdir.is_dir()
    if not is_folder and (workdir.exists() or any(parent.is_file() for parent in workdir.parents)):
        raise UserError(f"{shown(workdir)} is not a folder; choose another --workdir")
    path = workdir / model_folder.CONFIG
    if not path.exists():
        return
    stored = model_folder.read_config(workdir)
    old, new = (traverse_util.flatten_dict(model_folder.config_to_json(values), sep=".") for values in (stored, config))
    # The learning rates of a cosine depend on where it ends.
    free = _FREE_SETTINGS - ({"train.steps"} if config.train.schedule == "cosine" else set())
    differing = [name for name in sorted(old.keys() | new.keys()) if old.get(name) != new.get(name)]
    if differing := [name for name in differing if name not in free]:
        changes = ", ".join(
            f"{name} ({reprlib.repr(old.get(name))} there, {reprlib.repr(new.get(name))} here)"
            for name in differing[:_NAMES_SHOWN]
        )
        changes += f" and {len(differing) - _NAMES_SHOWN} more" if differing[_NAMES_SHOWN:] else ""
        raise UserError(
            f"{shown(workdir)} was made with another config: {changes}; repeat its settings or choose another --workdir"
        )


def check_corpus(workdir: pathlib.Path, assets: Assets, corpus: Corpus) -> None:
    """Check that a run continues with the corpus that it started with.

    Raises:
        UserError: the corpus is a different one.
    """
    skeleton = corpus.skeleton
    same = assets.vocabulary.words == corpus.vocabulary().words and all(
        np.array_equal(getattr(assets.skeleton, name), getattr(skeleton, name)) for name in STATISTICS
    )
    if not same or run_record.corpus_of(workdir) not in (None, file_sha256(corpus.path / FILE)):
        raise UserError(
            f"{shown(workdir)} was started on another corpus than {shown(corpus.path)}: set --config.data.path to "
            "the corpus of its start or choose another --workdir"
        )

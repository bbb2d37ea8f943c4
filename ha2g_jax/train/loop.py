"""One training run, from a config to checkpoints: read `train` from top to bottom."""

import contextlib
import json
import math
import os
import pathlib
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

import jax
import numpy as np
import tqdm

from ha2g_jax.config import Config
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk.build import talk_path
from ha2g_jax.data.windows import Windows, batches
from ha2g_jax.errors import UserError
from ha2g_jax.text import Vocabulary, read_word_vectors
from ha2g_jax.train import model_folder, sharding
from ha2g_jax.train.assets import Assets, calm_starts, speaker_identities
from ha2g_jax.train.checkpoint import Checkpoints
from ha2g_jax.train.state import init_state
from ha2g_jax.train.task import TERMS, build_task
from ha2g_jax.train.validation import Validation
from ha2g_jax.train.writers import MetricsWriter, StepLog

METRICS = "metrics.jsonl"
VALIDATION = "val"

# Settings that may differ from those a workdir was made with: they leave the updates as they are.
_FREE_SETTINGS = ("train.steps", "train.log_every", "train.validate_every", "train.checkpoint_every", "train.keep")


def train(config: Config, workdir: str | os.PathLike) -> None:
    """Trains the model of a config, or continues where the run in `workdir` stopped.

    SIGTERM and Ctrl-C end the run after the step at hand with a checkpoint; the same command continues it, and the
    parameters are then those of a run that was never stopped. Found in the workdir afterwards: config.json,
    assets.json, metrics.jsonl, and checkpoints in latest/ and in best/ (best on the validation split).

    Args:
        config: see `ha2g_jax.config.paper`.
        workdir: folder of the run; made if there is none.

    Raises:
        UserError: the data cannot be used, `workdir` is of another config, or a loss is no longer finite.
    """
    workdir = pathlib.Path(workdir)
    check_workdir(workdir, config)
    check_settings(config)
    corpus = open_corpus(config)
    vocabulary, speakers = corpus.vocabulary(), list(corpus.speakers_of(TRAIN))
    windows = open_windows(config, corpus, vocabulary, TRAIN, jitter=config.data.jitter)
    validation_windows = open_windows(config, corpus, vocabulary, VALIDATION)
    batch_size, num_steps = config.train.batch_size, config.train.steps
    iterator = batches(windows, batch_size, config.seed)

    task = build_task(
        config,
        corpus.skeleton,
        len(vocabulary),
        len(speakers),
        steps_per_epoch=len(windows) // batch_size,
        word_vectors=_word_vectors(config, vocabulary),
    )
    mesh = sharding.data_mesh(_devices(config.train.devices))
    init_key, key = jax.random.split(jax.random.key(config.seed))
    state = sharding.replicate(mesh, init_state(task, init_key))
    step_function = sharding.compile_step(task, mesh)
    validate = Validation(task, mesh, validation_windows, batch_size)

    workdir.mkdir(parents=True, exist_ok=True)
    latest = Checkpoints(workdir / model_folder.LATEST, keep=config.train.keep)
    best = Checkpoints(workdir / model_folder.BEST)
    if latest.steps():
        state, record = latest.restore(latest.steps()[-1], state)
        iterator.set_state(record["iterator"])
    step = int(state.step)
    best_score = best.record(best.steps()[-1])["score"] if best.steps() else math.inf

    starts = calm_starts(windows, corpus.skeleton.mean_directions, config.data.num_seed_frames)
    no_styles = dict.fromkeys(speakers, np.zeros(0, np.float32))  # they come with each checkpoint
    model_folder.write_description(workdir, config, Assets(corpus.skeleton, vocabulary, no_styles, starts))
    writer = MetricsWriter(workdir / METRICS, step)

    def save(checkpoints: Checkpoints, **record: Any) -> None:
        styles = speaker_identities(task, state.generator.variables, windows, speakers)
        record["speakers"] = {name: f_id.tolist() for name, f_id in styles.items()}
        checkpoints.save(step, state, record | {"iterator": iterator.get_state()})

    bar = tqdm.tqdm(total=num_steps, initial=step, desc=config.name, unit="step", smoothing=0.05, disable=None)
    log = StepLog(writer, bar, batch_size, lambda step: _is_due(step, config.train.log_every, num_steps))
    with contextlib.closing(writer), contextlib.closing(latest), contextlib.closing(best), bar, _stop_signals() as stop:
        while step < num_steps and not stop.is_set():
            with log.timed():
                batch = sharding.shard_batch(mesh, next(iterator))
                state, metrics = step_function(state, batch, key)
                step += 1
                log.add(step, metrics)
            if _is_due(step, config.train.validate_every, num_steps):
                log.flush()
                scores = validate(state, key)
                writer.write(step, {f"validation/{name}": value for name, value in scores.items()})
                if scores[config.train.best_by] < best_score:
                    best_score = scores[config.train.best_by]
                    save(best, score=best_score)
            if _is_due(step, config.train.checkpoint_every, num_steps) or stop.is_set():
                log.flush()
                save(latest)
        if stop.is_set():
            tqdm.tqdm.write(f"stopped at step {step} of {num_steps}; the same command continues", file=sys.stderr)


def open_corpus(config: Config) -> Corpus:
    """The corpus of a config; "talk" is made where there is none yet.

    Raises:
        UserError: there is none, it is damaged, or it has another skeleton or frame rate than the config.
    """
    if not config.data.path:
        raise UserError("the config names no data: set --config.data.path to 'talk' or to the folder of a corpus")
    corpus = Corpus.open(talk_path(config.data.path))
    found, expected = (corpus.skeleton.name, corpus.fps), (config.skeleton, config.data.fps)
    if found != expected:
        raise UserError(
            f"{corpus.path} has skeleton {found[0]} at {found[1]:g} fps, "
            f"the config {expected[0]} at {expected[1]:g} fps: choose the config that fits the data"
        )
    return corpus


def open_windows(config: Config, corpus: Corpus, vocabulary: Vocabulary, split: str, jitter: int = 0) -> Windows:
    """The windows of a split in the shapes that the config asks for.

    Raises:
        UserError: the split does not have them, or has speakers that a table of training speakers cannot know.
    """
    has_images = config.model.identity.kind == "images"
    windows = Windows(
        corpus,
        split,
        vocabulary,
        num_frames=config.data.num_frames,
        num_reference_frames=config.data.num_seed_frames,
        image_size=config.data.image_size if has_images else None,
        jitter=jitter,
    )
    strangers = set(corpus.speakers_of(split)) - set(corpus.speakers_of(TRAIN))
    if strangers and not has_images:
        raise UserError(
            f"split {split!r} has {len(strangers)} speakers that the table of training speakers lacks, such as "
            f"{min(strangers)}: divide the data by talks, or set --config.model.identity.kind=images"
        )
    return windows


def check_settings(config: Config) -> None:
    """Looks at the settings that would otherwise fail only after hours.

    Raises:
        UserError: one of them cannot be used.
    """
    for name in ("steps", "batch_size", "log_every", "validate_every", "checkpoint_every", "keep"):
        if config.train[name] < 1:
            raise UserError(
                f"config.train.{name} is {config.train[name]}, expected at least 1: set --config.train.{name}"
            )
    terms = [f"loss/{name}" for name in (*TERMS, "total")]
    if config.train.best_by not in terms:
        raise UserError(f"config.train.best_by is {config.train.best_by!r}, expected one of {', '.join(terms)}")


def check_workdir(workdir: pathlib.Path, config: Config) -> None:
    """Sees that the folder of a run is new or was made with the same config.

    Raises:
        UserError: it was made with another config, whose differing settings are named, or cannot be a folder.
    """
    if not workdir.is_dir() and (workdir.exists() or any(parent.is_file() for parent in workdir.parents)):
        raise UserError(f"{workdir} is no folder; choose another --workdir")
    path = workdir / model_folder.CONFIG
    if not path.exists():
        return
    try:
        old = _flat(json.loads(path.read_text()))
    except ValueError as error:
        raise UserError(f"{path} is damaged ({error}); choose another --workdir") from error
    new = _flat(model_folder.config_to_json(config))
    differing = [name for name in sorted(old.keys() | new.keys()) if old.get(name) != new.get(name)]
    if differing := [name for name in differing if name not in _FREE_SETTINGS]:
        changes = ", ".join(f"{name} ({old.get(name)} there, {new.get(name)} here)" for name in differing)
        raise UserError(
            f"{workdir} is a run with another config: {changes}; repeat its settings or choose another --workdir"
        )


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _word_vectors(config: Config, vocabulary: Vocabulary) -> np.ndarray | None:
    text = config.model.text
    return read_word_vectors(text.vectors, vocabulary, text.embedding_dim) if text.vectors else None


def _devices(count: int) -> list:
    devices = jax.devices()
    if not 0 <= count <= len(devices):
        raise UserError(f"there are {len(devices)} devices, not {count}: set --config.train.devices=0 for all")
    return devices[: count or len(devices)]


def _is_due(step: int, every: int, last: int) -> bool:
    return step % every == 0 or step == last


@contextlib.contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """An event that SIGTERM or Ctrl-C sets; a second Ctrl-C interrupts at once."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():  # where Python allows no signal handlers
        yield stop
        return
    previous = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def handle(number: int, _: FrameType | None) -> None:
        stop.set()
        signal.signal(number, previous[signal.Signals(number)])

    for number in previous:
        signal.signal(number, handle)
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)

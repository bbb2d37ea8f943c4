"""One training run, from a config to checkpoints; `_train` reads from top to bottom."""

import contextlib
import dataclasses
import functools
import json
import math
import os
import pathlib
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import tqdm
from jax.sharding import Mesh

from ha2g_jax.checkpoint import ASSETS, BEST, FAILED, LATEST, model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.checkpoints import Checkpoints
from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.config.settings import Config
from ha2g_jax.data.batches import batch_names, check_batch
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import write_text
from ha2g_jax.methods.method import Spec
from ha2g_jax.progress import progress_bar, stage
from ha2g_jax.stopping import Stop, stop_after_step
from ha2g_jax.train import fits, hosts, inputs, run_record, sharding
from ha2g_jax.train.log import NotFinite, StepLog, Writer
from ha2g_jax.train.measure import Profile
from ha2g_jax.train.objective import Objective, build_objective, init_state
from ha2g_jax.train.workdir import VALIDATION_PREFIX, only_run

SAMPLES, PROFILE = "samples", "profile"

_NAMES_SHOWN = 8
_SETTLING = 30  # batches before a validation from which the BatchNorm statistics of the average are measured
_LINE_SECONDS = 60.0  # seconds between two progress lines if stderr is not a terminal


def train(
    config: Config,
    workdir: str | os.PathLike,
    *,
    profile: bool = False,
    draw_sample: Callable[..., None] | None = None,
) -> None:
    """Train the model of a config, or continue where the run in `workdir` stopped.

    SIGTERM and Ctrl-C end the run with a checkpoint after the current step. The same command continues the run, and the
    parameters are then those of a run that was never stopped. The workdir contains config.json, assets.json, run.json,
    metrics.jsonl, tensorboard/, checkpoints in latest/ and, if there is a validation split, in best/, and samples/ if
    the config sets `train.sample_every`. All hosts of a run call this function with the same arguments.

    Args:
        config: settings, see `ha2g_jax.config.settings`.
        workdir: folder of the run, which is made if it does not exist.
        profile: whether to write a trace of a few steps to profile/.
        draw_sample: function that writes a video of a clip, such as `ha2g_jax.evaluation.samples.write_sample`.

    Raises:
        UserError: the data cannot be used, `workdir` was made with another config or another process trains in it, a
            file cannot be written, or a loss is not finite.
    """
    with stop_after_step() as stop, contextlib.ExitStack() as held:
        _train(config, pathlib.Path(workdir), stop, held, profile, draw_sample)


def _train(
    config: Config,
    workdir: pathlib.Path,
    stop: Stop,
    held: contextlib.ExitStack,
    profile: bool,
    draw_sample: Callable[..., None] | None,
) -> None:
    fits.check_machine(config)
    fits.check_workdir(workdir, config)
    corpus = inputs.open_corpus(config)
    vocabulary, speakers = corpus.vocabulary(), list(corpus.speakers_of(TRAIN))
    objective = build_objective(config, corpus.skeleton, len(vocabulary), len(speakers))
    spec = objective.spec
    fits.check_augmentation(config, spec)
    latest = Checkpoints(workdir / LATEST, keep=config.train.keep)
    # A checkpoint has these weights already, and their files may be gone.
    pretrained = {} if latest.steps() else inputs.pretrained(config, spec, vocabulary)
    windows = inputs.open_windows(config, spec, corpus, TRAIN)
    check_batch(config.train.batch_size, windows)
    held_out = inputs.open_validation(config, spec, corpus)
    if held_out is None and hosts.is_first():
        tqdm.tqdm.write(
            f"{corpus.path} has no split {inputs.VALIDATION!r} that this model can use, so there will be no best "
            "checkpoint; make the split with ha2g data split, from training speakers if the model has a table of them",
            file=sys.stderr,
        )
    batch_size, num_steps = config.train.batch_size, config.train.steps
    if hosts.is_first():
        held.enter_context(only_run(workdir))

    stop.enter_compiler()
    warmup_steps = min(config.train.warmup_epochs * (len(windows) // batch_size), num_steps)
    objective = dataclasses.replace(objective, warmup_steps=warmup_steps)
    mesh = sharding.data_mesh(jax.devices()[: config.train.devices or None])
    init_key, key = jax.random.split(jax.random.key(config.seed))
    validate = Validation(objective, mesh, held_out, batch_size) if held_out else None
    step_function = sharding.compile_step(objective, mesh)
    settle = sharding.compile_settling(objective, mesh) if objective.average_decay else None
    assets = _assets(config, workdir, corpus, windows, spec)

    best = Checkpoints(workdir / BEST)
    fresh = functools.partial(init_state, objective, init_key, pretrained)
    found = latest.restore_newest(sharding.whole(mesh, jax.eval_shape(fresh)))
    with _stage("initialising the networks"):
        state, record = found or (sharding.replicate(mesh, fresh()), {})
    if config.train.init_from and not found and hosts.is_first():
        tqdm.tqdm.write(f"training starts from the weights of {config.train.init_from}", file=sys.stderr)
    step, best_score = int(state.step), record.get("best_score", math.inf)
    if not any(each <= step for each in best.steps()):
        best_score = math.inf
    if step > num_steps:
        raise UserError(
            f"{shown(workdir)} is at step {step}, beyond config.train.steps, which is {num_steps}: set "
            "--config.train.steps to more, or choose another --workdir"
        )
    batches = inputs.training_batches(config, windows, step)
    if hosts.is_first():
        if found:
            tqdm.tqdm.write(f"continuing at step {step} of {num_steps}", file=sys.stderr)
        best.drop_after(step)
        model_folder.write_description(workdir, config, assets)
        run_record.write(workdir, config, step, corpus)
        held.enter_context(run_record.noting_failure(workdir))

    writer = Writer(workdir, step, config, hosts.is_first())
    bar = progress_bar(
        config.name,
        num_steps,
        "step",
        initial=step,
        is_shown=hosts.is_first(),
        leave=True,
        line_seconds=_LINE_SECONDS,
    )
    log = StepLog(
        writer,
        bar,
        batch_size,
        lambda step: _is_due(step, config.train.log_every, num_steps),
        config.train.best_by.removeprefix("loss/"),
        pending=record.get("log"),
    )
    split, drawn = (inputs.VALIDATION, held_out) if held_out else (TRAIN, windows)
    sample_every = config.train.sample_every if draw_sample and hosts.is_first() else 0
    sample_clip = corpus.clips(split)[drawn.clip_index(0)] if sample_every else None
    trace = Profile(workdir / PROFILE if profile and hosts.is_first() else None)

    def trained() -> tuple[Any, Assets]:
        """Return the variables as arrays of this host, and the assets with the styles of the speakers."""
        variables = jax.device_get(state.model)
        return variables, dataclasses.replace(
            assets, speakers=inputs.speaker_styles(spec, variables, windows, speakers)
        )

    def save(checkpoints: Checkpoints, **more: Any) -> None:
        taken = int(state.step)  # less than `step` after a step that was not finite
        styles = {name: f_id.tolist() for name, f_id in trained()[1].speakers.items()}
        record = {"log": log.state(), "best_score": best_score, "speakers": styles}
        checkpoints.save(taken, state, record | more)

    with contextlib.ExitStack() as stack:
        for resource in (writer, latest, best, bar, trace, batches):
            stack.callback(resource.close)
        try:
            while step < num_steps and not log.is_stopping:
                with log.waiting():
                    batch = sharding.shard_batch(mesh, next(batches))
                is_first = not stop.has_begun
                with (
                    _stage("compiling the training step, which takes minutes on a CPU", is_first),
                    log.stepping(),
                    trace.step(step),
                ):
                    state, metrics = step_function(state, batch, key, stop.is_set())
                stop.begin()
                step += 1
                log.add(step, metrics)
                with log.apart():
                    latest.check()
                    best.check()
                    if settle and _until_due(step, config.train.validate_every, num_steps) < _SETTLING:
                        state = settle(state, batch, key)
                    if validate and _is_due(step, config.train.validate_every, num_steps):
                        log.flush()
                        with _stage("validating"):
                            scores = validate(state, key)
                        writer.write(step, {f"{VALIDATION_PREFIX}{name}": value for name, value in scores.items()})
                        if scores[config.train.best_by] < best_score:
                            best_score = scores[config.train.best_by]
                            save(best)
                    if draw_sample and sample_every and _is_due(step, sample_every, num_steps):
                        draw_sample(workdir / SAMPLES, step, spec, *trained(), config, sample_clip)
                    if _is_due(step, config.train.checkpoint_every, num_steps):
                        log.flush()
                        save(latest)
            log.flush()
            save(latest)
        except NotFinite as error:
            names = batch_names(windows, batch_size, config.seed, int(state.step))
            raise _failure(error, names, workdir, save) from error
    if step < num_steps and hosts.is_first():
        tqdm.tqdm.write(f"stopped at step {step} of {num_steps}; the same command continues", file=sys.stderr)


def _stage(text: str, is_shown: bool = True) -> contextlib.AbstractContextManager[None]:
    """Return a context whose work is shown on stderr by the first host."""
    return stage(text) if is_shown and hosts.is_first() else contextlib.nullcontext()


def _assets(config: Config, workdir: pathlib.Path, corpus: Corpus, windows: Windows, spec: Spec) -> Assets:
    """Return the assets that the run started with, or new ones; each checkpoint stores the styles of the speakers."""
    if (workdir / ASSETS).exists():
        assets = model_folder.read_description(workdir)[1]
        fits.check_corpus(workdir, assets, corpus)
        return assets
    starts = inputs.calm_seed_poses(windows, corpus.skeleton.mean_directions, config.data.num_seed_frames)
    named = corpus.speakers_of(TRAIN) if config.model.identity.kind != "none" else ()
    no_styles = dict.fromkeys(named, np.zeros(0, np.float32))
    return Assets(corpus.skeleton, corpus.vocabulary(), no_styles, starts)


def _failure(error: NotFinite, names: list[str], workdir: pathlib.Path, save: Callable[..., None]) -> UserError:
    """Store the state before the failed step and the names of its windows; return the error for the user."""
    report = {"step": error.step, "not_finite": list(error.names), "windows": names}
    folder = workdir / FAILED
    with contextlib.closing(Checkpoints(folder)) as failed:
        save(failed, failure=report)
    if hosts.is_first():
        write_text(folder.with_suffix(".json"), json.dumps(report, indent=1) + "\n")
    first = ", ".join(names[:_NAMES_SHOWN])
    more = f" and {len(names) - _NAMES_SHOWN} more" if names[_NAMES_SHOWN:] else ""
    return UserError(
        f"{', '.join(error.names)} not finite at step {error.step}, on the windows {first}{more}: the state before it "
        f"is in {folder}, the report in {folder}.json; check these windows, or start again in another "
        "workdir with a lower --config.train.learning_rate"
    )


def _is_due(step: int, every: int, last: int) -> bool:
    return _until_due(step, every, last) == 0


def _until_due(step: int, every: int, last: int) -> int:
    return min(-step % every, last - step)


class Validation:
    """Means of the terms of the objective over a split, in the same batches every time.

    Windows that do not fill a batch are left out; batches are smaller if the split has fewer windows.

    Raises:
        UserError: there are fewer windows than devices.
    """

    def __init__(self, objective: Objective, mesh: Mesh, windows: Windows, batch_size: int):
        self._mesh, self._windows = mesh, windows
        self._step = sharding.compile_validation_step(objective, mesh)
        size = min(batch_size, len(windows) // mesh.size * mesh.size)
        if not size:
            raise UserError(
                f"the validation split has {len(windows)} windows for {mesh.size} devices: "
                "use more data or set --config.train.devices=1"
            )
        order = np.random.default_rng(0).permutation(len(windows))  # so that a batch has many speakers, as in training
        batches = order[: len(order) // size * size].reshape(-1, jax.process_count(), size // jax.process_count())
        self._batches = batches[:, jax.process_index()]  # this host's rows of each batch

    def __call__(self, state: TrainState, key: jax.Array) -> dict[str, float]:
        """Return the mean over the split of each term of `validation_step`, by name."""
        metrics = []
        for number, indices in enumerate(self._batches):
            examples = [self._windows[index] for index in indices]
            batch = {name: np.stack([example[name] for example in examples]) for name in examples[0]}
            metrics.append(self._step(state, sharding.shard_batch(self._mesh, batch), jax.random.fold_in(key, number)))
        metrics = jax.device_get(metrics)
        return {name: float(np.mean([terms[name] for terms in metrics])) for name in metrics[0]}

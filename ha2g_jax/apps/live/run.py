"""A live run: sound from a source goes through the stream of a model, and its frames go to the sinks."""

import contextlib
import gc
import itertools
import math
import sys
from typing import Any

import numpy as np
from tqdm import tqdm

from ha2g_jax import __version__
from ha2g_jax.apps.live.clock import Clock, StopFlag, Timeline
from ha2g_jax.apps.live.frames import Frame, Interpolation, Rigs
from ha2g_jax.apps.live.pieces import Change, held_back
from ha2g_jax.apps.live.sender import Meter, Sender
from ha2g_jax.apps.live.sinks import Sinks
from ha2g_jax.apps.live.sources import Source
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.limits import MAX_MOTION_SECONDS
from ha2g_jax.motion import control
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD
from ha2g_jax.progress import progress_bar, stage
from ha2g_jax.stopping import STOP_SIGNALS, on_stop_signals
from ha2g_jax.synthesis import Model, Stream, Style, choose_style
from ha2g_jax.synthesis.style import RANDOM

_LONGEST_DELAY = 10.0  # seconds
_READY = 0.2  # seconds before its time at which a frame is computed, where the delay allows it
_AT_ONCE = 0.25  # seconds of frames that are converted before the first of them is sent
_METER_SECONDS = 1.0  # between two values of the meter
_REMEMBERED_SECONDS = 5.0  # of the times of the sound, beyond the latency


def run(
    model: Model,
    source: Source,
    sinks: Sinks,
    *,
    look_ahead: int = DEFAULT_LOOK_AHEAD,
    hop: int = DEFAULT_HOP,
    style: Style = RANDOM,
    seed: int = 0,
    controls: control.Controls = control.NEUTRAL,
    muted: bool = False,
    state: str = "auto",
    delay: float | None = None,
    fps: int | None = None,
    stop: StopFlag | None = None,
) -> Meter:
    """Generate motion for sound while it is heard, until its end or until Ctrl-C, SIGTERM or a closed terminal.

    Each frame is sent `delay` seconds after its moment of the sound is heard, or when it is computed if that is later.
    Frames that are more than a second late are dropped. Recordings take all frames.

    Args:
        model: model that needs nothing but sound.
        source: sound.
        sinks: where the frames go.
        look_ahead, hop, style, seed, controls: see `Model.stream`.
        muted, state: see `Stream`; until the source says otherwise.
        delay: seconds by which the sound is played later than the source gives it; by default the least, the latency of
            the stream plus the delay of the interpolation, with which frames leave when they are computed.
        fps: frames per second that are sent, by default those of the model; other rates are interpolated.
        stop: flag that can end the run; afterwards it holds the signal that ended it.

    Returns:
        Counts of the run.

    Raises:
        UserError: an argument cannot be used, or there was no sound.
        KeyboardInterrupt: Ctrl-C before there was sound.
    """
    stop = stop or StopFlag()
    with stage("compiling the model"):
        stream = model.stream(look_ahead=look_ahead, hop=hop, style=style, seed=seed, controls=controls)
    stream.muted, stream.state = muted, state
    interpolation = Interpolation(stream.fps, stream.fps if fps is None else fps)
    latency = stream.latency + interpolation.delay
    if delay is not None and not latency <= delay <= _LONGEST_DELAY:
        raise UserError(
            f"the delay is {delay:g} s; give {math.ceil(1000 * latency) / 1000:g} s, the latency of this look-ahead, "
            f"hop and frame rate, to {_LONGEST_DELAY:g} s"
        )
    with on_stop_signals(stop.ask, once=STOP_SIGNALS):  # a second Ctrl-C interrupts at once
        gc.freeze()  # scanning all objects of the model would delay a frame by half a second
        try:
            meter = _follow(stream, source, sinks, interpolation, latency if delay is None else delay, stop)
        finally:
            gc.unfreeze()
    if meter.sound_seconds == 0:
        if stop.signal:
            raise KeyboardInterrupt
        raise UserError(f"no sound from {source.name}; is it connected to something that speaks?")
    meta = {
        "version": __version__,
        "model": model.config.name,
        "checkpoint": model.assets.hash,
        "speech": source.name,
        "duration": min(meter.sound_seconds, MAX_MOTION_SECONDS),
        "style": choose_style(model.spec, model.variables, model.assets, style, seed)[1],
        "seed": seed,
        "look_ahead": look_ahead,
        "hop": hop,
    }
    asked = control.describe(controls)
    for recording in sinks.recordings:
        recording.save(stream.skeleton, stream.fps, meta | ({"controls": asked} if asked else {}))
    return meter


def _follow(
    stream: Stream, source: Source, sinks: Sinks, interpolation: Interpolation, delay: float, stop: StopFlag
) -> Meter:
    """Send and record the frames of all sound of a source; recordings have the frames of the model."""
    latency, fps = stream.latency + interpolation.delay, interpolation.target
    clock, meter = Clock(), Meter(latency)
    rigs = Rigs(stream.skeleton, fps, [sink.rig for sink in sinks.senders])
    timeline = Timeline(latency + _REMEMBERED_SECONDS)
    numbers, at_once = itertools.count(), math.ceil(_AT_ONCE * fps)
    most = round(MAX_MOTION_SECONDS * stream.fps)  # frames of a recording

    def emit(directions: np.ndarray) -> None:
        for recording in sinks.recordings:
            recording.add(directions[: max(most - meter.computed, 0)])
        if sinks.recordings and meter.computed < most <= meter.computed + len(directions):
            tqdm.write(f"the recording is full at {MAX_MOTION_SECONDS} s; the run goes on", file=sys.stderr)
        meter.computed += len(directions)
        send(interpolation.add(directions))

    def send(frames: np.ndarray) -> None:
        for poses in np.split(frames, range(at_once, len(frames), at_once)):
            if stop.is_asked() or not sinks.senders:
                return
            converted = _timed(meter, clock, rigs.convert, poses)
            for pose, number, animations in zip(poses, numbers, converted):
                seconds = number / fps
                frame = Frame(number, seconds, timeline.heard(seconds), stream.skeleton, pose, animations)
                sender.put(frame, stop)

    held = delay - latency - _READY if source.is_timed else 0.0
    wanted = delay if source.is_timed else None
    with (
        contextlib.closing(Sender(sinks.senders, fps, wanted, stream.hop / stream.fps, clock, meter)) as sender,
        progress_bar("live") as bar,
        contextlib.closing(source.chunks(clock, stop)) as chunks,
    ):
        shown = clock.now()
        for chunk in held_back(chunks, held, clock) if held > 0 else chunks:
            timeline.add(len(chunk.samples), chunk.heard)
            if chunk.change is not None:
                _change(stream, chunk.change)
            emit(_timed(meter, clock, stream.feed, chunk.samples, chunk.other))
            meter.sound_seconds, meter.lost_seconds = timeline.num_samples / SAMPLE_RATE, source.lost_seconds
            if clock.now() - shown >= _METER_SECONDS:
                shown = clock.now()
                bar.set_description_str(meter.line())
        if timeline.num_samples:
            emit(_timed(meter, clock, stream.flush))
            send(interpolation.end())
        sender.finish(stop)
    return meter


def _change(stream: Stream, change: Change) -> None:
    """Change a stream as its sender requests."""
    stream.muted = stream.muted if change.muted is None else change.muted
    stream.state = change.state or stream.state
    if change.clear:
        stream.clear()
    if change.cue is not None:
        try:
            stream.cue(change.cue)
        except UserError as error:  # too many wait
            tqdm.write(str(error), file=sys.stderr)


def _timed(meter: Meter, clock: Clock, function: Any, *arguments: np.ndarray | None) -> Any:
    """Call a function and count its time as that of the computation."""
    before = clock.now()
    result = function(*arguments)
    meter.compute_seconds += clock.now() - before
    return result

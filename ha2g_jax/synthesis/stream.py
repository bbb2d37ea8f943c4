"""Motion from speech that arrives in pieces, while someone speaks.

The generator runs on a window of N frames each time that `hop` more frames can be made; the first M are the seed pose,
as the windows before generated them. A model that was trained with hidden ends has its new frames right after the seed
pose, and the speech after them that has not been heard is hidden, see `features.spectrum`. Any other model has them at
the end of a window that has been heard, and what is before them was generated before. What is computed depends on the
samples so far and not on how they were cut into pieces.

Small errors of windows that begin every few frames add up in a pause, so that a stream rests by rule: where no sound is
near, its frames ease to the pose in which the model rests in a silent file, which breathes and sways a little, and the
generator is not run. What a state adds to such frames, as shifts, a nod or a raised hand, is added to the frames that
are returned, not to those that the generator continues; so it does not change the motion of speech.
"""

import collections
import math
import numbers
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.errors import UserError, check_number
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.phrases import Phrases
from ha2g_jax.features.spectrum import (
    RunningMel,
    hide_unheard,
    window_column,
    window_columns,
)
from ha2g_jax.methods.method import Spec, Variables
from ha2g_jax.motion.control.controls import NEUTRAL, Controls
from ha2g_jax.motion.control.effects import EASE, Ramp, RunningControls, check_running
from ha2g_jax.motion.cues import MOST, Cue, RunningCues, check_cue, keyframes_of
from ha2g_jax.motion.idle import idle
from ha2g_jax.motion.resample import num_frames, slerp
from ha2g_jax.motion.rotations import prepare
from ha2g_jax.motion.smoothing import minimum_jerk
from ha2g_jax.motion.states import ATTENTION, RunningStates, nod_depths
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD, RunningJoin
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.synthesis.running_generator import RunningGenerator
from ha2g_jax.synthesis.style import RANDOM, Style, check_seed

_MAX_SKIP_SECONDS = 3600.0
_PAUSE_SECONDS = 0.3  # after the last sound, and before the hands begin to rest
_REMEMBERED_SECONDS = 60  # of returned frames, to which `Stream.clear` can go back


class _Frame(NamedTuple):
    """A frame before its controls, what its time has of the agent's speech, and what it owes to the other."""

    pose: np.ndarray
    weight: float
    is_addressed: bool = False
    nod: float = 0.0


class _Layers(NamedTuple):
    """What is added to the frames that are returned, in this order."""

    controls: RunningControls
    states: RunningStates
    cues: RunningCues

    def copy(self) -> "_Layers":
        return _Layers(self.controls.copy(), self.states.copy(), self.cues.copy())


class _Returned(NamedTuple):
    """The pose of a frame that was returned, without what the layers added, and these as they were before it."""

    pose: np.ndarray
    layers: _Layers


class Stream:
    """Motion that follows speech, see `Model.stream`.

    Frame k shows the time k / fps, as in `Model.generate`. Frames are made `hop` at a time: those of one hop use the
    speech up to `look_ahead` frames after the last of them, and no later sample. With a hop of 1, frame k depends on no
    sample after (k + look_ahead) / fps, and is returned by the first `feed` that reaches this time. Only without any
    look-ahead a frame is returned half a frame later, because a shorter motion would not have it.

    Where the agent does not speak, the body does what `state` says, and listens to the other whose samples `feed` gets.
    In frames of speech nothing is added.

    With a hop of `window_stride` and a look-ahead of N, the frames of a model without noise are those of
    `Model.generate` for speech that begins M frames later, if `reference` is the maximum of the clip and the speech has
    no long pauses.

    Attributes:
        spec: networks and sizes of the model.
        look_ahead: frames of speech that are heard beyond the last new frame.
        hop: frames generated in one run.
        muted: whether the arms rest; may be assigned at any time.
    """

    def __repr__(self) -> str:
        return f"Stream({self.spec.method}, {self.fps} fps, look-ahead {self.look_ahead}, hop {self.hop})"

    def __init__(
        self,
        spec: Spec,
        variables: Variables,
        assets: Assets,
        *,
        look_ahead: int = DEFAULT_LOOK_AHEAD,
        hop: int = DEFAULT_HOP,
        style: Style = RANDOM,
        seed: int = 0,
        controls: Controls = NEUTRAL,
        reference: float | None = None,
        has_hidden_ends: bool = False,
    ):
        _check(spec, look_ahead, hop, reference)
        look_ahead, hop, seed = int(look_ahead), int(hop), check_seed(seed)
        prepare()
        self.spec, self.look_ahead, self.hop, self.muted = spec, look_ahead, hop, False
        self._seed, self.controls = seed, controls
        self._generator = RunningGenerator(spec, variables, assets, style, seed, hop)  # no frame waits for a compiler
        self._weight_ramp: Ramp | None = None  # of the motion, from rest; begins at the first frame
        self._layers = _Layers(
            RunningControls(self.skeleton, self.fps, controls),
            RunningStates(self.skeleton, self.fps, seed),
            RunningCues(self.skeleton, self.fps),
        )
        self._phrases: Phrases | None = None  # of the other; begin with the first samples of the other
        first = spec.num_seed_frames
        if not has_hidden_ends:  # the window ends where the speech that is heard ends
            first = min(max(first, spec.num_frames - look_ahead - hop + 1), spec.num_frames - hop)
        self._join = RunningJoin(spec.num_frames, spec.num_seed_frames, hop, first, look_ahead)
        longest = spec.num_frames + look_ahead  # frames from the start of a window to what is heard
        self._mel = RunningMel(window_columns(longest, self.fps) + window_column(_PAUSE_SECONDS, 1) + 2, reference)
        # The frames before the next new one, from the start of its window on.
        pose = self._generator.start_pose
        self._past = np.concatenate([pose[:1]] * max(first - len(pose), 0) + [pose])
        self._num_samples = self._num_made = self._num_returned = 0
        self._held: list[_Frame] = []  # frames that were made
        self._expected = [_Frame(pose, 0.0) for pose in self._past[self._join.first :]]  # as the next ones may become
        self._dropped, self._first_dropped = self._past[:0], 0  # poses of frames from which a clear goes on
        recent = [_Returned(pose, self._layers) for pose in self._past[: self._join.first]]
        self._recent = collections.deque(recent, self._join.first + _REMEMBERED_SECONDS * self.fps)
        self._is_ended = False

    @property
    def fps(self) -> int:
        """Frames per second, those of the model."""
        return self.spec.fps

    @property
    def skeleton(self) -> Skeleton:
        """Skeleton of the frames."""
        return self.spec.skeleton

    @property
    def latency(self) -> float:
        """Seconds from a moment of the speech to its frame at most, without the time of the computation.

        It is (look_ahead + hop) / fps, but not less than 1.5 / fps.
        """
        return max(self.look_ahead + self.hop, 1.5) / self.fps

    @property
    def controls(self) -> Controls:
        """Energy, extent, handedness and mirror; a new value takes effect with the next frames, within half a second.

        Raises:
            UserError: a control is not valid, or is a pin or a mute.
        """
        return self._controls

    @controls.setter
    def controls(self, controls: Controls) -> None:
        check_running(controls, self.skeleton)
        self._controls = controls

    @property
    def style(self) -> Style:
        """Requested style; a new value takes effect with the next frames, within half a second.

        Raises:
            UserError: the style cannot be used, see `choose_style`.
        """
        return self._generator.style

    @style.setter
    def style(self, style: Style) -> None:
        self._generator.style = style

    @property
    def state(self) -> str:
        """What the body does where the agent does not speak; a new value takes effect with the next frames.

        "idle", "listen" or "think"; or "auto", which listens while the other's voice is near and idles otherwise.
        "think" becomes "auto" with the next speech. Transitions take 0.4 s.

        Raises:
            UserError: the state is none of these.
        """
        return self._layers.states.state

    @state.setter
    def state(self, state: str) -> None:
        self._layers.states.state = state

    def feed(self, samples: np.ndarray, other: np.ndarray | None = None) -> np.ndarray:
        """Take the next samples, and return the frames that became final.

        Args:
            samples: (samples,) float mono samples at 16 kHz, any number of them, within -1 and 1. Those that are NaN or
                infinite are taken as silence, those beyond -1 and 1 are clipped.
            other: (samples,) of the person who is spoken with, at the same times; None for silence.

        Returns:
            (n, bones, 3) float32 unit vectors, the frames after those that were returned before; n may be 0.

        Raises:
            UserError: the samples have another shape or type, the stream has ended, or the values of the model are not
                finite.
        """
        samples = self._checked(samples)
        if other is not None:
            other = self._checked(other)
            if len(other) != len(samples):
                raise UserError(f"{len(other)} samples of the other; expected {len(samples)}, as many as of the agent")
            self._phrases = self._phrases or Phrases(2 * self.spec.num_frames / self.fps + 2, self._num_samples)
        elif self._phrases:
            other = np.zeros_like(samples)
        frames = [*self._held]
        start = 0
        while (end := start + max(self._needed() - self._num_samples, 0)) <= len(samples):
            self._hear(samples[start:end], None if other is None else other[start:end])
            frames += self._run()[: self.hop]
            start = end
        self._hear(samples[start:], None if other is None else other[start:])
        # A motion of the speech so far has this many frames; later ones wait, as the speech may end here.
        return self._return(frames, round(self._num_samples / SAMPLE_RATE * self.fps))

    def cue(self, cue: Cue | str, at: float | None = None) -> None:
        """Make a gesture whose stroke peaks at a time of the motion; it is blended into the frames after the controls.

        Args:
            cue: what to make, or its name, such as "nod" or "count:3", see `motion.cues`; a clip is read with
                `motion.cues.reading.read_clip`.
            at: seconds from the beginning of the motion, by default the time of the cue. None, and a time that is over
                or too near, is as soon as possible: about half a second from the next frame on.

        Raises:
            UserError: there is no such gesture, the time is not a number of seconds, the cue is on a word, the
                motion of a clip has not been read, or 64 cues wait already.
        """
        asked = cue if isinstance(cue, Cue) else Cue(cue)
        asked = check_cue(asked if at is None else asked._replace(time=at))
        if asked.word is not None:
            raise UserError(f"the cue {asked.name} is on a word, and a stream has none; give a time, or leave both out")
        if self._layers.cues.num_waiting >= MOST:
            raise UserError(f"{MOST} cues wait to be made; give {asked.name} when one of them has begun, or clear them")
        self._layers.cues.add(keyframes_of(asked, self.skeleton, self.fps), asked.time)

    def skip(self, seconds: float) -> np.ndarray:
        """Bridge a gap in the speech with silence, and return the frames that became final.

        Args:
            seconds: length of the gap, 0 to an hour.

        Raises:
            UserError: see `feed`; or the gap is not between 0 and an hour.
        """
        message = f"a gap of {seconds} s; expected 0 to {_MAX_SKIP_SECONDS:g}, or begin another stream"
        count = round(check_number(seconds, 0, _MAX_SKIP_SECONDS, message) * SAMPLE_RATE)
        lengths = [SAMPLE_RATE] * (count // SAMPLE_RATE) + [count % SAMPLE_RATE]
        return np.concatenate([self.feed(np.zeros(length, np.float32)) for length in lengths])

    def clear(self, frame: int | None = None) -> int:
        """Drop speech that shall not be shown, as that of an agent who is interrupted, and cues that have not begun.

        The motion goes on from the pose of the frame before. Within half a second, 8 frames at 15 per second, it is
        that of a stream that never heard the speech before: at rest where silence follows, and gesturing where the next
        sound is. Numbers of frames and their times go on.

        Args:
            frame: None, where sound is fed as it is heard: the agent's sound whose frames were not returned becomes
                silence, and the next sample has the time that it would have had. Where sound is fed ahead of time: the
                first frame that shall not be shown. Sound from its time on is dropped, and the next sample is heard at
                frame / fps.

        Returns:
            The number of the frame that the next `feed` begins with; those returned from it on should be dropped.

        Raises:
            UserError: the stream has ended, or the frame is neither the next one nor one of those that were returned
                in the last minute.
        """
        self._check_open()
        first = self._num_returned if frame is None else frame
        oldest = self._num_returned - (len(self._recent) - self._join.first)
        is_whole = isinstance(first, numbers.Integral) and not isinstance(first, bool)
        if not (is_whole and oldest <= int(first) <= self._num_returned):
            raise UserError(f"frame {first} is not remembered; clear one of {oldest} to {self._num_returned}")
        course = np.stack([each.pose for each in (*self._recent, *self._held, *self._expected)])
        start = len(self._recent) - (self._num_returned - first)  # of frame `first` in it
        frames = start - self._join.first + np.arange(len(self._past))
        self._past = course[np.minimum(frames, len(course) - 1)]
        frames = start + np.arange(math.ceil(EASE * self.fps) - 1)
        self._dropped, self._first_dropped = course[np.minimum(frames, len(course) - 1)], first
        state = self.state
        while self._num_returned > first:
            self._layers = self._recent.pop().layers
            self._num_returned -= 1
        self.state = state
        self._layers.cues.drop_waiting()
        self._held, self._expected, self._num_made, self._weight_ramp = [], [], first, None
        self._join.restart()
        if frame is not None:
            self._num_samples, self._phrases = min(first * SAMPLE_RATE // self.fps, self._num_samples), None
        self._mel.restart(self._num_samples)
        return first

    def flush(self) -> np.ndarray:
        """End the stream, and return the rest of the frames; after the end of the speech there is silence.

        Returns:
            (n, bones, 3) float32 unit vectors. All frames of the stream are round(duration x fps), at least 1.

        Raises:
            UserError: the stream has ended, or the values of the model are not finite.
        """
        self._check_open()
        self._is_ended = True
        count = num_frames(self._num_samples / SAMPLE_RATE, self.fps)
        frames = [*self._held]
        while (missing := count - self._num_made) > 0:
            shown = self._run()
            if missing <= len(shown):  # the rest is in this window
                frames += shown[:missing]
                break
            frames += shown[: self.hop]
        return self._return(frames, count)

    def _run(self) -> list[_Frame]:
        """Generate the next window, and return the frames from its first new one on."""
        self._generator.advance()
        start = self._num_made - self._join.first
        times = start + np.arange(self.spec.num_frames)
        rest = idle(self.skeleton, self._generator.rest, self._seed, times, self.fps)
        weights = self._weights()
        if weights.any():
            mel = self._mel.window(window_column(start, self.fps), window_columns(self.spec.num_frames, self.fps))
            if not self._is_ended:
                mel = hide_unheard(mel, start, self._heard() - start, self.fps)
            window = self._generator.window(mel, self._past[: self.spec.num_seed_frames], start)
        else:
            window = rest.astype(np.float32)
        new = self._rested(window, rest, weights)
        if self._join.first:
            new = new[self._join.first : self._join.first + self.hop]
            self._past = np.concatenate([self._past, new])[-self._join.first :]
        else:
            self._past = new[self.hop :]
        rest, weights = rest[self._join.first :], weights[self._join.first :]
        shown = self._eased(self._rested(self._join.add(window), rest, weights))
        numbers = self._num_made + np.arange(len(shown))
        if self._phrases is None:
            frames = [_Frame(pose, weight) for pose, weight in zip(shown, weights.tolist(), strict=True)]
        else:
            spans = numbers[:, None] / self.fps + np.array([-ATTENTION, EASE])
            is_addressed = [self._phrases.has_voice(*span) for span in spans.tolist()]
            nods = nod_depths(self._phrases.ends, numbers, self.fps).tolist()
            frames = [_Frame(*frame) for frame in zip(shown, weights.tolist(), is_addressed, nods, strict=True)]
        self._num_made += self.hop
        self._expected = frames[self.hop :]
        return frames

    def _eased(self, poses: np.ndarray) -> np.ndarray:
        """Return the next poses (T, bones, 3) as they go on from those that a clear has dropped."""
        since = self._num_made - self._first_dropped
        dropped = self._dropped[since : since + len(poses)]
        weights = minimum_jerk((since + 1 + np.arange(len(dropped))) / (len(self._dropped) + 1))
        mixed = slerp(dropped, poses[: len(dropped)], weights[:, None, None])
        return np.concatenate([mixed, poses[len(dropped) :]], dtype=np.float32)

    @staticmethod
    def _rested(motion: np.ndarray, rest: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return a motion (T, bones, 3) with weights (T,), 0 for the motion `rest` (T, bones, 3)."""
        return motion if weights.min() == 1 else slerp(rest, motion, weights[:, None, None]).astype(np.float32)

    def _weights(self) -> np.ndarray:
        """Return the weights (N,) of the generator's motion in the next window: 1 near sound, 0 at rest.

        Frames after the next `hop` ones have the last weight; they are generated again, or the speech has ended.
        """
        first = self._num_made
        frames = np.arange(first, first + self.hop)
        if self._is_ended:  # what would follow the speech is not silence in it
            frames = np.minimum(frames, num_frames(self._num_samples / SAMPLE_RATE, self.fps) - 1)
        spans = frames[:, None] + np.array([-_PAUSE_SECONDS, EASE]) * self.fps
        targets = [
            np.array([float(self._mel.has_sound(*(window_column(moment, self.fps) for moment in span)))])
            for span in spans.tolist()
        ]
        if self._weight_ramp is None:
            self._weight_ramp = Ramp(targets[0], self.fps)
        weights = np.concatenate([self._weight_ramp.step(target) for target in targets])
        return np.pad(weights, (self._join.first, self.spec.num_frames - self._join.first - self.hop), mode="edge")

    def _heard(self) -> int:
        """Return the number of frames whose time must have passed before the next run."""
        return self._num_made + self.hop - 1 + self.look_ahead

    def _needed(self) -> int:
        """Return the number of samples that the next run hears."""
        return self._heard() * SAMPLE_RATE // self.fps

    def _hear(self, samples: np.ndarray, other: np.ndarray | None) -> None:
        self._mel.add(samples)
        self._num_samples += len(samples)
        if self._phrases and other is not None:
            self._phrases.add(other)

    def _return(self, frames: list[_Frame], count: int) -> np.ndarray:
        """Return the frames before frame `count` of the motion, with controls, state and cues, and hold the others."""
        final = max(count - self._num_returned, 0)
        self._held = frames[final:]
        returned = np.zeros((len(frames[:final]), self.spec.skeleton.num_bones, 3), np.float32)
        for place, frame in enumerate(frames[:final]):
            controls, states, cues = self._layers
            self._recent.append(_Returned(frame.pose.copy(), self._layers.copy()))
            pose = controls.apply(frame.pose[None], self._controls, is_muted=self.muted)[0]
            pose = states.apply(
                pose,
                self._num_returned,
                frame.weight,
                frame.nod,
                is_addressed=frame.is_addressed,
                arms=controls.arms,
            )
            returned[place] = cues.apply(pose[None])[0]
            self._num_returned += 1
        return returned

    def _checked(self, samples: np.ndarray) -> np.ndarray:
        self._check_open()
        samples = np.asarray(samples)
        if samples.ndim != 1 or not np.issubdtype(samples.dtype, np.floating):
            raise UserError(
                f"samples are an array of {samples.dtype}, shape {samples.shape}; expected float mono at 16 kHz"
            )
        return np.clip(np.where(np.isfinite(samples), samples, 0), -1, 1).astype(np.float32)

    def _check_open(self) -> None:
        if self._is_ended:
            raise UserError("the stream has ended; begin another one with Model.stream")


def _check(spec: Spec, look_ahead: Any, hop: Any, reference: float | None) -> None:
    """Check the arguments of `Stream` but style and controls."""
    if spec.inputs != ("mel",):
        raise UserError(
            f"{spec.method} reads {', '.join(spec.inputs)}, but a stream has only a mel spectrogram; load a model of "
            "speech2gesture, or of ha2g with config.model.audio.kind=resnet_se and architecture=paper"
        )
    window, overlap = spec.num_frames, spec.num_seed_frames
    if not (isinstance(look_ahead, numbers.Integral) and 0 <= int(look_ahead) <= window):
        raise UserError(f"the look-ahead is {look_ahead}; expected 0 to {window} frames, the window of the model")
    longest = window - 2 * overlap
    if not (isinstance(hop, numbers.Integral) and 1 <= int(hop) <= longest):
        raise UserError(f"the hop is {hop}; expected 1 to {longest} frames")
    if reference is not None:
        check_number(reference, 0, math.inf, f"the mel power of 0 dB is {reference}; expected a number of at least 0")

"""Motion from speech that arrives in pieces, while someone speaks.

`RunningMotion` makes the frames that follow the speech. What is added to them here, controls, the motion of a state
such as a nod, and cues, is added only to the frames that are returned, not to those that the generator continues, so
that it does not change the motion of speech.
"""

import collections
import math
import numbers
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.errors import UserError, check_number
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.methods.method import Spec, Variables
from ha2g_jax.motion.control.controls import NEUTRAL, Controls
from ha2g_jax.motion.control.effects import RunningControls, check_running
from ha2g_jax.motion.cues import MOST, Cue, RunningCues, check_cue, keyframes_of
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.motion.rotations import prepare
from ha2g_jax.motion.states import RunningStates
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.synthesis.running_motion import Frame, RunningMotion
from ha2g_jax.synthesis.style import RANDOM, Style, check_seed

_MAX_SKIP_SECONDS = 3600.0
_REMEMBERED_SECONDS = 60  # length of the returned frames to which `Stream.clear` can go back


class _Layers(NamedTuple):
    """The layers that are added to the frames that are returned, in this order."""

    controls: RunningControls
    states: RunningStates
    cues: RunningCues

    def copy(self) -> "_Layers":
        return _Layers(self.controls.copy(), self.states.copy(), self.cues.copy())


class _Returned(NamedTuple):
    """The pose of a returned frame without its layers, and the state of the layers before it."""

    pose: np.ndarray
    layers: _Layers


class Stream:
    """Motion that follows speech, see `Model.stream`.

    Frame k shows the time k / fps, as in `Model.generate`. Frames are made `hop` at a time: those of one hop use the
    speech up to `look_ahead` frames after the last of them, and no later sample. With a hop of 1, frame k depends on no
    sample after (k + look_ahead) / fps, and is returned by the first `feed` that reaches this time. With a
    look-ahead of 0 it is returned half a frame later, when the speech is long enough for the motion to have it.

    Where the agent does not speak, the body does what `state` says, and can listen to the other speaker, whose samples
    `feed` takes too. Nothing is added to frames of speech.

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
        self.controls = controls
        self._motion = RunningMotion(
            spec,
            variables,
            assets,
            look_ahead=look_ahead,
            hop=hop,
            style=style,
            seed=seed,
            reference=reference,
            has_hidden_ends=has_hidden_ends,
        )
        self._layers = _Layers(
            RunningControls(self.skeleton, self.fps, controls),
            RunningStates(self.skeleton, self.fps, seed),
            RunningCues(self.skeleton, self.fps),
        )
        self._num_returned = 0
        self._held: list[Frame] = []  # frames that were made and not returned
        past = self._motion.past
        self._recent = collections.deque(
            [_Returned(pose, self._layers) for pose in past], len(past) + _REMEMBERED_SECONDS * self.fps
        )

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
        """Longest time in seconds from a moment of the speech to its frame, without the time of the computation.

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
        return self._motion.generator.style

    @style.setter
    def style(self, style: Style) -> None:
        self._motion.generator.style = style

    @property
    def state(self) -> str:
        """What the body does while the agent does not speak; a new value takes effect with the next frames.

        It is "idle", "listen" or "think"; or "auto", which listens while the other speaks and idles otherwise.
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
            other: (samples,) of the other speaker at the same times; None for silence.

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
        frames = self._held + self._motion.feed(samples, other)
        # A motion of the speech so far has this many frames; later ones wait, as the speech may end here.
        return self._return(frames, round(self._motion.seconds * self.fps))

    def cue(self, cue: Cue | str, at: float | None = None) -> None:
        """Make a gesture whose stroke peaks at a time of the motion; it is blended into the frames after the controls.

        Args:
            cue: what to make, or its name, such as "nod" or "count:3", see `motion.cues`; a clip is read with
                `motion.cues.reading.read_clip`.
            at: seconds from the beginning of the motion, by default the time of the cue. If there is none, or it is
                past or too near, the gesture is made as soon as possible: about half a second after the next frame.

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
        """Drop speech that shall not be shown, such as that of an interrupted agent, and cues that have not begun.

        The motion continues from the pose of the frame before. Within half a second, 8 frames at 15 per second, it
        becomes that of a stream that never heard the dropped speech: at rest if silence follows, gesturing if sound
        does. The numbers of frames and their times go on.

        Args:
            frame: None if sound is fed as it is heard: the agent's sound whose frames were not returned becomes
                silence, and the next sample keeps its time. If sound is fed ahead of time, the first frame that shall
                not be shown: sound from its time on is dropped, and the next sample is heard at frame / fps.

        Returns:
            The number of the first frame of the next `feed`; returned frames from this number on should be dropped.

        Raises:
            UserError: the stream has ended, or the frame is neither the next one nor one of those that were returned
                in the last minute.
        """
        self._check_open()
        first = self._num_returned if frame is None else frame
        oldest = self._num_returned - (len(self._recent) - len(self._motion.past))
        is_whole = isinstance(first, numbers.Integral) and not isinstance(first, bool)
        if not (is_whole and oldest <= int(first) <= self._num_returned):
            raise UserError(f"frame {first} is not remembered; clear one of {oldest} to {self._num_returned}")
        course = np.stack([each.pose for each in (*self._recent, *self._held, *self._motion.expected)])
        start = len(self._recent) - (self._num_returned - first)  # of frame `first` in it
        self._motion.restart(first, course, start, is_ahead=frame is not None)
        state = self.state
        while self._num_returned > first:
            self._layers = self._recent.pop().layers
            self._num_returned -= 1
        self.state = state
        self._layers.cues.drop_waiting()
        self._held = []
        return first

    def flush(self) -> np.ndarray:
        """End the stream, and return the rest of the frames; after the end of the speech there is silence.

        Returns:
            (n, bones, 3) float32 unit vectors. The stream has round(duration x fps) frames in all, at least 1.

        Raises:
            UserError: the stream has ended, or the values of the model are not finite.
        """
        self._check_open()
        frames = self._held + self._motion.finish()
        return self._return(frames, num_frames(self._motion.seconds, self.fps))

    def _return(self, frames: list[Frame], count: int) -> np.ndarray:
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
        if self._motion.is_ended:
            raise UserError("the stream has ended; begin another one with Model.stream")


def _check(spec: Spec, look_ahead: Any, hop: Any, reference: float | None) -> None:
    """Check the arguments of `Stream` except style and controls."""
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

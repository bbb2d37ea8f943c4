"""Motion of an agent in a conversation: a stream that keeps pace with the clock, for programs with asyncio."""

import asyncio
import collections
import itertools
import logging
import math
import threading
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import numpy as np

from ha2g_jax.apps.live.pieces import Resampler
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.limits import MAX_SOUND_RATE, MIN_SOUND_RATE
from ha2g_jax.motion.cues import Cue, check_name
from ha2g_jax.synthesis.stream import Stream

CHANGES = ("state", "muted", "controls", "style")
"""Names of the attributes of a stream that `PacedStream.change` assigns."""

_logger = logging.getLogger(__name__)

_WAITING = SAMPLE_RATE // 5  # samples of the other speaker that may wait, for example after a network stall


class PacedStream:
    """A stream that hears the two voices of a conversation as time passes, and shows each frame at its time.

    Sound may be appended as fast as a speech service makes it: it waits, and is heard as fast as it is played. Where a
    voice has no sound, it is silent. A frame is shown `stream.latency` seconds after its moment is heard, and the sound
    of that moment is to be played then.

    Args:
        stream: stream of `Model.stream`, which nothing else uses from now on.
        show: coroutine function that takes the number of a frame, which shows the time number / fps, and its directions
            (bones, 3). It is called once for each frame, in order.
    """

    def __init__(self, stream: Stream, show: Callable[[int, np.ndarray], Awaitable[None]]) -> None:
        self._stream, self._show = stream, show
        self._own, self._other = _Voice(), _Voice(_WAITING)
        self._changes: list[Callable[[], Any]] = []
        self._ticks = self._shown = 0  # frames whose time has come, and those that were shown
        self._begun = 0.0
        self._at_work = threading.Lock()
        self._frames: collections.deque[np.ndarray] = collections.deque()  # that are not shown yet

    def say(self, pcm: bytes, rate: int) -> float:
        """Append sound of the agent.

        Args:
            pcm: 16 bits, little-endian, mono; half a sample at its end waits for the next call with the same rate.
            rate: samples per second.

        Returns:
            Time of the frame, number / fps in seconds, with which the agent's sound up to the next silence begins.
            Sound may be sent to a player when this frame is shown.

        Raises:
            UserError: the sound is not bytes, or the rate is below 1 kHz or above 768 kHz.
        """
        if not self._own.is_waiting:
            self._begun = self._ticks / self._stream.fps
        self._own.put(pcm, rate)
        return self._begun

    def hear(self, pcm: bytes, rate: int) -> None:
        """Append sound of the other speaker, in the form of `say`.

        Each piece is heard whole. Of the sound that waited before it, for example after a network stall, only the last
        0.2 s are heard.
        """
        self._other.put(pcm, rate)

    def change(self, **attributes: Any) -> None:
        """Assign attributes of the stream, those that `CHANGES` names, before the next frame.

        A value that the stream refuses changes nothing, and is logged as a warning.

        Raises:
            UserError: there is no such attribute.
        """
        if unknown := attributes.keys() - {*CHANGES}:
            raise UserError(f"a stream has no {sorted(unknown)[0]}; expected {', '.join(CHANGES)}")
        self._changes += [partial(setattr, self._stream, name, value) for name, value in attributes.items()]

    def cue(self, cue: Cue | str, at: float | None = None) -> None:
        """Give the stream a cue before the next frame, see `Stream.cue`.

        A cue that the stream refuses, for example because 64 wait already, is not made, and is logged as a warning.

        Raises:
            UserError: there is no such gesture.
        """
        check_name(cue if isinstance(cue, str) else cue.name)
        self._changes.append(partial(self._stream.cue, cue, at))

    def clear(self) -> None:
        """Drop the agent's sound that has not been shown, see `Stream.clear`."""
        self._own = _Voice()
        self._changes.append(self._stream.clear)

    async def run(self) -> None:
        """Hear and show until this coroutine is cancelled; the motion is computed in a thread.

        Run it again, and the frames go on where they ended. What `show` raises ends the run.
        """
        fps, clock = self._stream.fps, asyncio.get_running_loop().time
        delay, start = math.ceil(round(self._stream.latency * fps, 6)), clock() - self._ticks / fps
        for tick in itertools.count(self._ticks + 1):  # sound up to the time tick / fps has been heard
            await asyncio.sleep(start + tick / fps - clock())
            changes, self._changes = self._changes, []
            count, self._ticks = self._samples(tick) - self._samples(tick - 1), tick
            own, other = self._own.take(count), self._other.take(count)
            computing = asyncio.ensure_future(asyncio.to_thread(self._advance, changes, own, other))
            try:
                await asyncio.shield(computing)
            except asyncio.CancelledError:
                await asyncio.wait([computing])  # so that the next run finds its frames, if it is not cancelled again
                raise
            while self._shown <= tick - delay:  # more than one after a run that was cancelled in between
                self._shown += 1
                await self._show(self._shown - 1, self._frames.popleft())

    def _samples(self, ticks: int) -> int:
        return ticks * SAMPLE_RATE // self._stream.fps

    def _advance(self, changes: list[Callable[[], Any]], own: np.ndarray, other: np.ndarray) -> None:
        with self._at_work:  # the computation of a run that was cancelled may go on
            for change in changes:
                try:
                    change()
                except UserError as error:  # the body goes on without it
                    _logger.warning("%s", error)
            self._frames.extend(self._stream.feed(own, other))


class _Voice:
    """Sound that waits to be heard, (samples,) float32 at 16 kHz.

    Args:
        most: samples of it that are kept when more is put; None for all.
    """

    def __init__(self, most: int | None = None) -> None:
        self._most = most
        self._resampler, self._rate, self._pieces = Resampler(SAMPLE_RATE), SAMPLE_RATE, [np.zeros(0, np.float32)]
        self._rest = b""  # of a sample
        self._has_grown = False  # since the last take

    @property
    def is_waiting(self) -> bool:
        return any(map(len, self._pieces))

    def put(self, pcm: bytes, rate: int) -> None:
        if not isinstance(pcm, bytes | bytearray | memoryview):
            raise UserError(f"the sound is {type(pcm).__name__}; expected bytes: samples.astype('<i2').tobytes()")
        if not MIN_SOUND_RATE <= rate <= MAX_SOUND_RATE:
            raise UserError(f"{rate} samples a second; expected {MIN_SOUND_RATE} to {MAX_SOUND_RATE}")
        if rate != self._rate:
            self._end(rate)
            self._rest = b""
        pcm = self._rest + pcm
        whole = len(pcm) // 2 * 2
        pcm, self._rest = pcm[:whole], pcm[whole:]
        samples = np.frombuffer(pcm, "<i2").astype(np.float32) / 32768
        if self._most is not None:
            self._pieces = [np.concatenate(self._pieces)[-self._most :]]
        self._pieces.append(self._resampler.resample(samples, 0.0).samples)
        self._has_grown = True

    def take(self, count: int) -> np.ndarray:
        """Return the next samples, padded with silence if fewer wait."""
        if not self._has_grown and sum(map(len, self._pieces)) < count:  # the end, or a pause
            self._end(self._rate)
        self._has_grown = False
        sound = np.concatenate(self._pieces)
        self._pieces = [sound[count:]]
        return np.pad(sound[:count], (0, max(count - len(sound), 0)))

    def _end(self, rate: int) -> None:
        """Take what the resampler holds back, and begin anew."""
        self._pieces.append(self._resampler.resample(np.zeros(0, np.float32), 0.0, is_last=True).samples)
        self._resampler, self._rate = Resampler(rate), rate

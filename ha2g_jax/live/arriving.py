"""Sources whose sound arrives by itself: standard input, the microphone, and a WebSocket that others send to.

A thread takes the sound from outside and puts it into a queue of bounded length, from which the run takes it. Where the
sender can wait (a pipe, a WebSocket), it waits while the queue is full; the sound of a microphone is lost then. Sound
that is sent is heard from the moment it arrives, or after the sound before it. Where nothing is sent, silence is heard,
so that the motion goes on between two sentences.
"""

import contextlib
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

import numpy as np
from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.live.addresses import import_extra, read_address
from ha2g_jax.live.clock import Clock, Stop
from ha2g_jax.live.servers import serving
from ha2g_jax.live.sources import CHUNK_SECONDS, Chunk, Resampler

_QUEUE = 50  # pieces: a second of the microphone, a few of a pipe
_PIECE = 4096  # bytes of a pipe
_PATIENCE = 0.06  # seconds after the end of the sound until silence is heard; less than a frame
_POLL = 0.02  # seconds between two looks at the queue
_BROKEN = 5.0  # seconds without sound after which a microphone is taken to be unplugged
_BUSY, _UNSUPPORTED = 1013, 1003  # codes of WebSockets for a second sender, and for text


class Sent:
    """Sound that is sent in pieces of any length, see the docstring of the module.

    Attributes:
        name: description of the source.
    """

    is_timed = True
    lost_seconds = 0.0

    def __init__(self, name: str, rate: int) -> None:
        """Start without sound.

        Args:
            name: description of the source.
            rate: samples per second.
        """
        self.name, self._rate = name, rate
        self._pieces: queue.Queue[np.ndarray | None] = queue.Queue(_QUEUE)
        self._is_closed = False

    def put(self, piece: np.ndarray | None) -> bool:
        """Wait until the queue has room and append samples, or None for the end of the sound.

        Returns:
            Whether the run still listens.
        """
        while not self._is_closed:
            with contextlib.suppress(queue.Full):
                self._pieces.put(piece, timeout=_POLL)
                return True
        return False

    def close(self) -> None:
        """Let the thread that puts samples end."""
        self._is_closed = True

    def chunks(self, clock: Clock, stop: Stop) -> Iterator[Chunk]:
        resampler, end = Resampler(self._rate), clock.now()  # `end`: when the sound so far has been heard
        silence = np.zeros(round(CHUNK_SECONDS * self._rate), np.float32)
        is_silent = False
        while not stop.is_asked():
            piece = silence
            with contextlib.suppress(queue.Empty):
                piece = self._pieces.get_nowait()
            if piece is None:
                yield resampler.resample(np.zeros(0, np.float32), end, is_last=True)
                return
            if piece is silence:
                patience = CHUNK_SECONDS if is_silent else _PATIENCE
                if (left := end + patience - clock.now()) > 0:
                    clock.sleep(min(left, _POLL))
                    continue
            else:
                end = max(end, clock.now())
            is_silent = piece is silence
            chunk = resampler.resample(piece, end)
            end += len(piece) / self._rate
            yield chunk


@contextlib.contextmanager
def stdin(rate: int, file: BinaryIO | None = None) -> Iterator[Sent]:
    """Provide the sound of standard input: raw PCM, 16 bits, little-endian, mono.

    Args:
        rate: samples per second.
        file: file to read instead.

    Raises:
        UserError: standard input is a terminal.
    """
    if file is None and (sys.stdin is None or sys.stdin.isatty()):
        raise UserError("stdin is not a pipe; pipe raw PCM into it: 16 bits, little-endian, mono, at --rate")
    source = Sent("stdin", rate)
    read = (file or sys.stdin.buffer).read1  # type: ignore[union-attr]

    def pump() -> None:
        decode = _decoder()
        while data := read(_PIECE):
            if not source.put(decode(data)):
                return
        source.put(None)

    threading.Thread(target=pump, daemon=True).start()  # daemon: it may wait for input for ever
    try:
        yield source
    finally:
        source.close()


@contextlib.contextmanager
def websocket(text: str, rate: int) -> Iterator[Sent]:
    """Provide the sound that one client at a time sends to a WebSocket: binary messages of PCM as of `stdin`.

    Args:
        text: ws://HOST:PORT to listen on.
        rate: samples per second.

    Raises:
        UserError: the address cannot be used, or the library is missing.
    """
    source, one = Sent(shown(text), rate), threading.Lock()

    def receive(connection: Any) -> None:
        if not one.acquire(blocking=False):
            connection.close(_BUSY, "another sender is connected")
            return
        with contextlib.closing(connection):
            try:
                decode = _decoder()
                for message in connection:
                    if isinstance(message, str):
                        connection.close(_UNSUPPORTED, "send sound as binary messages of 16-bit PCM")
                        return
                    if not source.put(decode(message)):
                        return
            finally:
                one.release()

    with serving(read_address(text), receive):
        try:
            yield source
        finally:
            source.close()


def _decoder() -> Callable[[bytes], np.ndarray]:
    """Return a function from bytes of PCM to samples; half a sample is kept for the next bytes."""
    rest = b""

    def decode(data: bytes) -> np.ndarray:
        nonlocal rest
        data = rest + data
        whole = len(data) // 2 * 2
        rest = data[whole:]
        return np.frombuffer(data[:whole], "<i2").astype(np.float32) / 32768

    return decode


class Captured:
    """Sound of a microphone, heard while it is recorded.

    Attributes:
        name: description of the source.
    """

    is_timed = True

    def __init__(self, name: str, rate: float) -> None:
        """Start without sound.

        Args:
            name: description of the source.
            rate: samples per second.
        """
        self.name, self._rate = name, rate
        self._pieces: queue.Queue[tuple[np.ndarray, float]] = queue.Queue(_QUEUE)
        self._num_lost = 0

    @property
    def lost_seconds(self) -> float:
        return self._num_lost / self._rate

    def put(self, piece: np.ndarray, heard: float) -> None:
        """Append samples, unless the computation is a second behind; then they are lost.

        Args:
            piece: (samples,) float32.
            heard: time of the clock at which the first of them was heard.
        """
        try:
            self._pieces.put_nowait((piece, heard))
        except queue.Full:
            self._num_lost += len(piece)

    def chunks(self, clock: Clock, stop: Stop) -> Iterator[Chunk]:
        resampler, last = Resampler(self._rate), clock.now()
        while not stop.is_asked():
            try:
                piece, heard = self._pieces.get_nowait()
            except queue.Empty:
                if clock.now() - last > _BROKEN:
                    tqdm.write(f"no sound from {self.name} for {_BROKEN:g} s; ending", file=sys.stderr)
                    return
                clock.sleep(_POLL / 4)
                continue
            last = clock.now()
            yield resampler.resample(piece, heard)


@contextlib.contextmanager
def microphone(rate: int | None) -> Iterator[Captured]:
    """Provide the sound of the default microphone.

    Args:
        rate: samples per second; by default those of the device.

    Raises:
        UserError: the library is missing, or there is no microphone that can be used.
    """
    device = import_extra("sounddevice", "sounddevice and PortAudio")
    clock = Clock()
    try:
        rate = rate or round(device.query_devices(kind="input")["default_samplerate"])
        source = Captured("microphone", rate)

        def take(data: np.ndarray, frames: int, time: Any, status: Any) -> None:
            del time, status
            source.put(data[:, 0].copy(), clock.now() - frames / rate)

        stream = device.InputStream(
            samplerate=rate, channels=1, dtype="float32", blocksize=round(CHUNK_SECONDS * rate), callback=take
        )
    except (device.PortAudioError, ValueError) as error:
        raise UserError(f"no microphone can be used ({shown(str(error))}); connect one, or use stdin") from error
    with stream:
        yield source

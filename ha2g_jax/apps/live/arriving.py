"""Sources whose sound arrives by itself: standard input, a WebSocket that others send to, and the microphone.

They are opened when the run begins to listen, so that no sound waits for the model to be loaded. A thread takes the
sound from outside and puts it into a queue of bounded length, from which the run takes it. Where the sender can wait (a
pipe, a WebSocket), it waits while the queue is full; the sound of a microphone is lost then. Sound that is sent is
heard from the moment it arrives, or after the sound before it. Where nothing is sent, silence is heard, so that the
motion goes on between two sentences.
"""

import contextlib
import queue
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from typing import Any, BinaryIO

import numpy as np
from tqdm import tqdm

from ha2g_jax.apps.live.addresses import Address, import_extra
from ha2g_jax.apps.live.clock import Clock, Stop
from ha2g_jax.apps.live.servers import serving
from ha2g_jax.apps.live.sources import CHUNK_SECONDS, Chunk, Resampler
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

_QUEUE = 50  # pieces: a second of the microphone, a few of a pipe
_PIECE = 4096  # bytes of a pipe
_PATIENCE = 0.06  # seconds after the end of the sound until silence is heard; less than a frame
_POLL = 0.02  # seconds between two looks at the queue
_BROKEN = 5.0  # seconds without sound after which a microphone is taken to be unplugged
_BUSY, _UNSUPPORTED = 1013, 1003  # codes of WebSockets for a second sender, and for text


class Inbox:
    """Sound that is sent in pieces of any length, on its way from the thread that receives it to the run."""

    def __init__(self, rate: int) -> None:
        """Start without sound.

        Args:
            rate: samples per second.
        """
        self._rate = rate
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

    def chunks(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
        """Yield the sound as it is heard, and silence where there is none."""
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


class PipeSource:
    """Standard input: raw PCM, 16 bits, little-endian, mono."""

    name, is_timed, lost_seconds = "stdin", True, 0.0

    def __init__(self, rate: int, file: BinaryIO | None = None) -> None:
        """Prepare to read.

        Args:
            rate: samples per second.
            file: file to read instead of standard input.

        Raises:
            UserError: standard input is a terminal.
        """
        if file is None and (sys.stdin is None or sys.stdin.isatty()):
            raise UserError("stdin is not a pipe; pipe raw PCM into it: 16 bits, little-endian, mono, at --rate")
        # Unbuffered: a thread that waits for input in a buffered file would hold its lock when the program ends.
        self._rate, self._file = rate, file or open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115

    def chunks(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
        with contextlib.closing(Inbox(self._rate)) as inbox:
            # It may wait for input for ever, and does not keep the program from ending.
            threading.Thread(target=self._read, args=(inbox,), daemon=True).start()
            yield from inbox.chunks(clock, stop)

    def _read(self, inbox: Inbox) -> None:
        decode = _decoder()
        while data := self._file.read(_PIECE):
            if not inbox.put(decode(data)):
                return
        inbox.put(None)


class WebSocketSource:
    """A WebSocket to which one client at a time sends binary messages of PCM as of `PipeSource`.

    Attributes:
        name: its address.
    """

    is_timed, lost_seconds = True, 0.0

    def __init__(self, address: Address, rate: int) -> None:
        """Prepare to listen.

        Args:
            address: where to listen.
            rate: samples per second.
        """
        self.name, self._address, self._rate = str(address), address, rate
        self._sender = threading.Lock()

    def chunks(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
        inbox = Inbox(self._rate)
        with serving(self._address, lambda connection: self._receive(connection, inbox)), contextlib.closing(inbox):
            yield from inbox.chunks(clock, stop)

    def _receive(self, connection: Any, inbox: Inbox) -> None:
        """Take the messages of a client until it leaves or the run ends."""
        if not self._sender.acquire(blocking=False):
            connection.close(_BUSY, "another sender is connected")
            return
        try:
            decode = _decoder()
            for message in connection:
                if isinstance(message, str):
                    connection.close(_UNSUPPORTED, "send sound as binary messages of 16-bit PCM")
                    return
                if not inbox.put(decode(message)):
                    return
        finally:
            self._sender.release()


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


class MicrophoneSource:
    """The default microphone, heard while it is recorded."""

    name, is_timed = "microphone", True

    def __init__(self, rate: int | None) -> None:
        """Look for the microphone.

        Args:
            rate: samples per second; by default those of the device.

        Raises:
            UserError: the library is missing, or there is no microphone.
        """
        self._library = import_extra("sounddevice", "sounddevice and PortAudio")
        with self._device_errors():
            self._rate = rate or round(self._library.query_devices(kind="input")["default_samplerate"])
        self._pieces: queue.Queue[tuple[np.ndarray, float]] = queue.Queue(_QUEUE)
        self._num_lost = 0

    @property
    def lost_seconds(self) -> float:
        return self._num_lost / self._rate

    def chunks(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
        def take(data: np.ndarray, frames: int, time: Any, status: Any) -> None:
            del time, status
            try:
                self._pieces.put_nowait((data[:, 0].copy(), clock.now() - frames / self._rate))
            except queue.Full:
                self._num_lost += frames

        size = round(CHUNK_SECONDS * self._rate)
        with contextlib.ExitStack() as stack:
            with self._device_errors():
                stream = self._library.InputStream(
                    samplerate=self._rate, channels=1, dtype="float32", blocksize=size, callback=take
                )
                stack.enter_context(contextlib.closing(stream))
                stream.start()
            yield from self._captured(clock, stop)

    def _captured(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
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
    def _device_errors(self) -> Iterator[None]:
        try:
            yield
        except (self._library.PortAudioError, ValueError) as error:
            raise UserError(f"no microphone can be used ({shown(str(error))}); connect one, or use stdin") from error

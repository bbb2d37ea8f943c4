"""Sources of sound: a file, standard input, the microphone, or a WebSocket that others send to.

Sound that arrives by itself is taken from outside by a thread, which puts it into a queue of bounded length. It is
opened when the run begins to listen, so that no sound waits for the model to be loaded. A sender that can wait (a pipe,
a WebSocket) waits while the queue is full; the sound of a microphone is lost then. What is sent is heard from the
moment it arrives, or after the sound before it; where nothing is sent, silence is heard, so that the motion goes on.
"""

import contextlib
import io
import json
import pathlib
import queue
import sys
import threading
from collections.abc import Generator, Iterator
from typing import Any, BinaryIO, NamedTuple, Protocol

import numpy as np
import soundfile
import soxr
from tqdm import tqdm

from ha2g_jax.apps.live.clock import Clock, StopFlag, wait_until
from ha2g_jax.apps.live.network import Address, read_address, serving
from ha2g_jax.errors import UserError, require
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.limits import MAX_SOUND_RATE, MIN_SOUND_RATE

CHUNK_SECONDS = 0.02
_QUEUE = 50  # pieces: a second of the microphone, a few of a pipe
_PIECE = 4096  # bytes of a pipe
_PATIENCE = 0.06  # seconds after the end of the sound until silence is heard; less than a frame
_POLL = 0.02  # seconds between two looks at the queue
_BROKEN = 5.0  # seconds without sound after which a microphone is taken to be unplugged
_INSTALL_PORTAUDIO = "sudo apt install libportaudio2 (Debian, Ubuntu), sudo dnf install portaudio (Fedora)"
_BUSY, _UNSUPPORTED = 1013, 1003  # codes of WebSockets for a second sender, and for what is not sound
_MOST_REASON = 100  # letters that a WebSocket is closed with
_MOST_HEADER = 1 << 16  # bytes of a WAV before its sound
_UNKNOWN_SIZE = 0x7FFF0000  # from which on the size of a WAV that is written to a pipe is not its size
# How files begin that are neither raw PCM nor WAV.
_OTHERS = {
    b"fLaC": "FLAC",
    b"OggS": "Ogg",
    b"ID3": "MP3",
    b"FORM": "AIFF",
    b".snd": "AU",
    b"caff": "CAF",
    b"RF64": "RF64",
}


class Chunk(NamedTuple):
    """Samples (samples,), float32 mono at 16 kHz, and the time of the clock at which the first of them is heard.

    Where `muted` is not None, the arms rest, or move again, from here on.
    """

    samples: np.ndarray
    heard: float
    muted: bool | None = None


class Source(Protocol):
    """Sound that a live run listens to.

    Attributes:
        name: description for messages and the recording.
        is_timed: whether the sound is heard in real time, so that frames have times to be sent at.
    """

    name: str
    is_timed: bool

    @property
    def lost_seconds(self) -> float:
        """Seconds of sound that came while the computation was too far behind to take it."""
        ...

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        """Yield the sound as it is heard, until its end or until the run is to stop."""
        ...


class FileSource:
    """A file with sound, heard in real time or as fast as the computation takes it.

    Raises:
        UserError: the file cannot be used, see `features.audio.read_audio`.
    """

    lost_seconds = 0.0

    def __init__(self, path: pathlib.Path, is_fast: bool) -> None:
        self.name = shown(path.name)
        self._samples, self.is_timed = read_audio(path), not is_fast

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        size, start = round(CHUNK_SECONDS * SAMPLE_RATE), clock.now()
        for first in range(0, len(self._samples), size):
            samples = self._samples[first : first + size]
            heard = start + first / SAMPLE_RATE
            if self.is_timed:
                wait_until(heard + len(samples) / SAMPLE_RATE, clock, stop)
            if stop.is_asked():
                return
            yield Chunk(samples, heard)


class Resampler:
    """Conversion of sound that arrives in pieces to 16 kHz."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._stream = None if rate == SAMPLE_RATE else soxr.ResampleStream(rate, SAMPLE_RATE, 1, dtype="float32")
        self._taken = self._given = 0

    def resample(self, samples: np.ndarray, heard: float, is_last: bool = False) -> Chunk:
        """Convert a piece; the last milliseconds of it are held back, unless the sound ends here.

        Args:
            samples: (samples,) float32 mono; values that are not finite become 0.
            heard: time at which the first of them is heard.
            is_last: whether the sound ends here.
        """
        samples = np.nan_to_num(samples.astype(np.float32, copy=False), nan=0.0, posinf=0.0, neginf=0.0)
        if self._stream is None:
            return Chunk(samples, heard)
        heard += self._given / SAMPLE_RATE - self._taken / self._rate
        resampled = self._stream.resample_chunk(samples, last=is_last)
        self._taken += len(samples)
        self._given += len(resampled)
        return Chunk(resampled, heard)


class Inbox:
    """Sound that is sent in pieces of any length, on its way from the thread that receives it to the run."""

    def __init__(self, rate: int) -> None:
        self._rate = rate
        self._pieces: queue.Queue[np.ndarray | bool | UserError | None] = queue.Queue(_QUEUE)
        self._is_closed = False

    def put(self, piece: np.ndarray | bool | UserError | None) -> bool:
        """Wait until there is space, append a piece, and return whether the run still listens.

        A piece is samples, whether the arms rest from there on, None for the end of the sound, or an error that is
        raised there.
        """
        while not self._is_closed:
            with contextlib.suppress(queue.Full):
                self._pieces.put(piece, timeout=_POLL)
                return True
        return False

    def close(self) -> None:
        """Let the thread that puts samples end."""
        self._is_closed = True

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        """Yield the sound as it is heard, and silence where there is none."""
        resampler, end = Resampler(self._rate), clock.now()  # `end`: when the sound so far has been heard
        silence = np.zeros(round(CHUNK_SECONDS * self._rate), np.float32)
        is_silent = False
        while not stop.is_asked():
            piece = silence
            with contextlib.suppress(queue.Empty):
                piece = self._pieces.get_nowait()
            if isinstance(piece, UserError):
                raise piece
            if isinstance(piece, bool):
                yield Chunk(np.zeros(0, np.float32), end, piece)
                continue
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
    """Standard input, or another file: raw PCM, 16 bits, little-endian, mono, or a WAV, whose header says what it is.

    Raises:
        UserError: standard input is a terminal.
    """

    name, is_timed, lost_seconds = "stdin", True, 0.0

    def __init__(self, rate: int | None, file: BinaryIO | None = None) -> None:
        if file is None and (sys.stdin is None or sys.stdin.isatty()):
            raise UserError("stdin is not a pipe; pipe a WAV into it, or raw PCM of 16 bits, little-endian, mono")
        # Unbuffered: a thread that waits for input in a buffered file would hold its lock when the program ends.
        self._rate, self._file = rate, file or open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        with contextlib.closing(Inbox(self._rate or SAMPLE_RATE)) as inbox:
            # It may wait for input for ever, and does not keep the program from ending.
            threading.Thread(target=self._read, args=(inbox,), daemon=True).start()
            yield from inbox.chunks(clock, stop)

    def _read(self, inbox: Inbox) -> None:
        decoder = _Decoder(self._rate)
        try:
            while data := self._file.read(_PIECE):
                if not inbox.put(decoder.decode(data)):
                    return
            inbox.put(decoder.decode(b"", is_last=True))
            inbox.put(None)
        except UserError as error:
            inbox.put(error)


class WebSocketSource:
    """A WebSocket to which one client at a time sends binary messages of PCM or WAV as of `PipeSource`."""

    is_timed, lost_seconds = True, 0.0

    def __init__(self, address: Address, rate: int | None) -> None:
        self.name, self._address, self._rate = str(address), address, rate
        self._sender = threading.Lock()

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        inbox = Inbox(self._rate or SAMPLE_RATE)
        with serving(self._address, lambda connection: self._receive(connection, inbox)), contextlib.closing(inbox):
            yield from inbox.chunks(clock, stop)

    def _receive(self, connection: Any, inbox: Inbox) -> None:
        if not self._sender.acquire(blocking=False):
            connection.close(_BUSY, "another sender is connected")
            return
        try:
            decoder = _Decoder(self._rate)
            for message in connection:
                if not inbox.put(_read_mute(message) if isinstance(message, str) else decoder.decode(message)):
                    return
            inbox.put(decoder.decode(b"", is_last=True))
        except UserError as error:
            connection.close(_UNSUPPORTED, str(error)[:_MOST_REASON])
        finally:
            self._sender.release()


def _read_mute(text: str) -> bool:
    """Return the value of the message {"muted": true} or {"muted": false}."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        message = None
    if not (isinstance(message, dict) and message.keys() == {"muted"} and isinstance(message["muted"], bool)):
        raise UserError('send sound as binary messages, and of text {"muted": true} or {"muted": false} only')
    return message["muted"]


class _Decoder:
    """Conversion of the bytes of raw PCM or of a WAV to samples, mono, at a rate or by default at 16 kHz.

    A WAV is known by its header, which says its rate, channels and type; part of a sample is kept for the next bytes.
    """

    def __init__(self, rate: int | None) -> None:
        self._stated, self._rest, self._left = rate, b"", sys.maxsize
        self._form: dict[str, Any] = {}  # of the sound, as soon as it is known
        self._width, self._resampler = 2, None

    def decode(self, data: bytes, *, is_last: bool = False) -> np.ndarray:
        """Return the samples (samples,) float32 of further bytes.

        Raises:
            UserError: they are of another kind of file, or of a WAV with another rate than the one that is stated.
        """
        self._rest += data
        if not self._form and not self._begin(is_last):
            return np.zeros(0, np.float32)
        whole = min(len(self._rest), self._left) // self._width * self._width
        sound, self._rest, self._left = self._rest[:whole], self._rest[whole:], self._left - whole
        samples = soundfile.read(io.BytesIO(sound), dtype="float32", always_2d=True, **self._form)[0].mean(axis=1)
        return samples if self._resampler is None else self._resampler.resample_chunk(samples, last=is_last)

    def _begin(self, is_last: bool) -> bool:
        """Find out what the sound is, and return whether it is known."""
        head, self._form = self._rest, {}
        if len(head) < 12 and not is_last:
            return False
        if other := next((name for start, name in _OTHERS.items() if head.startswith(start)), None):
            raise UserError(f"what is sent is {other}; send WAV or raw PCM, or give the file to --source")
        form = {"samplerate": self._stated or SAMPLE_RATE, "channels": 1, "subtype": "PCM_16"}
        if head.startswith(b"RIFF") and head[8:12] == b"WAVE":
            start = 12
            while head[start : start + 4] != b"data" and start < len(head):
                if head[start : start + 4] == b"fmt ":
                    self._width = int.from_bytes(head[start + 20 : start + 22], "little")
                start += 8 + int.from_bytes(head[start + 4 : start + 8], "little") + 1 & ~1
            if len(head) < start + 8 and not is_last and len(head) < _MOST_HEADER:
                return False
            size = int.from_bytes(head[start + 4 : start + 8], "little")
            try:
                with soundfile.SoundFile(io.BytesIO(head)) as file:
                    form = {"samplerate": file.samplerate, "channels": file.channels, "subtype": file.subtype}
                soundfile.read(io.BytesIO(bytes(self._width)), format="RAW", **form)
            except (soundfile.SoundFileError, ValueError, TypeError) as error:
                raise UserError(f"what is sent is a WAV that cannot be read ({reason(error)}); send 16 bits") from error
            if self._stated not in (None, file.samplerate):
                raise UserError(f"the WAV has {file.samplerate} samples a second, not {self._stated}; leave out --rate")
            self._rest, self._left = head[start + 8 :], size if 0 < size < _UNKNOWN_SIZE else sys.maxsize
            if file.samplerate != (self._stated or SAMPLE_RATE):
                self._resampler = soxr.ResampleStream(file.samplerate, SAMPLE_RATE, 1, dtype="float32")
        self._form = form | {"format": "RAW", "endian": "LITTLE"}
        return True


class MicrophoneSource:
    """The default microphone, heard while it is recorded; by default at the rate of the device.

    Raises:
        UserError: the library is missing, or there is no microphone.
    """

    name, is_timed = "microphone", True

    def __init__(self, rate: int | None) -> None:
        self._library = require("sounddevice", "live", by="the microphone", library=_INSTALL_PORTAUDIO)
        with self._device_errors():
            self._rate = rate or round(self._library.query_devices(kind="input")["default_samplerate"])
        self._pieces: queue.Queue[tuple[np.ndarray, float]] = queue.Queue(_QUEUE)
        self._num_lost = 0

    @property
    def lost_seconds(self) -> float:
        return self._num_lost / self._rate

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
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

    def _captured(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
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


def open_source(text: str, rate: int | None = None, is_fast: bool = False) -> Source:
    """Return a source, whose sound begins when it is asked for.

    Args:
        text: path of a file with sound, "stdin", "microphone" or ws://HOST:PORT.
        rate: samples per second of "stdin", "microphone" or the WebSocket; by default that of the microphone, or 16000.
        is_fast: whether a file is taken as fast as it is computed.

    Raises:
        UserError: the source is not known, cannot be used or does not take these options, or its library is missing.
    """
    if rate is not None and not MIN_SOUND_RATE <= rate <= MAX_SOUND_RATE:
        raise UserError(f"the rate is {rate}; give {MIN_SOUND_RATE} to {MAX_SOUND_RATE} samples per second")
    is_arriving = text in ("stdin", "microphone") or "://" in text
    if is_arriving and is_fast:
        raise UserError(f"--fast is for files; {shown(text)} is heard as it comes")
    if not is_arriving and rate is not None:
        raise UserError("--rate is for stdin, the microphone and WebSockets; a file states its own rate")
    if text == "stdin":
        return PipeSource(rate)
    if text == "microphone":
        return MicrophoneSource(rate)
    if text.startswith("ws://"):
        return WebSocketSource(read_address(text), rate)
    if is_arriving:
        raise UserError(f"no source {shown(text)}; expected a file, stdin, microphone or ws://HOST:PORT")
    return FileSource(pathlib.Path(text), is_fast)

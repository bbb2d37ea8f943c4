"""Sources of sound: a file, standard input, the microphone, or a WebSocket that others send to.

A thread reads sound that arrives by itself and puts it into a queue of bounded length. The source is opened when the
run begins to listen, so that no sound waits for the model to be loaded. If the queue is full, a pipe waits, a WebSocket
is closed, and the sound of a microphone is lost. Sound is heard when it arrives, or after the sound before it; if
nothing is sent, silence is heard, so that the motion goes on. Sound that is sent ahead waits here until its time, so
that it can be dropped when its speaker is interrupted.
"""

import collections
import contextlib
import json
import pathlib
import queue
import sys
import threading
import time
from collections.abc import Generator, Iterator
from typing import Any, BinaryIO, NamedTuple, Protocol

import numpy as np
from tqdm import tqdm

from ha2g_jax.apps.live.clock import Clock, StopFlag, wait_until
from ha2g_jax.apps.live.network import Address, read_address, serving
from ha2g_jax.apps.live.pieces import Change, Chunk, Decoder, Resampler
from ha2g_jax.errors import UserError, require
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio, read_voices
from ha2g_jax.files.reading import parse_json, reason, shown
from ha2g_jax.limits import MAX_SOUND_RATE, MIN_SOUND_RATE
from ha2g_jax.motion.cues.reading import read_cue
from ha2g_jax.motion.states import STATES

CHUNK_SECONDS = 0.02
_QUEUE = 50  # pieces: a second of the microphone
_AHEAD_SECONDS = 600  # of sound that is sent ahead and waits
_LONGEST_PIECE = 0.1  # seconds of it that are heard at once
_PIECE = 4096  # bytes of a pipe
_PATIENCE = 0.06  # seconds after the end of the sound until silence is heard; less than a frame
_POLL = 0.02  # seconds between two looks at the queue
_BROKEN = 5.0  # seconds without sound after which a microphone is taken to be unplugged
_INSTALL_PORTAUDIO = "sudo apt install libportaudio2 (Debian, Ubuntu), sudo dnf install portaudio (Fedora)"
_BUSY, _UNSUPPORTED = 1013, 1003  # codes of WebSockets for a second sender, and for what cannot be heard
_ANSWER_SECONDS = 2.0  # for a sender to answer a ping before another one takes its place
_MOST_REASON = 100  # letters that a WebSocket is closed with


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
        """Say that it listens, and yield the sound as it is heard, until its end or until the run is to stop."""
        ...


class FileSource:
    """A file with sound, heard in real time or as fast as the computation takes it.

    If there are 2 channels, the left one is the agent and the right one the other speaker.

    Raises:
        UserError: the file cannot be used, see `features.audio.read_audio` and `read_voices`.
    """

    lost_seconds = 0.0

    def __init__(self, path: pathlib.Path, is_fast: bool, channels: int = 1) -> None:
        self.name, self.is_timed = shown(path.name), not is_fast
        self._samples, self._other = read_voices(path) if channels == 2 else (read_audio(path), None)

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        size, start = round(CHUNK_SECONDS * SAMPLE_RATE), clock.now()
        _say_listening(self.name)
        for first in range(0, len(self._samples), size):
            samples = self._samples[first : first + size]
            other = None if self._other is None else self._other[first : first + size]
            heard = start + first / SAMPLE_RATE
            if self.is_timed:
                wait_until(heard + len(samples) / SAMPLE_RATE, clock, stop)
            if stop.is_asked():
                return
            yield Chunk(samples, heard, other)


class Inbox:
    """Queue of sound in pieces of any length, from the thread that receives it to the run."""

    def __init__(self, rate: int, clock: Clock, channels: int = 1) -> None:
        self._rate, self._clock, self._channels = rate, clock, channels
        self._pieces: collections.deque[_Piece] = collections.deque()
        self._num_waiting = 0  # samples
        self._lock = threading.Lock()
        self._is_closed = False

    def check_space(self) -> None:
        """Raise a UserError if as much sound waits as may."""
        if self._is_full():
            raise UserError(f"{_AHEAD_SECONDS} s of sound wait to be heard; send later sound later")

    def _is_full(self) -> bool:
        return self._num_waiting >= _AHEAD_SECONDS * self._rate

    def put(self, content: np.ndarray | Change | UserError | None) -> bool:
        """Wait until there is space, append a piece, and return whether the run still listens.

        A piece is samples, a change from there on, None for the end of the sound, or an error that is raised there. A
        clear drops the samples that wait.
        """
        if isinstance(content, np.ndarray) and not len(content):  # no sound, not even the beginning of some
            return not self._is_closed
        while not self._is_closed:
            with self._lock:
                if isinstance(content, Change) and content.clear:
                    self._pieces = collections.deque(each for each in self._pieces if not each.is_sound)
                    self._num_waiting = 0
                if not isinstance(content, np.ndarray) or not self._is_full():
                    self._num_waiting += len(content) if isinstance(content, np.ndarray) else 0
                    self._pieces.append(_Piece(content, self._clock.now()))
                    return True
            time.sleep(_POLL)
        return False

    def close(self) -> None:
        """Let the thread that puts samples end."""
        self._is_closed = True

    def _take(self, is_due: bool) -> "_Piece":
        """Take the next piece, at most `_LONGEST_PIECE` of sound; samples only if they are due.

        Raises:
            queue.Empty: there is none.
        """
        with self._lock:
            if not self._pieces or (self._pieces[0].is_sound and not is_due):
                raise queue.Empty
            content, arrived = self._pieces.popleft()
            if isinstance(content, np.ndarray):
                most = round(_LONGEST_PIECE * self._rate)
                if len(content) > most:
                    self._pieces.appendleft(_Piece(content[most:], arrived))
                    content = content[:most]
                self._num_waiting -= len(content)
            return _Piece(content, arrived)

    def chunks(self, stop: StopFlag) -> Generator[Chunk, None, None]:
        """Yield the sound as it is heard, and silence where there is none."""
        clock = self._clock
        resampler, end = Resampler(self._rate, self._channels), clock.now()  # `end`: when the sound has been heard
        silence = np.zeros((round(CHUNK_SECONDS * self._rate), *[2] * (self._channels == 2)), np.float32)
        is_silent = False
        while not stop.is_asked():
            piece, arrived = silence, end
            with contextlib.suppress(queue.Empty):  # early enough that no look at the queue is late
                piece, arrived = self._take(end - clock.now() <= 2 * _POLL)
            if isinstance(piece, UserError):
                raise piece
            if isinstance(piece, Change):
                if piece.clear:  # what the resampler holds back is dropped, too
                    yield resampler.resample(silence[:0], end, is_last=True)
                    resampler = Resampler(self._rate, self._channels)
                yield Chunk(np.zeros(0, np.float32), end, change=piece)
                continue
            if piece is None:
                yield resampler.resample(silence[:0], end, is_last=True)
                return
            if piece is silence:
                patience = CHUNK_SECONDS if is_silent else _PATIENCE
                if (left := end + patience - clock.now()) > 0:
                    clock.sleep(min(left, _POLL))
                    continue
            else:
                end = max(end, arrived)  # not the time now: a run that was held up catches up
            is_silent = piece is silence
            chunk = resampler.resample(piece, end)
            end += len(piece) / self._rate
            yield chunk


class _Piece(NamedTuple):
    """What is put into an `Inbox`, and when."""

    content: np.ndarray | Change | UserError | None
    arrived: float

    @property
    def is_sound(self) -> bool:
        return isinstance(self.content, np.ndarray)


class PipeSource:
    """Standard input, or another file: raw PCM, 16 bits, little-endian, or a WAV, whose header says what it is.

    It is mono; if there are 2 channels, the left one is the agent and the right one the other speaker.

    Raises:
        UserError: standard input is a terminal.
    """

    name, is_timed, lost_seconds = "stdin", True, 0.0

    def __init__(self, rate: int | None, file: BinaryIO | None = None, channels: int = 1) -> None:
        if file is None and (sys.stdin is None or sys.stdin.isatty()):
            raise UserError("stdin is not a pipe; pipe a WAV into it, or raw PCM of 16 bits, little-endian, mono")
        # Unbuffered: a thread that waits for input in a buffered file would hold its lock when the program ends.
        self._rate, self._channels = rate, channels
        self._file = file or open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        with contextlib.closing(Inbox(self._rate or SAMPLE_RATE, clock, self._channels)) as inbox:
            # It may wait for input for ever, and does not keep the program from ending.
            threading.Thread(target=self._read, args=(inbox,), daemon=True).start()
            _say_listening(self.name)
            yield from inbox.chunks(stop)

    def _read(self, inbox: Inbox) -> None:
        decoder = Decoder(self._rate, self._channels)
        try:
            while (data := self._file.read(_PIECE)) != b"":
                if data is None:  # nothing has come, in a pipe that does not block
                    time.sleep(_POLL)
                if not inbox.put(decoder.decode(data or b"")):
                    return
            inbox.put(decoder.decode(b"", is_last=True))
            inbox.put(None)
        except UserError as error:
            inbox.put(error)
        except OSError as error:
            inbox.put(UserError(f"stdin cannot be read ({reason(error).lower()})"))


class WebSocketSource:
    """A WebSocket to which one client at a time sends changes, and PCM or WAV as in `PipeSource` in binary messages."""

    is_timed, lost_seconds = True, 0.0

    def __init__(self, address: Address, rate: int | None, channels: int = 1) -> None:
        self.name, self._address, self._rate, self._channels = str(address), address, rate, channels
        self._turn = threading.Lock()  # held by the sender that is heard
        self._sender: Any = None  # its connection

    def chunks(self, clock: Clock, stop: StopFlag) -> Generator[Chunk, None, None]:
        inbox = Inbox(self._rate or SAMPLE_RATE, clock, self._channels)
        with serving(self._address, lambda connection: self._receive(connection, inbox)), contextlib.closing(inbox):
            _say_listening(self.name)
            yield from inbox.chunks(stop)

    def _receive(self, connection: Any, inbox: Inbox) -> None:
        if not (self._turn.acquire(blocking=False) or self._take_turn(inbox)):
            connection.close(_BUSY, "another sender is connected")
            return
        self._sender = connection
        try:
            decoder = Decoder(self._rate, self._channels)
            for message in connection:
                try:
                    piece = read_change(message) if isinstance(message, str) else decoder.decode(message)
                except UserError as error:
                    if not isinstance(message, str):
                        raise
                    connection.send(json.dumps({"error": str(error)}))
                    continue
                if isinstance(piece, Change) and piece.clear:
                    decoder.clear()
                if not isinstance(piece, Change):
                    inbox.check_space()
                if not inbox.put(piece):
                    return
            inbox.put(decoder.decode(b"", is_last=True))
        except UserError as error:
            connection.close(_UNSUPPORTED, str(error)[:_MOST_REASON])
        finally:
            self._turn.release()

    def _take_turn(self, inbox: Inbox) -> bool:
        """Return whether the turn was taken from a sender that has vanished, such as one that lost its network.

        Its sound that waits is dropped.
        """
        sender = self._sender
        if sender is not None:
            with contextlib.suppress(require("websockets.exceptions", "live").ConnectionClosed):
                if sender.ping().wait(_ANSWER_SECONDS):
                    return False
                inbox.put(Change(clear=True))
            sender.close()
        return self._turn.acquire(timeout=_ANSWER_SECONDS)


def read_change(text: str) -> Change:
    """Parse {"muted": true}, {"state": "listen"}, {"clear": true} or a cue such as {"cue": "nod", "time": 1.2}.

    Raises:
        UserError: the text has another form, or there is no such cue.
    """
    try:
        message = parse_json(text)
    except ValueError:
        message = None
    if isinstance(message, dict) and "cue" in message:
        cue = read_cue(text)
        if cue.word is None:
            return Change(cue=cue)
    elif isinstance(message, dict) and len(message) == 1:
        ((name, value),) = message.items()
        if (name, value) in [("state", state) for state in STATES]:
            return Change(state=value)
        if (name == "muted" and isinstance(value, bool)) or (name == "clear" and value is True):
            return Change(**message)
        if name == "state":
            raise UserError(f"there is no state {shown(str(value)[:40])}; expected one of: {', '.join(STATES)}")
    raise UserError(
        'send sound as binary messages, and of text {"muted": true}, {"state": "listen"}, {"clear": true} or '
        '{"cue": "nod"} only, each by itself'
    )


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
            _say_listening(self.name)
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


def _say_listening(name: str) -> None:
    tqdm.write(f"listening to {name}", file=sys.stderr)


def open_source(text: str, rate: int | None = None, is_fast: bool = False, channels: int = 1) -> Source:
    """Return a source, whose sound begins when its chunks are read.

    Args:
        text: path of a file with sound, "stdin", "microphone" or ws://HOST:PORT.
        rate: samples per second of "stdin", "microphone" or the WebSocket; by default that of the microphone, or 16000.
        is_fast: whether a file is taken as fast as it is computed.
        channels: 2 for the agent and the other speaker; not for a microphone.

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
    if channels == 2 and text == "microphone":
        raise UserError("--channels 2 is for sound in which each person has a channel; a microphone hears both in one")
    if text == "stdin":
        return PipeSource(rate, channels=channels)
    if text == "microphone":
        return MicrophoneSource(rate)
    if text.startswith("ws://"):
        return WebSocketSource(read_address(text), rate, channels)
    if is_arriving:
        raise UserError(f"no source {shown(text)}; expected a file, stdin, microphone or ws://HOST:PORT")
    return FileSource(pathlib.Path(text), is_fast, channels)

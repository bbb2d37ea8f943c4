"""Sound of recordings as mono samples at 16 kHz, decoded by libsndfile or by FFmpeg in little memory."""

import contextlib
import functools
import logging
import pathlib
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple, TypeVar

import av
import numpy as np
import soundfile
import soxr
from av.container import InputContainer
from av.error import FFmpegError

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import quiet, reading, reason, shown
from ha2g_jax.limits import (
    MAX_SOUND_CHANNELS,
    MAX_SOUND_RATE,
    MAX_SOUND_SECONDS,
    MAX_SOUND_VALUES,
    MAX_VIDEO_PIXELS,
    MIN_SOUND_RATE,
)
from ha2g_jax.progress import counted

SAMPLE_RATE = 16000
MIN_SECONDS = 0.2
LOWEST_HZ = 80.0  # lowest frequency of speech, that of a deep voice

_INFINITE = 1e30  # sums of larger samples would overflow
_logger = logging.getLogger(__name__)

# FFmpeg knows hundreds of formats. Some are lists of other files or of network addresses, which an untrusted file must
# not make it open; another renders any text as a picture. The formats here are those of recordings.
_FORMATS = (
    *("3g2", "3gp", "aac", "ac3", "aiff", "amr", "amrnb", "amrwb", "ape", "asf", "au", "avi", "caf", "dsf", "dts"),
    *("dtshd", "dv", "eac3", "flac", "flv", "gsm", "gxf", "h264", "hevc", "ivf", "loas", "m4v", "matroska", "mlp"),
    *("mov", "mp3", "mp4", "mpc", "mpc8", "mpeg", "mpegts", "mpegvideo", "mxf", "nut", "obu", "ogg", "rm", "tak"),
    *("truehd", "tta", "voc", "w64", "wav", "webm", "wtv", "wv"),
)
MEDIA_ERRORS = (FFmpegError, OSError, ValueError, ArithmeticError, LookupError)
"""Exceptions that PyAV raises for damaged files."""
_MAX_PACKET_VALUES = 1 << 23  # samples of all channels, four times as many as the longest packet of a real codec
_OPTIONS = {
    "format_whitelist": ",".join(_FORMATS),
    # For the codecs that probe the beginning of a file while it is opened.
    "max_pixels": str(MAX_VIDEO_PIXELS),
    "max_samples": str(_MAX_PACKET_VALUES),
}
# Tags may have letters in any encoding. PyAV accepts them since version 19; before, it fails unless told to.
_TAGS: Any = {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}

# Exceptions of libsndfile and its wrapper, after which FFmpeg is tried.
_SOUNDFILE_ERRORS = (soundfile.SoundFileError, OSError, ValueError, ArithmeticError, TypeError, AssertionError)
_BLOCK = 1 << 20  # values that are decoded at a time
_MOST_HEADER = 1024  # bytes; a file of this size may be only a header
_LEAST_GAP = 0.015  # seconds between two frames above which there is a gap and not a rounding error
_CANCELLED = 0.1  # ratio of powers below which the mean of channels is not that of independent sounds
_INAUDIBLE = 2e-4  # range of the samples of silence, a few steps of 16-bit sound
_UNKNOWN = 1 << 62  # libsndfile's number of samples where a header does not state it
_RF64_SIZES, _RF64_BYTES = 20, 36  # where the sizes of a RF64 and of its sound begin and end
_SAMPLE_DUMP = b"\xf0\x7e"
_MPEG = b"\xff"  # first byte of MP3 without a tag; libsndfile's decoder prints to the terminal
_PADDING = SAMPLE_RATE // 10  # samples by which both ends are extended before sound is filtered
_PAIRWISE = 8  # number of channels from which NumPy adds in another order
_EXPECTED = "expected (samples, rate), an array of sound and its samples per second, as soundfile.read returns it"


_T = TypeVar("_T")


class _Block(NamedTuple):
    samples: np.ndarray  # (samples, channels) float32
    rate: int  # samples per second
    declared: int = 0  # samples of the whole file by its header, 0 if it does not state them


def read_audio(
    path: str | pathlib.Path, max_seconds: float = MAX_SOUND_SECONDS, *, name: str | None = None
) -> np.ndarray:
    """Read the audio of any file that libsndfile or PyAV (FFmpeg) reads, including videos.

    Channels are averaged, unless they cancel each other, for example because one is inverted: then the loudest is used.
    Of several tracks the one that a player would choose is read; lost packets are replaced by silence. Samples that are
    NaN or infinite become 0; audio with a peak above 1 is scaled to a peak of 1. A warning in the log names a file with
    such samples or channels, or with inaudible sound. No more than `max_seconds` are decoded.

    Args:
        path: file of sound.
        max_seconds: greatest length that is accepted.
        name: name of the file in warnings, by default its path.

    Returns:
        (samples,) float32, mono, 16 kHz; duration x 16000 samples, rounded.

    Raises:
        UserError: the file does not exist, has no audio, only NaN, is shorter than 0.2 s or longer than `max_seconds`,
            or is beyond another limit of sound in docs/limits.md.
    """
    return _decoded(path, lambda decode: _mono(decode, name or shown(path), max_seconds))


def read_voices(path: str | pathlib.Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the two channels of a file, each as `read_audio` reads a file.

    Raises:
        UserError: the file has another number of channels, or cannot be used, see `read_audio`.
    """

    def read(decode: Callable[[], Iterator[_Block]]) -> tuple[np.ndarray, np.ndarray]:
        return _channel(decode, path, 0), _channel(decode, path, 1)

    return _decoded(path, read)


def _decoded(path: str | pathlib.Path, read: Callable[[Callable[[], Iterator[_Block]]], _T]) -> _T:
    """Return what `read` makes of the sound of a file, which libsndfile decodes, or else FFmpeg."""
    path = pathlib.Path(path)
    with reading(path, "an audio file"):
        size = path.stat().st_size if path.is_file() else None
    if size is None:
        raise UserError(
            f"{'a folder' if path.is_dir() else 'no file'} at {shown(path)}; give the path of an audio file"
        )
    # Sums of samples that are damaged may be infinite.
    with reading(path, "a recording of speech"), np.errstate(over="ignore", invalid="ignore"):
        try:
            return read(functools.partial(_libsndfile_blocks, path))
        except _SOUNDFILE_ERRORS:
            return read(functools.partial(_ffmpeg_blocks, path))


def _channel(decode: Callable[[], Iterator[_Block]], path: str | pathlib.Path, channel: int) -> np.ndarray:
    """Return the samples of one of two channels, with a peak of at most 1."""

    def blocks() -> Iterator[_Block]:
        for block in decode():
            if (count := block.samples.shape[1]) != 2:
                raise UserError(f"{shown(path)} has {counted(count, 'channel')}; expected 2, one for each voice")
            yield block

    return _limited(_collect(blocks(), shown(path), MAX_SOUND_SECONDS, channel)[0])


def convert_samples(samples: np.ndarray, rate: int) -> np.ndarray:
    """Convert sound that another library has read, with the rules of `read_audio`.

    Args:
        samples: (samples,), (samples, channels) or (channels, samples), floats within -1 and 1, or signed integers of
            the full range of at most 32 bits.
        rate: samples per second.

    Raises:
        UserError: the arguments are not samples and their rate, or the sound cannot be used, see `read_audio`.
    """
    sound, rate = _floats(samples, rate)
    sound = sound[:, None] if sound.ndim == 1 else sound.T if sound.shape[0] < sound.shape[1] else sound
    if sound.shape[1] > MAX_SOUND_CHANNELS:
        raise UserError(f"the speech has the shape {np.shape(samples)}; {_EXPECTED}")
    block = _Block(np.ascontiguousarray(sound, np.float32), rate)
    with np.errstate(over="ignore", invalid="ignore"):
        return _mono(lambda: iter([block]), "the speech", MAX_SOUND_SECONDS)


def check_mono(samples: np.ndarray, rate: int) -> tuple[np.ndarray, int]:
    """Return mono sound that is shown with a motion as floats (samples,) within -1 and 1, and its rate as an `int`.

    Args:
        samples: (samples,) of a type of `convert_samples`; with a peak above 1 they are scaled to a peak of 1.
        rate: samples per second.

    Raises:
        UserError: these are no samples and their rate, or the sound is not mono or not finite.
    """
    sound, rate = _floats(samples, rate)
    if sound.ndim != 1:
        raise UserError(f"the sound has shape {sound.shape}; mix it to mono, (samples,)")
    if not np.isfinite(sound).all():
        raise UserError("the sound has samples that are not finite; read or compute it again")
    return (_limited(sound) if len(sound) else sound), rate


def _floats(samples: np.ndarray, rate: int) -> tuple[np.ndarray, int]:
    """Return sound of one or two dimensions as floats, integers divided by their full range, and its rate."""
    sound = np.asarray(samples)
    if np.ndim(rate) or not np.issubdtype(np.asarray(rate).dtype, np.number) or sound.ndim not in (1, 2):
        raise UserError(f"the speech is a pair of {type(samples).__name__} and {type(rate).__name__}; {_EXPECTED}")
    if not MIN_SOUND_RATE <= rate <= MAX_SOUND_RATE or rate != int(rate):
        raise UserError(f"the speech has {rate} samples per second; {_EXPECTED}")
    # Integers of 64 bits come from a list or a sum; their full range is not that of the samples.
    if np.issubdtype(sound.dtype, np.signedinteger) and sound.itemsize <= 4:
        sound = sound / -float(np.iinfo(sound.dtype).min)
    elif not np.issubdtype(sound.dtype, np.floating):
        raise UserError(f"the speech is an array of {sound.dtype}; expected floats within -1 and 1, int16 or int32")
    return sound, int(rate)


def _mono(decode: Callable[[], Iterator[_Block]], name: str, max_seconds: float) -> np.ndarray:
    """Return the mean of the channels, or the loudest channel if they cancel each other, with a peak of at most 1."""
    samples, power, powers = _collect(decode(), name, max_seconds)
    # The mean of independent sounds has the power sum(powers) / channels^2.
    if power < _CANCELLED * powers.sum() / len(powers) ** 2:
        channel = int(powers.argmax())
        _logger.warning("%s: its channels cancel each other; channel %d is used", name, channel + 1)
        samples, _, _ = _collect(decode(), name, max_seconds, channel)
    if np.ptp(samples) < _INAUDIBLE:
        _logger.warning("%s is silent", name)
    return _limited(samples)


def _limited(samples: np.ndarray) -> np.ndarray:
    """Return samples whose peak is at most 1."""
    peak = max(samples.max(), -samples.min())
    return samples / peak if peak > 1 else samples


def _collect(
    blocks: Iterator[_Block], name: str, max_seconds: float, channel: int | None = None
) -> tuple[np.ndarray, float, np.ndarray]:
    """Read sound block by block, with the same result as all of it at once.

    Returns (samples,) float32 at 16 kHz, the mean of the channels or one of them; and the sum of its squares before
    resampling, and that of each channel.
    """
    parts, num_samples, num_bad, rate, resampler = [], 0, 0, SAMPLE_RATE, None
    power, powers = 0.0, np.zeros(0)
    for block in blocks:
        if block.rate != SAMPLE_RATE and resampler is None:
            rate = block.rate
            resampler = soxr.ResampleStream(rate, SAMPLE_RATE, 1, dtype="float32", quality="HQ")
        num_samples += len(block.samples)
        _check_most(max(num_samples, block.declared), rate, block.samples.shape[1], name, max_seconds)
        samples, bad = _finite(_mix(block.samples) if channel is None else block.samples[:, channel])
        power += float(samples @ samples)
        if not bad:
            squares = np.einsum("ij,ij->j", block.samples, block.samples)
            powers = squares + powers if len(powers) == len(squares) else squares
        num_bad += bad
        parts.append(samples if resampler is None else resampler.resample_chunk(samples))
    _check_least(num_samples, rate, name)
    _report(num_bad, num_samples, name)
    if resampler is not None:
        parts.append(resampler.resample_chunk(np.zeros(0, np.float32), last=True))
    samples = np.concatenate(parts)
    expected = round(num_samples * SAMPLE_RATE / rate)
    samples = samples[:expected] if len(samples) >= expected else np.pad(samples, (0, expected - len(samples)))
    return samples, power, powers


def check_samples(samples: np.ndarray) -> np.ndarray:
    """Return speech (samples,) float32 at 16 kHz with 0 in place of samples that are not finite, with a warning in the
    log.

    Raises:
        UserError: the speech is shorter than 0.2 s or longer than 65 minutes, or no sample is finite.
    """
    name = "the speech"
    _check_least(len(samples), SAMPLE_RATE, name)
    _check_most(len(samples), SAMPLE_RATE, 1, name, MAX_SOUND_SECONDS)
    samples, num_bad = _finite(samples)
    _report(num_bad, len(samples), name)
    return samples


def _check_least(num_samples: int, rate: int, name: str) -> None:
    if (seconds := num_samples / rate) < MIN_SECONDS:
        raise UserError(f"{name} has {seconds:.3f} s of sound; expected at least {MIN_SECONDS} s of speech")


def _check_most(num_samples: int, rate: int, channels: int, name: str, max_seconds: float) -> None:
    if num_samples / rate > max_seconds:
        raise UserError(f"{name} has more than {max_seconds / 60:.3g} minutes of sound; cut it into shorter parts")
    if num_samples * max(channels, 2) > MAX_SOUND_VALUES:  # resampling them takes as long as decoding a channel
        raise UserError(
            f"{name} is too long for a recording of {channels} channels at {rate} Hz; convert it to mono at 48 kHz"
        )


def _finite(samples: np.ndarray) -> tuple[np.ndarray, int]:
    """Replace samples that are NaN, infinite or too large to be resampled, and return all samples and their number."""
    is_finite = np.abs(samples) < _INFINITE
    bad = len(samples) - int(np.count_nonzero(is_finite))
    return (np.where(is_finite, samples, np.float32(0)) if bad else samples), bad


def _report(num_bad: int, num_samples: int, name: str) -> None:
    if num_bad == num_samples:
        raise UserError(f"{name} has only NaN or infinite samples; export the recording again")
    if num_bad:
        _logger.warning("%s: %d of %d samples are NaN or infinite; taken as silence", name, num_bad, num_samples)


def high_pass(audio: np.ndarray) -> np.ndarray:
    """Remove frequencies below `LOWEST_HZ` from sound (samples,) float32 at 16 kHz, without delay."""
    from scipy import signal  # few methods read samples, and its import takes a while

    sections = signal.butter(4, LOWEST_HZ, "highpass", fs=SAMPLE_RATE, output="sos")
    return signal.sosfiltfilt(sections, audio, padlen=min(_PADDING, len(audio) - 1)).astype(np.float32)


def window_samples(num_frames: int, fps: float) -> int:
    """Return the number of samples at 16 kHz in a window, rounded: 36,267 for 34 frames at 15 fps."""
    return round(num_frames * SAMPLE_RATE / fps)


def wave_window(audio: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the samples (`window_samples`,) of a window of a clip (samples,) at 16 kHz; past its end is silence."""
    start, samples = round(start_frame * SAMPLE_RATE / fps), window_samples(num_frames, fps)
    window = audio[start : start + samples]
    return np.pad(window, (0, samples - len(window)))


def _libsndfile_blocks(path: pathlib.Path) -> Generator[_Block, None, None]:
    """Yield the sound of a file that libsndfile reads; the first block is empty and holds the values of the header."""
    # The file is passed as a descriptor: with a name libsndfile would trust the suffix more than the contents, and with
    # a Python file an offset in a damaged header would raise in a callback, where Python can only print the error.
    with path.open("rb", buffering=0) as raw:
        head = raw.read(3)
        raw.seek(0)
        if head.startswith(_SAMPLE_DUMP):
            raise ValueError("a MIDI sample dump, whose decoder prints")
        silence = quiet if head == b"ID3" or head[:1] == _MPEG else contextlib.nullcontext
        with silence():
            file = soundfile.SoundFile(raw.fileno(), closefd=False)
        with file:
            rate, channels = file.samplerate, file.channels
            _check_header(path, rate, channels)
            declared = file.frames if 0 < file.frames < _UNKNOWN else 0
            if not file.frames and path.stat().st_size > _MOST_HEADER:
                raise ValueError("a header that was never finished; FFmpeg reads to the end of the file")
            yield _Block(np.zeros((0, channels), np.float32), rate, declared)
            while True:
                with silence():
                    block = file.read(_BLOCK // channels, dtype="float32", always_2d=True)
                if not len(block):
                    return
                yield _Block(block, rate)


def _ffmpeg_blocks(path: pathlib.Path) -> Generator[_Block, None, None]:
    try:
        with open_media(path) as container:
            if (stream := sound_track(container)) is None:
                raise UserError(f"{shown(path)} has no sound; expected a recording of speech, or a video with sound")
            yield from _decode(path, stream, container)
    except MEDIA_ERRORS as error:
        raise UserError(
            f"{shown(path)} holds no sound that can be read ({reason(error).lower()}); expected a recording of speech"
        ) from error


def sound_track(container: InputContainer) -> av.AudioStream | None:
    """Return the audio track that a player would choose: the one marked as default, or else the best one."""
    stream = container.streams.best("audio") or next(iter(container.streams.audio), None)  # best may be None
    return stream if isinstance(stream, av.AudioStream) else None


def sound_start(path: pathlib.Path) -> float:
    """Return the time in seconds at which the sound of a file starts, on the clock of its images; 0 without sound.

    Raises:
        One of `MEDIA_ERRORS`: the file cannot be read, or is not a recording.
    """
    with open_media(path) as container:
        return _first_time(container)


def sound_delay(path: pathlib.Path) -> float:
    """Return the seconds from the beginning of a file, from which subtitles count, to that of its sound.

    They are 0 without sound, and of a file that FFmpeg does not read, which has no images.
    """
    if not path.is_file():  # a pipe would be read for ever
        return 0.0
    try:
        with open_media(path) as container:
            return _first_time(container) - (container.start_time or 0) / av.time_base
    except MEDIA_ERRORS:
        return 0.0


def _first_time(container: InputContainer) -> float:
    stream = sound_track(container)
    first = None if stream is None else next(container.decode(stream), None)
    return (first.time if first else None) or 0.0


def has_sound(path: pathlib.Path) -> bool:
    """Return whether the beginning of a regular file is one of sound, or of a video with sound."""
    try:
        with contextlib.closing(_libsndfile_blocks(path)) as blocks:
            return next(blocks, None) is not None
    except UserError:  # sound beyond the limits
        return True
    except _SOUNDFILE_ERRORS:
        pass
    try:
        with contextlib.closing(_ffmpeg_blocks(path)) as blocks:
            return next(blocks, None) is not None
    except UserError:
        return False


def _decode(path: pathlib.Path, stream: av.AudioStream, container: InputContainer) -> Generator[_Block, None, None]:
    context = stream.codec_context
    if context is None:
        raise ValueError("of an unknown codec")
    rate = context.sample_rate
    _check_header(path, rate, context.channels)
    context.options = {"max_samples": str(_MAX_PACKET_VALUES)}
    # Interleaved, because PyAV reads beyond the planes of a frame of eight channels.
    to_float = av.AudioResampler(format="flt")
    start, num_samples = None, 0
    for frame in container.decode(stream):
        if frame.sample_rate != rate:
            raise ValueError(f"the sample rate changes from {rate} to {frame.sample_rate}")
        channels = frame.layout.nb_channels
        _check_header(path, rate, channels)
        if frame.time is not None:
            start = frame.time if start is None else start
            lost = round((frame.time - start) * rate) - num_samples
            if lost > _LEAST_GAP * rate:
                num_samples += lost
                for first in range(0, lost, _BLOCK):  # a reader stops at its limit, whatever time a file states
                    yield _Block(np.zeros((min(_BLOCK, lost - first), channels), np.float32), rate)
        num_samples += frame.samples
        for part in to_float.resample(frame):
            yield _Block(part.to_ndarray().reshape(-1, channels), rate)


def _check_header(path: pathlib.Path, rate: int, channels: int) -> None:
    if not MIN_SOUND_RATE <= rate <= MAX_SOUND_RATE:
        raise UserError(
            f"{shown(path)} declares {rate} samples per second; expected at least {MIN_SOUND_RATE} and at most "
            f"{MAX_SOUND_RATE}"
        )
    if not 1 <= channels <= MAX_SOUND_CHANNELS:
        raise UserError(f"{shown(path)} has {channels} channels; expected 1 to {MAX_SOUND_CHANNELS}")


def _mix(block: np.ndarray) -> np.ndarray:
    """Return the mean of the channels, (samples,), as `block.mean(axis=1)`, but several times as fast."""
    channels = block.shape[1]
    if channels >= _PAIRWISE:
        return block.mean(axis=1)
    mixed = block[:, 0].copy()
    for channel in range(1, channels):
        mixed += block[:, channel]
    return mixed / np.float32(channels)


def open_media(path: pathlib.Path) -> InputContainer:
    """Open a file of sound or images, of any name, which the caller must close.

    Raises:
        One of `MEDIA_ERRORS`: the file cannot be read, or is not a recording.
    """
    with path.open("rb") as file:
        head = file.read(_RF64_BYTES)
    # A recorder that crashed leaves a RF64 whose sizes are 0, and all of the file is sound.
    is_unfinished = head.startswith((b"RF64", b"BW64")) and not any(head[_RF64_SIZES:])
    options = _OPTIONS | ({"ignore_length": "1"} if is_unfinished else {})
    # Without "file:" the part of a name before a colon would be taken for a protocol.
    return av.open(f"file:{path}", options=options, **_TAGS)

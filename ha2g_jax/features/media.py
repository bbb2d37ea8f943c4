"""Files of sound and video of any program, decoded block by block by libsndfile or by FFmpeg."""

import contextlib
import functools
import pathlib
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple, TypeVar

import av
import numpy as np
import soundfile
from av.container import InputContainer
from av.error import FFmpegError
from av.stream import Disposition

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import quiet, reading, reason, shown
from ha2g_jax.limits import MAX_SOUND_CHANNELS, MAX_SOUND_RATE, MAX_VIDEO_PIXELS, MIN_SOUND_RATE

# FFmpeg knows hundreds of formats. Some are lists of other files or of network addresses, which an untrusted file must
# not make it open; another renders any text as a picture. The formats here are those of recordings.
_FORMATS = (
    *("3g2", "3gp", "aac", "ac3", "aiff", "amr", "amrnb", "amrwb", "ape", "asf", "au", "avi", "caf", "dsf", "dts"),
    *("dtshd", "dv", "eac3", "flac", "flv", "gsm", "gxf", "h264", "hevc", "ivf", "loas", "m4v", "matroska", "mlp"),
    *("mov", "mp3", "mp4", "mpc", "mpc8", "mpeg", "mpegts", "mpegvideo", "mxf", "nut", "obu", "ogg", "rm", "tak"),
    *("truehd", "tta", "voc", "w64", "wav", "webm", "wtv", "wv"),
)
SOUND_SUFFIXES = (".wav", ".flac", ".mp3", ".m4a", ".aac", ".ogg", ".opus", ".wma", ".aiff", ".aif")
"""Suffixes of files that hold sound alone, in order of preference."""
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
_UNKNOWN = 1 << 62  # libsndfile's number of samples where a header does not state it
_RF64_SIZES, _RF64_BYTES = 20, 36  # where the sizes of a RF64 and of its sound begin and end
_SAMPLE_DUMP = b"\xf0\x7e"
_MPEG = b"\xff"  # first byte of MP3 without a tag; libsndfile's decoder prints to the terminal

_T = TypeVar("_T")


class Block(NamedTuple):
    """A part of the sound of a file."""

    samples: np.ndarray  # (samples, channels) float32
    rate: int  # samples per second
    declared: int = 0  # samples of the whole file by its header, 0 if it does not state them


def read_sound(path: str | pathlib.Path, read: Callable[[Callable[[], Iterator[Block]]], _T]) -> _T:
    """Read the sound of a file, which libsndfile decodes, or else FFmpeg.

    Args:
        path: file of sound, or a video with sound.
        read: what is made of the sound; it takes a function that begins to decode the file and yields its blocks, and
            may call it several times.

    Returns:
        What `read` returned.

    Raises:
        UserError: the file does not exist, has no sound, or is beyond a limit of sound in docs/limits.md.
    """
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


def _libsndfile_blocks(path: pathlib.Path) -> Generator[Block, None, None]:
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
            yield Block(np.zeros((0, channels), np.float32), rate, declared)
            while True:
                with silence():
                    block = file.read(_BLOCK // channels, dtype="float32", always_2d=True)
                if not len(block):
                    return
                yield Block(block, rate)


def _ffmpeg_blocks(path: pathlib.Path) -> Generator[Block, None, None]:
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


def video_track(container: InputContainer) -> av.VideoStream | None:
    """Return the track of images that a player would choose; pictures of a cover are none."""
    best = container.streams.best("video")  # the largest, or that which is marked as default; may be None
    tracks = [best, *container.streams.video]
    return next((each for each in tracks if isinstance(each, av.VideoStream) and not _is_cover(each)), None)


def _is_cover(stream: av.VideoStream) -> bool:
    return bool(stream.disposition & Disposition.attached_pic)


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


def sound_after_images(path: pathlib.Path) -> float:
    """Return the seconds from the first image of a video to the beginning of its sound; 0 without images or sound.

    It is negative where the sound begins first, and 0 for a file that FFmpeg does not read, which has no images.
    """
    try:
        with open_media(path) as container:
            images = video_track(container)
            if images is None or sound_track(container) is None:
                return 0.0
            first = next(container.decode(images), None)
        return sound_start(path) - ((first.time if first else None) or 0.0)
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


def _decode(path: pathlib.Path, stream: av.AudioStream, container: InputContainer) -> Generator[Block, None, None]:
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
                    yield Block(np.zeros((min(_BLOCK, lost - first), channels), np.float32), rate)
        num_samples += frame.samples
        for part in to_float.resample(frame):
            yield Block(part.to_ndarray().reshape(-1, channels), rate)


def _check_header(path: pathlib.Path, rate: int, channels: int) -> None:
    if not MIN_SOUND_RATE <= rate <= MAX_SOUND_RATE:
        raise UserError(
            f"{shown(path)} declares {rate} samples per second; expected at least {MIN_SOUND_RATE} and at most "
            f"{MAX_SOUND_RATE}"
        )
    if not 1 <= channels <= MAX_SOUND_CHANNELS:
        raise UserError(f"{shown(path)} has {channels} channels; expected 1 to {MAX_SOUND_CHANNELS}")

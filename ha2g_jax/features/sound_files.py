"""Files of sound as blocks of mono samples, decoded by libsndfile or by FFmpeg in little memory."""

import contextlib
import pathlib
from collections.abc import Generator
from typing import NamedTuple

import av
import numpy as np
import soundfile
from av.container import InputContainer

from ha2g_jax.errors import UserError
from ha2g_jax.features.media import MAX_PACKET_VALUES, MEDIA_ERRORS, open_media
from ha2g_jax.files.reading import quiet, reason, shown
from ha2g_jax.limits import MAX_SOUND_CHANNELS, MAX_SOUND_RATE, MIN_SOUND_RATE

# Exceptions of libsndfile and its wrapper, after which FFmpeg is tried.
SOUNDFILE_ERRORS = (soundfile.SoundFileError, OSError, ValueError, ArithmeticError, TypeError, AssertionError)

_BLOCK = 1 << 20  # values that are decoded at a time
_UNKNOWN = 1 << 62  # libsndfile's number of samples where a header does not state it
_SAMPLE_DUMP = b"\xf0\x7e"
_MPEG = b"\xff"  # first byte of MP3 without a tag; its decoder prints
_PAIRWISE = 8  # channels from which NumPy adds in another order


class Block(NamedTuple):
    """Decoded sound.

    Attributes:
        samples: (samples,) float32, mean of the channels.
        rate: samples per second.
        channels: number of channels of the file.
        declared: samples of the whole file by its header, 0 if it does not say.
    """

    samples: np.ndarray
    rate: int
    channels: int
    declared: int = 0


def libsndfile_blocks(path: pathlib.Path) -> Generator[Block, None, None]:
    """Yield the sound of a file that libsndfile reads; the first block is empty and has what the header declares.

    Args:
        path: path of the file.

    Raises:
        UserError: rate or number of channels are outside the limits.
    """
    # The file is passed as a number: libsndfile would use a name before the contents, and an offset in a damaged header
    # would raise in a callback, where Python can only print it.
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
            yield Block(np.zeros(0, np.float32), rate, channels, declared)
            while True:
                with silence():
                    block = file.read(_BLOCK // channels, dtype="float32", always_2d=True)
                if not len(block):
                    return
                yield Block(_mix(block), rate, channels)


def ffmpeg_blocks(path: pathlib.Path) -> Generator[Block, None, None]:
    """Yield the sound of a file that FFmpeg reads.

    Args:
        path: path of the file.

    Raises:
        UserError: the file has no sound, cannot be decoded, or rate or number of channels are outside the limits.
    """
    try:
        with open_media(path) as container:
            if not container.streams.audio:
                raise UserError(f"{shown(path)} has no sound; expected a recording of speech, or a video with sound")
            yield from _decode(path, container.streams.audio[0], container)
    except MEDIA_ERRORS as error:
        raise UserError(
            f"{shown(path)} holds no sound that can be read ({reason(error).lower()}); expected a recording of speech"
        ) from error


def has_sound(path: pathlib.Path) -> bool:
    """Return whether the beginning of a file is one of sound, or of a video with sound.

    Args:
        path: path of a regular file.
    """
    try:
        with contextlib.closing(libsndfile_blocks(path)) as blocks:
            return next(blocks, None) is not None
    except UserError:  # sound beyond the limits
        return True
    except SOUNDFILE_ERRORS:
        pass
    try:
        with contextlib.closing(ffmpeg_blocks(path)) as blocks:
            return next(blocks, None) is not None
    except UserError:
        return False


def _decode(path: pathlib.Path, stream: av.AudioStream, container: InputContainer) -> Generator[Block, None, None]:
    context = stream.codec_context
    if context is None:
        raise ValueError("of an unknown codec")
    rate = context.sample_rate
    _check_header(path, rate, context.channels)
    context.options = {"max_samples": str(MAX_PACKET_VALUES)}
    # Interleaved, because PyAV reads beyond the planes of a frame of eight channels.
    to_float = av.AudioResampler(format="flt")
    for frame in container.decode(stream):
        if frame.sample_rate != rate:
            raise ValueError(f"the sample rate changes from {rate} to {frame.sample_rate}")
        channels = frame.layout.nb_channels
        _check_header(path, rate, channels)
        for part in to_float.resample(frame):
            yield Block(_mix(part.to_ndarray().reshape(-1, channels)), rate, channels)


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

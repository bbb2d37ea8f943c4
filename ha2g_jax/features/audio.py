"""Speech as mono samples at 16 kHz, read block by block in little memory, and what is cut from them."""

import logging
import pathlib
from collections.abc import Callable, Iterator

import numpy as np
import soxr

from ha2g_jax.errors import UserError
from ha2g_jax.features.media import Block, read_sound
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import (
    MAX_SOUND_CHANNELS,
    MAX_SOUND_RATE,
    MAX_SOUND_SECONDS,
    MAX_SOUND_VALUES,
    MIN_SOUND_RATE,
)
from ha2g_jax.progress import counted

SAMPLE_RATE = 16000
MIN_SECONDS = 0.2
LOWEST_HZ = 80.0  # lowest frequency of speech, that of a deep voice

_logger = logging.getLogger(__name__)

_INFINITE = 1e30  # sums of larger samples would overflow
_CANCELLED = 0.1  # ratio of powers below which the mean of channels is not that of independent sounds
_INAUDIBLE = 2e-4  # range of the samples of silence, a few steps of 16-bit sound
_PADDING = SAMPLE_RATE // 10  # samples by which both ends are extended before sound is filtered
_PAIRWISE = 8  # number of channels from which NumPy adds in another order
_EXPECTED = "expected (samples, rate), an array of sound and its samples per second, as soundfile.read returns it"


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
        name: name of the file in errors and warnings, by default its path.

    Returns:
        (samples,) float32, mono, 16 kHz; duration x 16000 samples, rounded.

    Raises:
        UserError: the file does not exist, has no audio, only NaN, is shorter than 0.2 s or longer than `max_seconds`,
            or is beyond another limit of sound in docs/limits.md.
    """
    name = name or shown(path)
    try:
        return read_sound(path, lambda decode: _mono(decode, name, max_seconds))
    except UserError as error:
        raise UserError(str(error).replace(shown(path), name)) from error


def read_voices(path: str | pathlib.Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the two channels of a file, each as `read_audio` reads a file.

    Raises:
        UserError: the file has another number of channels, or cannot be used, see `read_audio`.
    """

    def read(decode: Callable[[], Iterator[Block]]) -> tuple[np.ndarray, np.ndarray]:
        return _channel(decode, path, 0), _channel(decode, path, 1)

    return read_sound(path, read)


def _channel(decode: Callable[[], Iterator[Block]], path: str | pathlib.Path, channel: int) -> np.ndarray:
    """Return the samples of one of two channels, with a peak of at most 1."""

    def blocks() -> Iterator[Block]:
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
    block = Block(np.ascontiguousarray(sound, np.float32), rate)
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


def _mono(decode: Callable[[], Iterator[Block]], name: str, max_seconds: float) -> np.ndarray:
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
    blocks: Iterator[Block], name: str, max_seconds: float, channel: int | None = None
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
    """Return speech (samples,) float32 at 16 kHz with a peak of at most 1, and with 0 in place of samples that are not
    finite, with a warning in the log.

    Raises:
        UserError: the speech is shorter than 0.2 s or longer than 65 minutes, or no sample is finite.
    """
    name = "the speech"
    _check_least(len(samples), SAMPLE_RATE, name)
    _check_most(len(samples), SAMPLE_RATE, 1, name, MAX_SOUND_SECONDS)
    samples, num_bad = _finite(samples)
    _report(num_bad, len(samples), name)
    return _limited(samples)


def _check_least(num_samples: int, rate: int, name: str) -> None:
    if (seconds := num_samples / rate) < MIN_SECONDS:
        raise UserError(f"{name} has {seconds:.3f} s of sound; expected at least {MIN_SECONDS} s of speech")


def _check_most(num_samples: int, rate: int, channels: int, name: str, max_seconds: float) -> None:
    if num_samples / rate > max_seconds:
        raise UserError(f"{name} has more than {max_seconds / 60:.3g} min of sound; cut it into shorter parts")
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


def _mix(block: np.ndarray) -> np.ndarray:
    """Return the mean of the channels, (samples,), as `block.mean(axis=1)`, but several times as fast."""
    channels = block.shape[1]
    if channels >= _PAIRWISE:
        return block.mean(axis=1)
    mixed = block[:, 0].copy()
    for channel in range(1, channels):
        mixed += block[:, channel]
    return mixed / np.float32(channels)

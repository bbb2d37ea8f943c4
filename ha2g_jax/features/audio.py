"""Speech: reader of audio files as mono 16 kHz samples, and the log-mel spectrogram of the models.

The spectrogram is librosa's: FFT 1024, hop 512, Hann window, centred frames with reflected borders, 128 mel bands of
Slaney's scale and area normalisation over 0-8 kHz, power to dB. D11: 0 dB is the maximum of the clip, the floor lies
80 dB below it; the spectrogram is computed once per clip and sliced at the nearest column.
"""

import logging
import pathlib
from collections.abc import Iterator

import numpy as np
import soxr

from ha2g_jax.errors import UserError
from ha2g_jax.features import sound_files
from ha2g_jax.features.sound_files import Block
from ha2g_jax.features.spectrum import mel_frequencies, mel_spectrum, power_spectrum
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.limits import MAX_SOUND_SECONDS, MAX_SOUND_VALUES

SAMPLE_RATE = 16000
FFT_SIZE = 1024
HOP_LENGTH = 512
NUM_MELS = 128
FLOOR_DB = -80.0
MIN_SECONDS = 0.2

# A clip whose loudest mel power is lower is silence: 70 dB below the noise of 16-bit rounding.
_SILENCE_POWER = 1e-15
_INFINITE = 1e30  # greater samples would overflow in sums of them

_logger = logging.getLogger(__name__)


def read_audio(path: str | pathlib.Path, max_seconds: float = MAX_SOUND_SECONDS) -> np.ndarray:
    """Read the audio of any file that libsndfile or PyAV (FFmpeg) reads, including videos.

    Channels are averaged; samples that are NaN or infinite become 0, with a warning in the log; audio with a peak above
    1 is scaled to a peak of 1.

    Args:
        path: path of the file.
        max_seconds: seconds of sound at most; no more than these are decoded.

    Returns:
        (samples,) float32, mono, 16 kHz; duration x 16000 samples, rounded.

    Raises:
        UserError: the file does not exist, has no audio, only NaN, is shorter than 0.2 s or longer than `max_seconds`,
            or is beyond another limit of sound in docs/limits.md.
    """
    path = pathlib.Path(path)
    with reading(path, "an audio file"):
        size = path.stat().st_size if path.is_file() else None
    if size is None:
        raise UserError(
            f"{'a folder' if path.is_dir() else 'no file'} at {shown(path)}; give the path of an audio file"
        )
    if size == 0:
        raise UserError(f"{shown(path)} is an empty file; expected a recording of speech")
    # Sums of samples that are damaged may be infinite.
    with reading(path, "a recording of speech"), np.errstate(over="ignore", invalid="ignore"):
        try:
            samples = _collect(sound_files.libsndfile_blocks(path), shown(path), max_seconds)
        except sound_files.SOUNDFILE_ERRORS:
            samples = _collect(sound_files.ffmpeg_blocks(path), shown(path), max_seconds)
    peak = max(samples.max(), -samples.min())
    if peak > 1:
        samples /= peak
    return samples


def _collect(blocks: Iterator[Block], name: str, max_seconds: float) -> np.ndarray:
    """Return the sound of blocks, (samples,) float32 at 16 kHz; it is resampled block by block, which gives the same
    samples as to resample all of it at once."""
    parts, num_samples, num_bad, rate, resampler = [], 0, 0, SAMPLE_RATE, None
    for block in blocks:
        if block.rate != SAMPLE_RATE and resampler is None:
            rate = block.rate
            resampler = soxr.ResampleStream(rate, SAMPLE_RATE, 1, dtype="float32", quality="HQ")
        num_samples += len(block.samples)
        _check_most(max(num_samples, block.declared), rate, block.channels, name, max_seconds)
        samples, bad = _finite(block.samples)
        num_bad += bad
        parts.append(samples if resampler is None else resampler.resample_chunk(samples))
    _check_least(num_samples, rate, name)
    _report(num_bad, num_samples, name)
    if resampler is not None:
        parts.append(resampler.resample_chunk(np.zeros(0, np.float32), last=True))
    samples = np.concatenate(parts)
    expected = round(num_samples * SAMPLE_RATE / rate)
    return samples[:expected] if len(samples) >= expected else np.pad(samples, (0, expected - len(samples)))


def check_samples(samples: np.ndarray, rate: int, name: str) -> np.ndarray:
    """Check samples, and replace those that are not finite.

    Args:
        samples: (samples,) float32.
        rate: samples per second.
        name: name of the audio in an error message.

    Returns:
        (samples,) float32, in which NaN and infinite samples are replaced by 0, with a warning in the log.

    Raises:
        UserError: the audio is shorter than 0.2 s or longer than 65 minutes, or no sample is finite.
    """
    _check_least(len(samples), rate, name)
    _check_most(len(samples), rate, 1, name, MAX_SOUND_SECONDS)
    samples, num_bad = _finite(samples)
    _report(num_bad, len(samples), name)
    return samples


def _check_least(num_samples: int, rate: int, name: str) -> None:
    if (seconds := num_samples / rate) < MIN_SECONDS:
        raise UserError(f"{name} has {seconds:.3f} s of sound; expected at least {MIN_SECONDS} s of speech")


def _check_most(num_samples: int, rate: int, channels: int, name: str, max_seconds: float) -> None:
    if num_samples / rate > max_seconds:
        raise UserError(f"{name} has more than {max_seconds / 60:.3g} minutes of sound; cut it into shorter parts")
    if num_samples * max(channels, 2) > MAX_SOUND_VALUES:  # to resample them takes as long as to decode a channel
        raise UserError(
            f"{name} is too long for a recording of {channels} channels at {rate} Hz; convert it to mono at 48 kHz"
        )


def _finite(samples: np.ndarray) -> tuple[np.ndarray, int]:
    """Return samples without those that are NaN, infinite, or too large to be resampled, and the number of these."""
    is_finite = np.abs(samples) < _INFINITE
    bad = len(samples) - int(np.count_nonzero(is_finite))
    return (np.where(is_finite, samples, np.float32(0)) if bad else samples), bad


def _report(num_bad: int, num_samples: int, name: str) -> None:
    if num_bad == num_samples:
        raise UserError(f"{name} has only NaN or infinite samples; export the recording again")
    if num_bad:
        _logger.warning("%s: %d of %d samples are NaN or infinite; taken as silence", name, num_bad, num_samples)


def log_mel(audio: np.ndarray, reference: float | None = None) -> np.ndarray:
    """Compute the log-mel spectrogram of a clip in dB relative to its maximum (D11).

    For a clip of ordinary loudness this is `librosa.power_to_db(melspectrogram(...), ref=np.max)`. Unlike that of
    librosa, the floor is relative to the clip, so that the result does not depend on the volume, and silence is at the
    floor and not at 0 dB.

    Args:
        audio: (samples,) float32 at 16 kHz, at least 1 sample.
        reference: mel power of 0 dB; the maximum of the clip by default.

    Returns:
        (128, 1 + samples // 512) float32 in [-80, 0].
    """
    power = mel_power(np.pad(np.asarray(audio, np.float32), FFT_SIZE // 2, mode="reflect"))
    return decibels(power, float(np.max(power)) if reference is None else reference)


def mel_power(padded: np.ndarray) -> np.ndarray:
    """Compute the mel powers of sound.

    Args:
        padded: (samples,) float32 at 16 kHz, at least 1024 samples; column c is that of samples 512 c to 512 c + 1023.

    Returns:
        (128, 1 + (samples - 1024) // 512) float32.
    """
    return mel_spectrum(power_spectrum(padded, FFT_SIZE, HOP_LENGTH), SAMPLE_RATE, FFT_SIZE, NUM_MELS)


def decibels(power: np.ndarray, reference: float) -> np.ndarray:
    """Return mel powers in dB relative to a reference, in [-80, 0]; all of them -80 if the reference is silence.

    Args:
        power: (128, columns) float32 mel powers.
        reference: mel power of 0 dB.
    """
    if reference < _SILENCE_POWER:
        return np.full(power.shape, FLOOR_DB, np.float32)
    ratio = np.clip(power / np.float32(reference), 10 ** (FLOOR_DB / 10), 1)
    return np.clip(10 * np.log10(ratio), FLOOR_DB, 0, dtype=np.float32)


def sound_power(power: np.ndarray) -> float:
    """Compute the mean power of a sound, up to a constant factor.

    A band holds power per hertz (Slaney's area normalisation), so bands are weighted by their width.

    Args:
        power: (128, columns) mel powers.
    """
    edges = mel_frequencies(NUM_MELS + 2, SAMPLE_RATE / 2)
    widths = edges[2:] - edges[:-2]
    return float(widths @ power.mean(axis=1) / widths.sum())


def window_column(frame: int, fps: float) -> int:
    """Return the column of the spectrogram nearest to a frame's time, frame / fps x 16000 / 512.

    Args:
        frame: number of the frame, from 0.
        fps: frames per second.
    """
    return round(frame * SAMPLE_RATE / (fps * HOP_LENGTH))


def window_columns(num_frames: int, fps: float) -> int:
    """Return the number of whole columns of the spectrogram in a window: 70 for 34 frames at 15 fps."""
    return int(num_frames * SAMPLE_RATE / (fps * HOP_LENGTH))


def window_samples(num_frames: int, fps: float) -> int:
    """Return the number of samples at 16 kHz in a window, rounded: 36,267 for 34 frames at 15 fps."""
    return round(num_frames * SAMPLE_RATE / fps)


def mel_window(mel: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the spectrogram of the window that starts at a frame.

    Args:
        mel: (128, columns) of a whole clip, in dB.
        start_frame: first frame of the window, from 0.
        num_frames: length of the window in frames.
        fps: frames per second.

    Returns:
        (128, `window_columns`); past the end of the clip there is silence (-80 dB).
    """
    start, columns = window_column(start_frame, fps), window_columns(num_frames, fps)
    window = mel[:, start : start + columns]
    missing = columns - window.shape[1]
    return np.pad(window, ((0, 0), (0, missing)), constant_values=FLOOR_DB) if missing else window


def wave_window(audio: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the samples of the window that starts at a frame.

    Args:
        audio: (samples,) of a whole clip at 16 kHz.
        start_frame: first frame of the window, from 0.
        num_frames: length of the window in frames.
        fps: frames per second.

    Returns:
        (`window_samples`,); past the end of the clip there is silence.
    """
    start, samples = round(start_frame * SAMPLE_RATE / fps), window_samples(num_frames, fps)
    window = audio[start : start + samples]
    return np.pad(window, (0, samples - len(window)))

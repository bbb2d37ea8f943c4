"""Speech: reader of audio files as mono 16 kHz samples, and the log-mel spectrogram of the models (SPEC: inputs).

The spectrogram is librosa's: FFT 1024, hop 512, Hann window, centred frames with reflected borders, 128 mel bands of
Slaney's scale and area normalisation over 0-8 kHz, power to dB. D11: 0 dB is the maximum of the clip, the floor lies
80 dB below it; the spectrogram is computed once per clip and sliced at the nearest column.
"""

import functools
import logging
import pathlib

import av
import numpy as np
import soundfile
from av.error import FFmpegError

from ha2g_jax.errors import UserError
from ha2g_jax.features.librosa_once import librosa

SAMPLE_RATE = 16000
FFT_SIZE = 1024
HOP_LENGTH = 512
NUM_MELS = 128
FLOOR_DB = -80.0
MIN_SECONDS = 0.2
MAX_SECONDS = 3900.0  # an hour and five minutes

# A clip whose loudest mel power is lower is silence: 70 dB below the noise of 16-bit rounding.
_SILENCE_POWER = 1e-15
_MIN_SOURCE_RATE = 1000
_BLOCK = 1 << 20

_logger = logging.getLogger(__name__)


def read_audio(path: str | pathlib.Path) -> np.ndarray:
    """Read the audio of any file that libsndfile or PyAV (FFmpeg) reads, including videos.

    Channels are averaged; samples that are NaN or infinite become 0, with a warning in the log; audio with a peak above
    1 is scaled to a peak of 1.

    Args:
        path: path of the file.

    Returns:
        (samples,) float32, mono, 16 kHz; duration x 16000 samples, rounded.

    Raises:
        UserError: the file does not exist, has no audio, only NaN, or is not between 0.2 s and 65 minutes long.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise UserError(f"{'a folder' if path.is_dir() else 'no file'} at {path}; give the path of an audio file")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is an empty file; expected a recording of speech")
    try:
        samples, rate = _read_with_soundfile(path)
    except (
        soundfile.SoundFileError,
        TypeError,
        OSError,
    ):  # TypeError: a suffix of headerless audio, such as .raw
        samples, rate = _read_with_av(path)
    if rate < _MIN_SOURCE_RATE:
        raise UserError(f"{path} declares {rate} samples per second; expected at least {_MIN_SOURCE_RATE}")
    samples = check_samples(samples, rate, str(path))
    if rate != SAMPLE_RATE:
        num_samples = round(len(samples) * SAMPLE_RATE / rate)
        samples = librosa().resample(samples, orig_sr=rate, target_sr=SAMPLE_RATE, res_type="soxr_hq")
        samples = librosa().util.fix_length(samples, size=num_samples)
    return samples / np.maximum(1, np.max(np.abs(samples)))


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
    seconds = len(samples) / rate
    if seconds < MIN_SECONDS:
        raise UserError(f"{name} has {seconds:.3f} s of sound; expected at least {MIN_SECONDS} s of speech")
    if seconds > MAX_SECONDS:
        raise UserError(
            f"{name} has more than {MAX_SECONDS / 60:.0f} minutes of sound; cut it into parts of at most an hour"
        )
    is_finite = np.isfinite(samples)
    bad = len(samples) - np.count_nonzero(is_finite)
    if bad == len(samples):
        raise UserError(f"{name} has only NaN or infinite samples; export the recording again")
    if bad:
        _logger.warning("%s: %d of %d samples are NaN or infinite; taken as silence", name, bad, len(samples))
        samples = np.where(is_finite, samples, np.float32(0))
    return samples


def _read_with_soundfile(path: pathlib.Path) -> tuple[np.ndarray, int]:
    # Opened here, because libsndfile uses the name of a file before its contents and prints warnings to stderr.
    with path.open("rb") as raw, soundfile.SoundFile(raw) as file:
        blocks, num_samples = [], 0
        while len(block := file.read(_BLOCK, dtype="float32", always_2d=True)):
            blocks.append(block.mean(axis=1))
            num_samples += len(block)
            if num_samples > MAX_SECONDS * file.samplerate:
                break
        return np.concatenate([np.zeros(0, np.float32), *blocks]), file.samplerate


def _read_with_av(path: pathlib.Path) -> tuple[np.ndarray, int]:
    try:
        with av.open(str(path)) as container:
            if not container.streams.audio:
                raise UserError(f"{path} has no sound; expected a recording of speech, or a video with sound")
            stream = container.streams.audio[0]
            rate = stream.codec_context.sample_rate
            to_float = av.AudioResampler(format="fltp")
            blocks, num_samples = [], 0
            for frame in container.decode(stream):
                for part in to_float.resample(frame):
                    blocks.append(part.to_ndarray().mean(axis=0))
                    num_samples += part.samples
                if num_samples > MAX_SECONDS * rate:
                    break
    except (FFmpegError, OSError, ValueError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise UserError(f"{path} holds no sound that can be read ({reason}); expected a recording of speech") from error
    return np.concatenate([np.zeros(0, np.float32), *blocks]), rate


@functools.cache
def _mel_filters() -> np.ndarray:
    return librosa().filters.mel(sr=SAMPLE_RATE, n_fft=FFT_SIZE, n_mels=NUM_MELS)


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
    padded = np.pad(np.asarray(audio, np.float32), FFT_SIZE // 2, mode="reflect")
    spectrum = librosa().stft(padded, n_fft=FFT_SIZE, hop_length=HOP_LENGTH, center=False)
    power = _mel_filters() @ np.square(np.abs(spectrum))
    if reference is None:
        reference = float(np.max(power))
    if reference < _SILENCE_POWER:
        return np.full(power.shape, FLOOR_DB, np.float32)
    ratio = np.clip(power / np.float32(reference), 10 ** (FLOOR_DB / 10), 1)
    return np.clip(10 * np.log10(ratio), FLOOR_DB, 0, dtype=np.float32)


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

"""The spectrogram for speech recognition is Whisper's, of the whole clip, and silence lies past its end."""

import librosa
import numpy as np
import pytest

from ha2g_jax.features.asr_mel import asr_columns, asr_log_mel, asr_window


def speech_like(seconds: float, seed: int = 0) -> np.ndarray:
    """Noise whose loudness rises and falls four times a second."""
    time = np.arange(round(16000 * seconds)) / 16000
    noise = np.random.default_rng(seed).normal(0, 0.1, len(time))
    return (noise * (1 + np.sin(8 * np.pi * time))).astype(np.float32)


@pytest.mark.parametrize("num_mels", [80, 128])
def test_equals_its_definition(num_mels):
    audio = speech_like(0.5).astype(np.float64)
    filters = librosa.filters.mel(sr=16000, n_fft=400, n_mels=num_mels)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(400) / 400)
    padded = np.concatenate([audio[200:0:-1], audio, audio[-2:-202:-1]])
    columns = [np.fft.rfft(window * padded[160 * column : 160 * column + 400]) for column in range(51)]
    decades = np.log10(np.maximum(filters @ np.abs(np.array(columns).T) ** 2, 1e-10))
    expected = (np.maximum(decades, decades.max() - 8) + 4) / 4
    mel = asr_log_mel(audio.astype(np.float32), num_mels)
    assert mel.shape == (num_mels, 51) and mel.dtype == np.float32
    np.testing.assert_allclose(mel, expected, atol=1e-4)


def test_equals_faster_whisper():
    extractor = pytest.importorskip("faster_whisper.feature_extractor").FeatureExtractor()
    audio = np.append(speech_like(2), np.zeros(1600, np.float32))
    theirs = extractor(audio, padding=0)
    np.testing.assert_allclose(asr_log_mel(audio)[:, :-1], theirs, atol=1e-4)


def test_windows_of_a_clip_share_its_floor():
    """A window that is all quiet keeps the floor of the loud part of its clip."""
    audio = np.concatenate([speech_like(3), 1e-6 * speech_like(3)])
    mel = asr_log_mel(audio)
    quiet = asr_window(mel, 50, 34, 15)
    assert quiet.shape == (80, asr_columns(34, 15))
    np.testing.assert_allclose(quiet, mel.max() - 2, atol=1e-6)
    assert asr_window(mel, 0, 34, 15).max() == mel.max()


@pytest.mark.parametrize(("frame", "fps", "column"), [(0, 15, 0), (1, 15, 7), (30, 15, 200), (7, 30, 23)])
def test_a_window_starts_at_the_nearest_column(frame, fps, column):
    mel = np.broadcast_to(np.arange(500, dtype=np.float32), (80, 500))
    np.testing.assert_array_equal(asr_window(mel, frame, 34, fps)[3], np.arange(column, column + asr_columns(34, fps)))


@pytest.mark.parametrize("gain", [1, 1e-5, 0])
def test_past_the_end_is_what_silence_is_within_the_clip(gain):
    audio = np.float32(gain) * speech_like(2)
    short = asr_log_mel(audio)
    long = asr_log_mel(np.append(audio, np.zeros(48000, np.float32)))
    last = 201 - round(15 * 100 / 15)  # column of the window after which the clip has ended
    ended, going_on = (asr_window(mel, 15, 34, 15) for mel in (short, long))
    np.testing.assert_allclose(ended[:, last + 2 :], going_on[:, last + 2 :], atol=1e-5)
    np.testing.assert_array_equal(ended[:, :last], short[:, 100:])
    assert np.ptp(asr_window(short, 900, 34, 15)) == 0


def test_half_precision_is_enough():
    tone = np.sin(2 * np.pi * 440 * np.arange(32000) / 16000).astype(np.float32)
    mel = asr_log_mel(np.append(tone, np.zeros(16000, np.float32)))
    stored = mel.astype(np.float16)
    assert -1.5 < mel.min() < mel.max() < 2
    assert np.abs(stored.astype(np.float32) - mel).max() < 5e-4  # 0.02 dB
    assert asr_window(stored, 20, 34, 15).dtype == np.float16
    np.testing.assert_allclose(asr_window(stored, 20, 34, 15), asr_window(mel, 20, 34, 15), atol=1e-3)


@pytest.mark.parametrize("num_samples", [1, 159, 160])
def test_the_shortest_clips(num_samples):
    silence = asr_log_mel(np.zeros(num_samples, np.float32))
    assert silence.shape == (80, 1 + num_samples // 160)
    np.testing.assert_allclose(silence, -1.5, atol=1e-6)
    assert np.isfinite(asr_log_mel(np.ones(num_samples, np.float32))).all()

"""Spectrograms are those of librosa and of Whisper, in pieces too, and windows are cut at the nearest column."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ha2g_jax.data.speech import prepare
from ha2g_jax.features.audio import SAMPLE_RATE, high_pass
from ha2g_jax.features.spectrum import (
    FFT_SIZE,
    FLOOR_DB,
    LEAST_POWER,
    TYPICAL_POWER,
    RunningMel,
    asr_columns,
    asr_log_mel,
    asr_window,
    log_mel,
    mel_filters,
    mel_frequencies,
    mel_power,
    mel_spectrum,
    mel_window,
    power_spectrum,
    window_column,
)
from ha2g_jax.metrics.beats.times import librosa


def noise(num_samples: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.1, num_samples).astype(np.float32)


@pytest.mark.parametrize(("fft_size", "hop_length"), [(1024, 512), (400, 160)])
@pytest.mark.parametrize("samples", [1024, 1025, 400_000])
def test_the_spectrum_is_librosas(fft_size, hop_length, samples):
    sound = np.random.default_rng(0).normal(0, 0.1, samples).astype(np.float32)
    expected = librosa("core.spectrum").stft(sound, n_fft=fft_size, hop_length=hop_length, center=False)
    found = power_spectrum(sound, fft_size, hop_length)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.square(np.abs(expected)))


@pytest.mark.parametrize(("fft_size", "num_mels"), [(1024, 128), (400, 80), (400, 128)])
def test_the_filters_are_librosas(fft_size, num_mels):
    found = mel_filters(fft_size, num_mels)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, librosa("filters").mel(sr=16000, n_fft=fft_size, n_mels=num_mels))
    expected = librosa("core.convert").mel_frequencies(num_mels, fmin=0, fmax=8000)
    np.testing.assert_allclose(mel_frequencies(num_mels), expected, rtol=1e-14)


@pytest.mark.parametrize(("fft_size", "num_mels"), [(1024, 128), (400, 80), (400, 128)])
def test_every_band_and_column_has_all_of_its_frequencies(fft_size, num_mels):
    power = np.random.default_rng(0).exponential(size=(1 + fft_size // 2, 600)).astype(np.float32)
    expected = mel_filters(fft_size, num_mels).astype(np.float64) @ power
    np.testing.assert_allclose(mel_spectrum(power, num_mels), expected, rtol=1e-5)


def test_mel_is_librosas_between_silent_borders():
    """Slow sines are subtracted from the windowed samples first, here by least squares."""
    samples = noise(36267)
    frames = np.stack([samples[start : start + 1024] for start in range(0, len(samples) - 1023, 512)], axis=1)
    phases = 2 * np.pi * np.arange(1024)[:, None] / 1024 * np.array([0, 0.5, 1, 1.5, 2, 2.5])
    window = np.hanning(1025)[:-1, None]
    sines = np.concatenate([np.cos(phases), np.sin(phases)], axis=1)
    frames = frames - sines @ np.linalg.lstsq(window * sines, window * frames)[0]
    spectrum = np.abs(np.fft.rfft(window * frames, axis=0)) ** 2
    spectrum[:6] = 0  # below 80 Hz
    power = librosa("feature.spectral").melspectrogram(S=spectrum, sr=16000, n_mels=128)
    expected = librosa("core.spectrum").power_to_db(power, ref=np.max, top_db=80)
    mel = log_mel(samples)
    assert mel.shape == (128, 71)
    assert mel.dtype == np.float32
    np.testing.assert_allclose(mel[:, 1:-1], expected, atol=1e-3)
    assert (mel[:, [0, -1]] == -80).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(-120, 0))
def test_a_quiet_clip_is_as_loud_as_a_loud_one_and_a_faint_one_sinks_until_it_is_silence(gain_db):
    """What speech with a peak below -44 dBFS, or noise below -42 dBFS, lacks is what the spectrogram lacks."""
    samples = noise(16000)
    highest_db = min(10 * np.log10(mel_power(samples).max() / LEAST_POWER) + gain_db, 0)
    assume(abs(highest_db + 30) > 0.01)
    expected = np.maximum(log_mel(samples) + highest_db, -80) if highest_db > -30 else np.full((128, 32), -80)
    np.testing.assert_allclose(log_mel(np.float32(10 ** (gain_db / 20)) * samples), expected, atol=1e-2)
    assert (log_mel(np.zeros(16000, np.float32)) == -80).all()


def test_speech_of_any_ordinary_level_has_0_db_and_faint_noise_does_not():
    for peak in (0.01, 0.1, 1):
        assert log_mel(_speech(2, peak)).max() == 0
    for level_db, loudest in ((-60, -15), (-75, -79), (-90, -79)):
        noise = np.random.default_rng(1).normal(0, 10 ** (level_db / 20), 160000).astype(np.float32)
        assert log_mel(noise).max() < loudest


def test_a_given_reference_is_the_zero_of_the_scale():
    half = log_mel(noise(16000), reference=1e3)[3:, 1:-1]  # without silence: columns, and bands below 80 Hz
    expected = np.minimum(half + 10, 0)
    np.testing.assert_allclose(log_mel(noise(16000), reference=1e2)[3:, 1:-1], expected, atol=1e-3)
    assert half.max() <= 0


def test_windows_are_whole_and_silent_past_the_end():
    mel = np.arange(128 * 100, dtype=np.float32).reshape(128, 100) - 13000
    assert [window_column(frame, 15) for frame in (0, 1, 15, 30, 60, 90)] == [0, 2, 31, 62, 125, 188]
    np.testing.assert_array_equal(mel_window(mel, 0, 34, 15), mel[:, :70])
    window = mel_window(mel, 30, 34, 15)
    assert window.shape == (128, 70)
    np.testing.assert_array_equal(window[:, :38], mel[:, 62:])
    assert (window[:, 38:] == -80).all()
    assert (mel_window(mel, 900, 34, 15) == -80).all()


def speech_like(seconds: float, seed: int = 0) -> np.ndarray:
    """Noise whose loudness rises and falls four times a second."""
    time = np.arange(round(16000 * seconds)) / 16000
    noise = np.random.default_rng(seed).normal(0, 0.1, len(time))
    return (noise * (1 + np.sin(8 * np.pi * time))).astype(np.float32)


@pytest.mark.parametrize("num_mels", [80, 128])
def test_whispers_spectrogram_is_its_definition(num_mels):
    audio = speech_like(0.5).astype(np.float64)
    filters = librosa("filters").mel(sr=16000, n_fft=400, n_mels=num_mels)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(400) / 400)
    padded = np.concatenate([audio[200:0:-1], audio, audio[-2:-202:-1]])
    columns = [np.fft.rfft(window * padded[160 * column : 160 * column + 400]) for column in range(51)]
    decades = np.log10(np.maximum(filters @ np.abs(np.array(columns).T) ** 2, 1e-10))
    expected = (np.maximum(decades, decades.max() - 8) + 4) / 4
    mel = asr_log_mel(audio.astype(np.float32), num_mels)
    assert mel.shape == (num_mels, 51) and mel.dtype == np.float32
    np.testing.assert_allclose(mel, expected, atol=1e-4)


def test_whispers_spectrogram_is_that_of_faster_whisper():
    extractor = pytest.importorskip("faster_whisper.feature_extractor").FeatureExtractor()
    audio = np.append(speech_like(2), np.zeros(1600, np.float32))
    theirs = extractor(audio, padding=0)
    np.testing.assert_allclose(asr_log_mel(audio)[:, :-1], theirs, atol=1e-4)


def test_whispers_windows_of_a_clip_share_its_floor():
    """A window that is all quiet keeps the floor of the loud part of its clip."""
    audio = np.concatenate([speech_like(3), 1e-6 * speech_like(3)])
    mel = asr_log_mel(audio)
    quiet = asr_window(mel, 50, 34, 15)
    assert quiet.shape == (80, asr_columns(34, 15))
    np.testing.assert_allclose(quiet, mel.max() - 2, atol=1e-6)
    assert asr_window(mel, 0, 34, 15).max() == mel.max()


@pytest.mark.parametrize(("frame", "fps", "column"), [(0, 15, 0), (1, 15, 7), (30, 15, 200), (7, 30, 23)])
def test_whispers_window_starts_at_the_nearest_column(frame, fps, column):
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
def test_whispers_spectrogram_of_the_shortest_clips(num_samples):
    silence = asr_log_mel(np.zeros(num_samples, np.float32))
    assert silence.shape == (80, 1 + num_samples // 160)
    np.testing.assert_allclose(silence, -1.5, atol=1e-6)
    assert np.isfinite(asr_log_mel(np.ones(num_samples, np.float32))).all()


def _speech(seconds: float, peak: float = 0.2) -> np.ndarray:
    """A voice of 120 Hz with the rhythm of syllables and a pause in the middle, and faint noise."""
    time = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    voice = sum(np.sin(2 * np.pi * 120 * k * time + k**2) / k for k in range(1, 20)) * np.sin(4 * np.pi * time) ** 2
    voice[int(len(voice) * 0.4) : int(len(voice) * 0.6)] = 0
    noise = np.random.default_rng(0).normal(0, 1e-4, len(time))
    return (voice / np.abs(voice).max() * peak + noise).astype(np.float32)


def _loudest(samples: np.ndarray) -> float:
    return float(mel_power(samples).max()) if len(samples) >= FFT_SIZE else 1.0


@pytest.mark.parametrize("count", [1, 2, 511, 512, 513, 600, 1023, 1024, 1025, 1536, 5000, 5120, 5121])
def test_columns_are_those_of_the_clip(count):
    """However it is cut, the silent columns at both ends included."""
    samples = _speech(1)[:count]
    expected = prepare(samples, (), ("mel",)).tracks["mel"].astype(np.float32)
    for cut in (1, 100, 5121):
        running = RunningMel(40, _loudest(samples))
        for start in range(0, count, cut):
            running.add(samples[start : start + cut])
        found = running.window(-3, expected.shape[1] + 8)
        np.testing.assert_allclose(found[:, 3:-5], expected, atol=0.07)  # one step of half precision
        assert (found[:, :3] == FLOOR_DB).all() and (found[:, -5:] == FLOOR_DB).all()


def test_the_last_columns_are_kept():
    samples = _speech(3)
    running = RunningMel(20, _loudest(samples))
    running.add(samples)
    expected = prepare(samples, (), ("mel",)).tracks["mel"].astype(np.float32)[:, 75:93]
    np.testing.assert_allclose(running.window(75, 18), expected, atol=0.07)


def _level(running: RunningMel, samples: np.ndarray) -> float:
    """Return the loudest value in dB that a window has after these samples."""
    running.add(samples)
    last = running._num_columns
    return float(running.window(last - 60, 60).max())


def test_a_quiet_beginning_stays_quiet():
    noise = np.random.default_rng(1).normal(0, 5e-4, 3 * SAMPLE_RATE).astype(np.float32)
    assert _level(RunningMel(70), noise) < -40


def test_speech_of_a_usual_level_has_about_its_own_maximum():
    for peak in (0.1, 0.2, 0.7):
        assert -8 < _level(RunningMel(70), _speech(4, peak)) <= 0


def test_louder_speech_is_0_db_at_once_and_is_slowly_forgotten():
    running = RunningMel(70)
    running.add(_speech(4, 1.0))
    levels = [_level(running, _speech(20, 0.2)) for _ in range(5)]
    assert -16 < levels[0] < -8  # 14 dB less, 2 to 3 dB of which are forgotten
    assert levels == sorted(levels) and levels[-1] > levels[0] + 5


def test_a_pause_forgets_nothing():
    running, after = RunningMel(70), RunningMel(70)
    for one in (running, after):
        one.add(_speech(4))
    after.add(np.random.default_rng(1).normal(0, 1e-4, 60 * SAMPLE_RATE).astype(np.float32))
    assert abs(_level(running, _speech(2)) - _level(after, _speech(2))) < 0.1


def test_a_voice_that_stays_quiet_is_heard_in_the_end_and_noise_never():
    running = RunningMel(70)
    start = _level(running, _speech(4, 0.02))
    assert start < -15
    for _ in range(6):
        running.add(_speech(20, 0.02))
    assert _level(running, _speech(4, 0.02)) > start + 10
    noise = np.random.default_rng(1).normal(0, 3e-4, 120 * SAMPLE_RATE).astype(np.float32)
    assert _level(running, noise) < -25


def test_a_fixed_level_stays():
    running = RunningMel(70, TYPICAL_POWER)
    running.add(_speech(4, 1.0))
    assert _level(running, _speech(4, 1.0)) == 0
    assert _level(running, _speech(4, 0.02)) == _level(RunningMel(70, TYPICAL_POWER), _speech(4, 0.02))


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(1, 30), st.floats(0, 6))
def test_what_nobody_hears_changes_no_feature(constant, frequency, phase):
    """Whatever the phase in which a slow sine begins, and in the pauses of the speech too."""
    speech = _speech(1)
    rumble = constant + 0.01 * np.sin(2 * np.pi * frequency * np.arange(16000) / 16000 + phase)
    np.testing.assert_allclose(log_mel(speech + rumble.astype(np.float32)), log_mel(speech), atol=0.5)
    # The ends of a sine are steps, which are heard.
    steady = slice(4000, 12000)
    np.testing.assert_allclose(high_pass(speech + rumble)[steady], high_pass(speech)[steady], atol=1e-3)

"""The spectrogram of speech that arrives in pieces is that of the whole, and 0 dB follows its level without harm."""

import numpy as np
import pytest

from ha2g_jax.data.speech import prepare
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.running_mel import TYPICAL_POWER, RunningMel
from ha2g_jax.features.spectrum import FFT_SIZE, FLOOR_DB, mel_power


def _speech(seconds: float, peak: float = 0.2) -> np.ndarray:
    """A voice of 120 Hz with the rhythm of syllables and a pause in the middle, and faint noise."""
    time = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    voice = sum(np.sin(2 * np.pi * 120 * k * time + k**2) / k for k in range(1, 20)) * np.sin(4 * np.pi * time) ** 2
    voice[int(len(voice) * 0.4) : int(len(voice) * 0.6)] = 0
    noise = np.random.default_rng(0).normal(0, 1e-4, len(time))
    return (voice / np.abs(voice).max() * peak + noise).astype(np.float32)


def _loudest(samples: np.ndarray) -> float:
    return float(mel_power(np.pad(samples, FFT_SIZE // 2, mode="reflect")).max())


@pytest.mark.parametrize("count", [1, 2, 511, 512, 513, 600, 1023, 1024, 1025, 1536, 5000, 5120, 5121])
def test_columns_are_those_of_the_clip(count):
    """However it is cut, the reflected columns at both ends included."""
    samples = _speech(1)[:count]
    expected = prepare(samples, (), ("mel",)).tracks["mel"].astype(np.float32)
    for cut in (1, 100, 5121):
        running = RunningMel(40, _loudest(samples))
        for start in range(0, count, cut):
            running.add(samples[start : start + cut])
        running.end()
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
    noise = np.random.default_rng(1).normal(0, 3e-4, 600 * SAMPLE_RATE).astype(np.float32)
    assert _level(running, noise) < -25


def test_a_fixed_level_stays():
    running = RunningMel(70, TYPICAL_POWER)
    running.add(_speech(4, 1.0))
    assert _level(running, _speech(4, 1.0)) == 0
    assert _level(running, _speech(4, 0.02)) == _level(RunningMel(70, TYPICAL_POWER), _speech(4, 0.02))

"""Noise and music of Talk: of one level, different each time, and not speech to its teacher's ear for beats."""

import numpy as np
import pytest

from ha2g_jax.data.talk import backgrounds

SECONDS = 12


@pytest.mark.parametrize("draw", [backgrounds.draw_noise, backgrounds.draw_music])
def test_same_seed_same_sound(draw):
    sounds = [draw(SECONDS * 16000, np.random.default_rng(seed)) for seed in (0, 0, 1, 2, 3, 4, 5)]
    np.testing.assert_array_equal(sounds[0], sounds[1])
    for sound in sounds:
        assert sound.shape == (SECONDS * 16000,) and np.isfinite(sound).all()
        assert np.mean(sound**2) == pytest.approx(1)
    assert np.abs(np.corrcoef(sounds[1:]) - np.eye(6)).max() < 0.5


@pytest.mark.parametrize("exponent", [0, 1, 2])
def test_colour(exponent):
    noise = backgrounds.coloured_noise(2**18, exponent, np.random.default_rng(0))
    power, hertz = np.abs(np.fft.rfft(noise)) ** 2, np.fft.rfftfreq(2**18, 1 / 16000)
    low, high = (power[(hertz > edge) & (hertz < 2 * edge)].mean() for edge in (200, 1600))
    assert np.log2(low / high) == pytest.approx(3 * exponent, abs=0.1)


def test_a_tone_of_music_has_its_frequency():
    instrument = backgrounds._Instrument(np.array([1.0, 0.5, 0.2]), 0.01, 5.0, 0.0)
    spectrum = np.abs(np.fft.rfft(backgrounds._play(instrument, 440.0, 1.0)[:16000]))
    assert set(np.argsort(spectrum)[-2:]) >= {440} and spectrum[880] > 0.4 * spectrum[440]

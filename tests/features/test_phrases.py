"""Ends of phrases are found once, early, at any level and in noise, however the sound is cut."""

import numpy as np
import pytest

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.phrases import Phrases

SECOND = SAMPLE_RATE


def voice(seconds: float, seed: int = 0) -> np.ndarray:
    """Noise with the rhythm of syllables, four of them a second."""
    time = np.arange(round(seconds * SECOND)) / SECOND
    return np.random.default_rng(seed).normal(0, 0.1, len(time)) * np.abs(np.sin(4 * np.pi * time))


def heard(sound: np.ndarray, cut: int = 1600, **options) -> tuple[list[float], list[float], Phrases]:
    """All ends, and when each was known, in seconds."""
    phrases, known = Phrases(8.0, **options), {}
    for start in range(0, len(sound), cut):
        phrases.add(sound[start : start + cut].astype(np.float32))
        for end in phrases.ends:
            known.setdefault(end, min(start + cut, len(sound)) / SECOND)
    return list(known), list(known.values()), phrases


SILENCE = np.zeros(SECOND)
# Two phrases that count, a short one, and a pause that is none.
TALK = np.concatenate([SILENCE, voice(2), 0 * voice(0.5), voice(0.5), SILENCE, voice(1), 0 * voice(0.15), voice(1.5)])
TALK = np.concatenate([TALK, SILENCE])
ENDS = [3.0, 7.65]


@pytest.mark.parametrize("gain", [0.02, 1, 5])
@pytest.mark.parametrize("noise", [0, 1e-4, 3e-3])
def test_an_end_is_known_a_pause_later_at_any_level_and_in_noise(gain, noise):
    steady = np.random.default_rng(1).normal(0, noise * gain, len(TALK))
    ends, known, phrases = heard(np.clip(gain * TALK + steady, -1, 1))
    np.testing.assert_allclose(ends, ENDS, atol=0.1)
    assert (np.array(known) - ends).max() < 0.3 + 0.21  # two columns, and the 0.1 s that are added at a time
    assert phrases.has_voice(5, 6) and not phrases.has_voice(4.1, 4.9)


def test_the_result_does_not_depend_on_the_cuts_nor_on_how_silence_is_given():
    assert heard(TALK, 999)[0] == heard(TALK, len(TALK))[0]
    late = Phrases(8.0, 777)
    late.add(TALK.astype(np.float32))
    early = Phrases(8.0)
    early.add(np.concatenate([np.zeros(777), TALK]).astype(np.float32))
    assert late.ends == early.ends and len(late.ends) == 2


@pytest.mark.parametrize("level", [1e-3, 0.05])
def test_steady_noise_that_sets_in_has_no_phrases(level):
    noise = np.random.default_rng(2).normal(0, level, 10 * SECOND)
    ends, _, phrases = heard(np.concatenate([SILENCE, noise]))
    assert ends == [] and not phrases.has_voice(5, 10)

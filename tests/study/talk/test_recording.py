"""The gain over mismatched sound is what deliberate motion has and chance has not."""

import numpy as np
import pytest
import soundfile

from ha2g_jax import synthesis
from ha2g_jax.errors import UserError
from ha2g_jax.study.talk.recording import alignment_gain, evaluate_recording

CLICKS = np.cumsum(np.random.default_rng(3).uniform(0.45, 1.1, 70))
SECONDS = 50


@pytest.fixture(scope="module")
def audio() -> np.ndarray:
    samples = np.random.default_rng(0).normal(0, 1e-4, SECONDS * 16000)
    for time in CLICKS[CLICKS < SECONDS - 1]:
        samples[round(time * 16000) :][:800] += np.hanning(800)
    return samples.astype(np.float32)


def wrists_that_hit(hits: np.ndarray) -> np.ndarray:
    """Falls of 10 cm in the 0.2 s before each hit, slowly undone."""
    time = np.arange(SECONDS * 15) / 15
    keys = np.array([(-1.0, 0.0), *((t, y) for hit in hits for t, y in ((hit - 0.2, 0.0), (hit, 0.1)))])
    wrists = np.zeros((len(time), 2, 3))
    wrists[:, 0, 1] = np.interp(time, keys[:, 0], keys[:, 1])
    return wrists


def test_strikes_at_the_onsets_gain(audio):
    scores = alignment_gain(audio, wrists_that_hit(CLICKS[:-4:2]), 15)
    assert scores["alignment"]["value"] > 0.5
    assert scores["gain"]["value"] > 5 * scores["gain"]["error"] > 0
    assert scores["beats_per_second"] == pytest.approx(0.64, abs=0.15)


def test_jitter_gains_nothing_and_stillness_has_no_beat(audio):
    jitter = np.random.default_rng(1).normal(0, 0.05, (SECONDS * 15, 2, 3))
    scores = alignment_gain(audio, jitter, 15)
    assert scores["alignment"]["value"] > 0.3
    assert abs(scores["gain"]["value"]) < 3 * scores["gain"]["error"]
    still = alignment_gain(audio, np.zeros((SECONDS * 15, 2, 3)), 15)
    assert still["alignment"]["value"] == still["gain"]["value"] == still["beats_per_second"] == 0


def test_silence_and_short_sound_are_undefined_not_wrong(audio):
    silent = alignment_gain(np.zeros(20 * 16000, np.float32), wrists_that_hit(CLICKS[:-4]), 15)
    assert silent["alignment"]["value"] is silent["gain"]["value"] is None
    assert silent["beats_per_second"] > 0
    short = alignment_gain(audio[: 5 * 16000], wrists_that_hit(CLICKS[:-4]), 15)
    assert short["alignment"]["value"] > 0 and short["gain"]["value"] is None


def test_a_file_is_heard_and_moved_to(audio, debug_model, tmp_path, monkeypatch):
    monkeypatch.setattr(synthesis, "load", lambda checkpoint: debug_model)
    soundfile.write(tmp_path / "speech.wav", audio[: 20 * 16000], 16000)
    scores = evaluate_recording("any", tmp_path / "speech.wav", speaker="ada")
    assert scores["speech"] == "speech.wav" and scores["gain"]["value"] is not None
    soundfile.write(tmp_path / "short.wav", audio[: 3 * 16000], 16000)
    with pytest.raises(UserError, match=r"3\.0 s of sound; expected at least 10 s"):
        evaluate_recording("any", tmp_path / "short.wav")

"""A recording is scored without true motion, and the results say what of the scored motion was given."""

import numpy as np
import pytest
import soundfile

from ha2g_jax import synthesis
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import scoring
from ha2g_jax.evaluation.evaluate import measure, score_as_json
from ha2g_jax.evaluation.scoring import evaluate_recording
from ha2g_jax.evaluation.table import as_markdown, as_table
from ha2g_jax.metrics.beats import strokes
from ha2g_jax.metrics.hands import UpperBody
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import normalize

CLICKS = np.cumsum(np.random.default_rng(3).uniform(0.45, 1.1, 70))
SECONDS = 50


def score(audio: np.ndarray, wrists: np.ndarray) -> dict:
    still = np.ones((len(wrists), 3))
    row = strokes.recording_row(audio, UpperBody(wrists, wrists, still, still, 15), 4)
    return {name.removeprefix("recording_"): score_as_json(found) for name, found in measure(row, "recording").items()}


def clicking(times: np.ndarray) -> np.ndarray:
    samples = np.random.default_rng(0).normal(0, 1e-4, SECONDS * 16000)
    for time in times[times < SECONDS - 1]:
        samples[round(time * 16000) :][:800] += np.hanning(800)
    return samples.astype(np.float32)


@pytest.fixture(scope="module")
def audio() -> np.ndarray:
    return clicking(CLICKS)


def wrists_that_hit(hits: np.ndarray) -> np.ndarray:
    """Falls of 10 cm in the 0.2 s before each hit, slowly undone."""
    time = np.arange(SECONDS * 15) / 15
    keys = np.array([(-1.0, 0.0), *((t, y) for hit in hits for t, y in ((hit - 0.2, 0.0), (hit, 0.1)))])
    wrists = np.zeros((len(time), 2, 3))
    wrists[:, 0, 1] = np.interp(time, keys[:, 0], keys[:, 1])
    return wrists


def test_strikes_at_the_onsets_gain(audio):
    scores = score(audio, wrists_that_hit(CLICKS[:-4:2]))
    assert scores["f"]["value"] > 0.5
    assert scores["gain"]["value"] > 5 * scores["gain"]["error"] > 0
    assert scores["strokes_per_second"]["value"] == pytest.approx(0.64, abs=0.15)


def test_jitter_gains_nothing_and_stillness_has_no_beat(audio):
    jitter = np.random.default_rng(1).normal(0, 0.05, (SECONDS * 15, 2, 3))
    scores = score(audio, jitter)
    assert scores["f"]["value"] > 0.3
    assert abs(scores["gain"]["value"]) < 3 * scores["gain"]["error"]
    still = score(audio, np.zeros((SECONDS * 15, 2, 3)))
    assert still["f"]["value"] == still["gain"]["value"] == still["strokes_per_second"]["value"] == 0


def test_motion_that_only_rests_in_the_pauses_gains_nothing_with_the_pauses_cut():
    is_speech = np.isin(np.arange(SECONDS), [*range(6), *range(9, 12), *range(19, 28), *range(33, 39), *range(44, 48)])
    spoken, random = (
        times[times < SECONDS][is_speech[times[times < SECONDS].astype(int)]]
        for times in (CLICKS, np.cumsum(np.random.default_rng(0).uniform(0.6, 1.2, 60)))
    )
    chance, true = (score(clicking(spoken), wrists_that_hit(hits)) for hits in (random, spoken))
    assert chance["gain"]["value"] > 0.05
    assert abs(chance["speech_gain"]["value"]) < 2 * chance["speech_gain"]["error"]
    assert true["speech_gain"]["value"] > 0.3
    assert true["speech_gain"]["value"] == pytest.approx(true["perfect_gain"]["value"], abs=0.1)
    assert chance["perfect_gain"]["value"] > 0.2


def test_strokes_with_perfect_timing_are_the_nearest_onsets_each_once():
    onsets = np.array([0.5, 1.0, 3.0])
    assert strokes.moved_to_onsets(np.array([0.7, 0.8, 1.1, 2.1]), onsets).tolist() == [0.5, 1.0, 3.0]
    assert strokes.moved_to_onsets(np.array([0.1, 9.0]), onsets).tolist() == [0.5, 3.0]
    assert strokes.moved_to_onsets(np.array([0.1, 9.0]), onsets[:1]).tolist() == [0.5]
    assert strokes.moved_to_onsets(np.zeros(0), onsets).tolist() == []
    assert strokes.moved_to_onsets(onsets, np.zeros(0)).tolist() == []


def test_silence_and_short_sound_are_undefined_not_wrong(audio):
    silent = score(np.zeros(20 * 16000, np.float32), wrists_that_hit(CLICKS[:-4]))
    assert silent["f"]["value"] is silent["gain"]["value"] is silent["speech_gain"]["value"] is None
    assert silent["perfect_gain"]["value"] is None
    assert silent["strokes_per_second"]["value"] > 0
    short = score(audio[: 5 * 16000], wrists_that_hit(CLICKS[:-4]))
    assert short["f"]["value"] > 0 and short["gain"]["value"] is None


def test_a_file_has_results_of_the_same_shape(audio, debug_model, tmp_path, monkeypatch):
    monkeypatch.setattr(synthesis, "load", lambda checkpoint: debug_model)
    soundfile.write(tmp_path / "speech.wav", audio[: 20 * 16000], 16000)
    results = evaluate_recording("any", tmp_path / "speech.wav")
    (section,) = results["sections"].values()
    assert list(results["sections"]) == ["speech.wav"] and results["inputs"]["checkpoint"] == "any"
    assert section["recording"]["rows"]["model"]["recording_gain"]["value"] is not None
    for text in (as_table(results), as_markdown(results)):
        assert "F mismatched" in text and "rotated in time" in text and "nearest segment cm" in text
    soundfile.write(tmp_path / "short.wav", audio[: 3 * 16000], 16000)
    with pytest.raises(UserError, match=r"3\.0 s of sound; expected at least 10 s"):
        evaluate_recording("any", tmp_path / "short.wav")


def test_a_motion_of_another_length_than_the_speech_is_noticed(audio, debug_model, tmp_path):
    speech, motion = tmp_path / "speech.wav", tmp_path / "motion.npz"
    soundfile.write(speech, audio[: 24 * 16000], 16000)
    for seconds, warnings in ((24, 0), (20, 1)):
        directions = np.repeat(debug_model.spec.skeleton.mean_directions[None], seconds * 15, axis=0)
        Motion.from_directions(debug_model.spec.skeleton, normalize(directions), 15).save(motion)
        (section,) = evaluate_recording("any", speech, motion=motion)["sections"].values()
        assert len(section["warnings"]) == warnings
    assert "without the last 4.0 s of audio" in section["warnings"][0]
    soundfile.write(speech, audio[: 44 * 16000], 16000)
    with pytest.raises(UserError, match="which do not belong together"):
        evaluate_recording("any", speech, motion=motion)


def test_scored_frames_that_were_given_are_named():
    assert scoring._given(4) == scoring._given(1) == []
    (note,) = scoring._given(7)
    assert "first 7 frames" in note and "knew those of the first 3 scored frames" in note

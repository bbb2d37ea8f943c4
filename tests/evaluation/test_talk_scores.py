"""The table of scores on the Talk corpus has its ceiling above its floors, and numbers that JSON can hold."""

import dataclasses
import json

import numpy as np
import pytest

from ha2g_jax import synthesis
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip, Stroke
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import talk_takes
from ha2g_jax.evaluation.clip_result import clip_identity, split_limits, true
from ha2g_jax.evaluation.evaluate import score_as_json
from ha2g_jax.evaluation.talk_scores import (
    CLAIMED,
    CLASSES,
    Observed,
    Trial,
    Truth,
    beat_counts,
    score_known_causes,
    semantic_floors,
    without_speakers,
    word_shapes,
)
from ha2g_jax.metrics.beats import strokes
from ha2g_jax.metrics.causes import CauseRow, gain
from ha2g_jax.metrics.uncertainty import Estimate
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.synthesis import Model

ROWS = ["model", "teacher", "mean pose", "mismatched speech", "teacher, one take", "majority", "shuffled"]
SPLITS = ("train", "test", "test_unseen_speakers")


@pytest.fixture(scope="module", autouse=True)
def few_takes():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(talk_takes, "TEACHER_TAKES", 5)
        patch.setattr(talk_takes, "MODEL_TAKES", 2)
        yield


def score(model, corpus, splits=SPLITS):
    return score_known_causes(model, corpus, split_limits(corpus, splits))


@pytest.fixture(scope="module")
def results(debug_model, tiny_talk):
    return score(debug_model, Corpus.open(tiny_talk))


def test_every_split_has_every_row(results):
    assert list(results) == list(SPLITS)
    for split in results.values():
        if split["counts"]["clips"] > 1:
            assert list(split["rows"]) == ROWS
        assert split["counts"]["words"] > 0
        for row in ("model", "majority"):
            assert 0 <= split["rows"][row]["probe_accuracy"]["value"] <= 1
        for metric in CLAIMED:
            assert len(split["without_speakers"][metric]) == split["counts"]["speakers"]


def test_teacher_is_the_ceiling_and_still_motion_the_floor(results):
    for split in results.values():
        rows = split["rows"]
        assert rows["teacher"]["beat_f1"]["value"] > 0.85
        assert rows["teacher"]["semantic_recall"]["value"] > 0.9
        assert rows["teacher"]["finger_correlation"]["value"] > 0.95
        assert rows["mean pose"]["beat_f1"]["value"] == rows["mean pose"]["strokes_per_second"]["value"] == 0
        assert rows["mean pose"]["style_amplitude"]["value"] is None
        assert rows["model"]["beat_f1"]["value"] < 0.5
        energies = {name: rows[name]["take_energy"]["value"] for name in ("teacher", "teacher, one take", "mean pose")}
        assert abs(energies["teacher"]) < min(energies["teacher, one take"], energies["mean pose"])


def test_scores_are_json_with_bounds_from_standard_errors(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    assert score_as_json(Estimate(0.5, 0.1)) == {"value": 0.5, "low": 0.304, "high": 0.696, "error": 0.1}
    assert score_as_json(Estimate(0.5, np.nan)) == {"value": 0.5, "low": None, "high": None, "error": None}


def test_streams_that_were_generated_before_are_scored(debug_model, tiny_talk, monkeypatch):
    """Here they are the true motion."""
    monkeypatch.setattr(Model, "has_audio_levels", False)
    monkeypatch.setattr(talk_takes, "MAX_CLIPS", 0)
    corpus = Corpus.open(tiny_talk)
    streams = {"test": true(corpus, "test")}
    rows = score_known_causes(debug_model, corpus, {"test": None}, look_ahead=20, streams=streams)["test"]["rows"]
    assert rows["model"]["beat_f1"]["value"] > 0.85 and rows["model"]["semantic_recall"]["value"] > 0.9


def test_a_model_that_reads_words_is_scored_without_them_too(debug_model, tiny_talk, monkeypatch):
    """Here it performs as the corpus does, and rests where it has no transcript."""
    corpus = Corpus.open(tiny_talk)
    clips = {clip.audio.tobytes(): clip for clip in corpus.clips("train")}

    def perform(model, audio, f_id, seed, *, words=(), start=None):
        positions = clips[audio.tobytes()].positions
        true = positions_to_directions(corpus.skeleton, positions)
        return true if words else np.broadcast_to(corpus.skeleton.mean_directions, true.shape)

    monkeypatch.setattr(Model, "reads_words", True)
    monkeypatch.setattr(Model, "has_audio_levels", False)
    monkeypatch.setattr(synthesis, "generate_directions", perform)
    rows = score(debug_model, corpus, ["train"])["train"]["rows"]
    assert list(rows) == [ROWS[0], "model, no words", *ROWS[1:]]
    assert rows["model"]["semantic_recall"]["value"] > 0.9
    assert rows["model, no words"].items() <= rows["mean pose"].items()


def truth_of(name: str, hits: np.ndarray, words: tuple[Stroke, ...] = ()) -> Truth:
    """A clip of 20 s that beats at `hits` and gestures at `words`."""
    clip = Clip(
        id=name,
        speaker=name,
        audio=np.zeros(0, np.float32),
        words=(),
        positions=np.zeros((300, 43, 3), np.float32),
        reference_images=None,
        recording_start=0.0,
        window_starts=(),
        strokes=words,
    )
    return Truth(clip, hits, hits, 300)


def test_random_motion_gains_nothing_over_mismatched_speech():
    """However often it beats: what it hits by chance, the floor hits as well."""
    rng = np.random.default_rng(0)
    truths = [truth_of(str(index), np.sort(rng.uniform(0, 20, 20))) for index in range(60)]
    jitter = [
        Observed(wrists, strokes.stroke_beats(wrists, 15), np.zeros((300, 2, 5)))
        for wrists in rng.normal(0, 0.05, (60, 300, 2, 3))
    ]
    own, mismatched = (
        beat_counts([Trial(*pair) for pair in zip(truths, motions)], 15, 4)
        for motions in (jitter, jitter[1:] + jitter[:1])
    )
    value, error = gain(own, mismatched, np.array([truth.clip.id for truth in truths]))
    assert strokes.recall(own) > 0.3
    assert abs(value) < 3 * error < 0.1
    assert np.isnan(gain(own, mismatched[:0], np.array([truth.clip.id for truth in truths]))).all()


def test_strokes_in_the_given_frames_and_after_the_motion_are_not_scored():
    truth = truth_of("a", np.array([0.1, 1.0, 12.0]))
    seen = Observed(np.zeros((150, 2, 3)), np.array([0.1, 1.05]), np.zeros((150, 2, 5)))
    assert beat_counts([Trial(truth, seen)], 15, 4).tolist() == [[1, 1, 1, 1]]


def test_shapes_are_read_from_the_hand_that_gestures():
    words = tuple(
        Stroke(time, time - 0.5, time + 0.5, "semantic", hand, 1.0, name)
        for time, hand, name in ((2.0, "left", "fist"), (4.0, "right", "fist"), (6.0, "both", "open"))
    )
    flexions = np.zeros((300, 2, 5))
    flexions[:75, 0] = 1
    seen = Observed(np.zeros((300, 2, 3)), np.zeros(0), flexions)
    shapes, _, _ = word_shapes([Trial(truth_of("a", np.zeros(0), words), seen)], 15, 4)
    names = [(CLASSES[shown], CLASSES[true]) for shown, true in shapes]
    assert names == [("fist", "fist"), ("open", "fist"), ("open", "open")]
    majority, shuffled = semantic_floors(CauseRow(shapes=shapes, word_clips=np.array(list("abc"))))
    assert majority["semantic_recall"].value == pytest.approx(2 / 3)
    assert shuffled["semantic_recall"].value == pytest.approx(2 / 9 + 2 / 9)


def test_identity_of_a_clip_is_what_the_model_encodes(debug_model, tiny_talk):
    clip = Corpus.open(tiny_talk).clips("test")[0]
    f_id = clip_identity(debug_model, clip)
    assert f_id.shape == (18,)
    with pytest.raises(UserError, match="no reference images"):
        clip_identity(debug_model, dataclasses.replace(clip, reference_images=None))
    by_name = dataclasses.replace(debug_model, spec=debug_model.spec._replace(identity="speaker"))
    ada, ben = (debug_model.assets.speakers[name] for name in ("ada", "ben"))
    np.testing.assert_array_equal(clip_identity(by_name, dataclasses.replace(clip, speaker="ada")), ada)
    unknown = clip_identity(by_name, dataclasses.replace(clip, speaker="eve"))
    np.testing.assert_allclose(unknown, (ada + ben) / 2, rtol=1e-6)


def test_a_metric_without_a_speaker_is_that_of_the_other_speakers():
    counts = np.array([[10, 8, 12, 9], [10, 2, 9, 3], [10, 5, 10, 6]], float)
    chance = np.repeat(counts, 2, axis=0) * [1, 0.5, 1, 0.5]
    shapes, words = np.array([[0, 0], [1, 1], [0, 1], [2, 2]]), np.array(["a", "a", "b", "c"])
    styles, speakers = np.ones((3, 2)), np.array(["one", "two", "two"])
    flexions, clips = np.zeros((4, 2, 5)), np.array(list("abc"))
    row = CauseRow(counts, chance, np.ones(3), clips, shapes, flexions, words, styles, styles, speakers)
    assert without_speakers(row, "semantic_recall") == {"one": 0.5, "two": 1.0}
    gains = without_speakers(row, "beat_f1_gain")
    assert gains["two"] == gain(counts[:1], chance[:2], np.array(["a"])).value
    assert gains["one"] == gain(counts[1:], chance[2:], np.array(["b", "c"])).value

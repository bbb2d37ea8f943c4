"""A model is scored on the clips of a split, with their own styles, beginnings and sound."""

import numpy as np
import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton, positions_to_directions
from ha2g_jax.study.evaluation import performance
from ha2g_jax.study.evaluation.inputs import evaluate_checkpoint, knows_strokes
from ha2g_jax.study.evaluation.table import as_table


@pytest.fixture(scope="module")
def corpus(tiny_talk):
    return Corpus.open(tiny_talk)


@pytest.fixture(scope="module")
def performances(debug_model, corpus):
    return performance.from_corpus(debug_model, corpus, "test", with_audio=True)


def test_each_clip_is_performed_beside_the_truth(performances, corpus):
    generated, true = performances
    clips = corpus.clips("test")
    assert [clip.id for clip in generated] == [clip.id for clip in true] == [clip.id for clip in clips]
    for mine, truth, clip in zip(generated, true, clips, strict=True):
        assert mine.source == truth.source == clip.recording
        np.testing.assert_allclose(
            truth.directions, positions_to_directions(corpus.skeleton, clip.positions), atol=1e-6
        )
        np.testing.assert_array_equal(truth.audio, clip.audio)
        assert truth.onsets is not None and len(truth.onsets)
        assert abs(mine.num_frames - truth.num_frames) <= 1
        assert mine.borders == tuple(range(30, mine.num_frames - 4, 30))
        assert mine.onsets is None and mine.audio is None


def test_a_sample_is_of_the_same_clips_on_both_sides(debug_model, corpus):
    generated, true = performance.from_corpus(debug_model, corpus, "train", limit=2, seed=1)
    assert len(true) == 2
    assert [clip.id for clip in generated] == [clip.id for clip in true]
    assert true[0].audio is None
    training = performance.training_motion(corpus, "train", limit=2, seed=1)
    for motion, clip in zip(training, true, strict=True):
        np.testing.assert_array_equal(motion, clip.directions)


def test_a_corpus_that_does_not_fit_is_refused(debug_model, corpus, monkeypatch):
    monkeypatch.setattr(Corpus, "skeleton", load_skeleton("ted_gesture"))
    with pytest.raises(UserError, match="give a corpus that fits"):
        performance.generated(debug_model, corpus, "test")
    with pytest.raises(UserError, match="no split 'nowhere'"):
        performance.true(corpus, "nowhere")


def test_a_checkpoint_is_evaluated_with_one_call(debug_model, tiny_talk, tmp_path):
    folder = model_folder.save(tmp_path / "model", debug_model.config, debug_model.assets, debug_model.variables)
    results = evaluate_checkpoint(folder, tiny_talk, limit=4)
    assert results["split"] == "test"
    assert results["methods"] == ["model"]
    assert results["settings"]["usual_motion"] == "training"
    assert results["rows"]["ground truth"]["beats_per_second"]["value"] > 0
    assert "model" in as_table(results)
    assert knows_strokes(tiny_talk)

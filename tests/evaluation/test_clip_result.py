"""A model is scored on the clips of a split, with their own styles, beginnings and sound."""

import numpy as np
import pytest

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import clip_result
from ha2g_jax.evaluation.clip_result import clip_identity
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.synthesis import Style


@pytest.fixture(scope="module")
def corpus(tiny_talk):
    return Corpus.open(tiny_talk)


@pytest.fixture(scope="module")
def results(debug_model, corpus):
    return clip_result.from_corpus(debug_model, corpus, "test", with_audio=True)


def test_each_clip_is_generated_beside_the_truth(results, corpus):
    generated, true = results
    clips = corpus.clips("test")
    assert [clip.id for clip in generated] == [clip.id for clip in true] == [clip.id for clip in clips]
    for mine, truth, clip in zip(generated, true, clips, strict=True):
        assert mine.recording == truth.recording == clip.recording
        np.testing.assert_allclose(
            truth.directions, positions_to_directions(corpus.skeleton, clip.positions), atol=1e-6
        )
        np.testing.assert_array_equal(truth.audio, clip.audio)
        assert truth.onsets is not None and len(truth.onsets)
        assert abs(mine.num_frames - truth.num_frames) <= 1
        assert mine.borders == tuple(range(24, mine.num_frames - 4, 20))
        assert mine.onsets is None and mine.audio is None


def test_a_sample_is_of_the_same_clips_on_both_sides(debug_model, corpus):
    generated, true = clip_result.from_corpus(debug_model, corpus, "train", limit=2, seed=1)
    assert len(true) == 2
    assert [clip.id for clip in generated] == [clip.id for clip in true]
    assert true[0].audio is None
    training = clip_result.training_motion(corpus, limit=2, seed=1)
    for motion, clip in zip(training, true, strict=True):
        np.testing.assert_array_equal(motion, clip.directions)


def test_a_stream_is_scored_by_what_it_returns(debug_model, corpus):
    streamed = clip_result.generated(debug_model, corpus, "test", limit=1, look_ahead=3)
    clip = next(clip for clip in corpus.clips("test") if clip.id == streamed[0].id)
    stream = debug_model.stream(look_ahead=3, style=Style(values=clip_identity(debug_model, clip)))
    expected = np.concatenate([stream.feed(clip.audio), stream.flush()])
    np.testing.assert_array_equal(streamed[0].directions, expected)
    assert streamed[0].borders == ()
    style = clip_identity(debug_model, clip)
    coarse = clip_result.generate_clip(debug_model, clip, style, 0, look_ahead=3, hop=8)
    stream = debug_model.stream(look_ahead=3, hop=8, style=Style(values=style))
    np.testing.assert_array_equal(coarse, np.concatenate([stream.feed(clip.audio), stream.flush()]))


def test_of_the_training_split_as_many_clips_are_scored_as_another_has(corpus):
    most = max(len(corpus.clips(name)) for name in ("val", "test"))
    assert clip_result.split_limits(corpus, ["train", "val", "test"]) == {"train": most, "val": None, "test": None}
    assert clip_result.split_limits(corpus, ["train"]) == {"train": 40}
    with pytest.raises(UserError, match="tset"):
        clip_result.split_limits(corpus, ["val", "tset"])

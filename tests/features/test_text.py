"""Words fall on the frames in which they start; a vocabulary ignores case."""

import numpy as np
import pytest

from ha2g_jax.features.text import UNKNOWN, Vocabulary, Word, words_to_frames

VOCABULARY = Vocabulary.from_counts({"one": 1, "two": 2, "three": 1})


def test_vocabulary_is_most_frequent_first_and_ignores_case():
    assert VOCABULARY.words == ("two", "one", "three")
    assert len(VOCABULARY) == 5
    assert [VOCABULARY.encode(word) for word in ("two", "ONE", "three", "never")] == [2, 3, 4, UNKNOWN]


def test_words_lie_on_the_frame_in_which_they_start():
    words = [Word("one", 1.0, 1.2), Word("two", 1.2, 1.4), Word("never", 2.0, 2.1)]
    frames = words_to_frames(words, VOCABULARY, 1.0, 16, 15)
    assert frames.dtype == np.int32
    assert {frame: frames[frame] for frame in np.flatnonzero(frames)} == {0: 3, 3: 2, 15: UNKNOWN}


def test_a_word_from_before_the_window_counts_while_it_is_spoken():
    assert words_to_frames([Word("one", 0.5, 1.1)], VOCABULARY, 1.0, 34, 15)[0] == 3
    assert not words_to_frames([Word("one", 0.5, 1.0)], VOCABULARY, 1.0, 34, 15).any()


def test_the_later_of_two_words_in_a_frame_stays_and_the_end_is_open():
    words = [Word("one", 0.01, 0.02), Word("two", 0.03, 0.04), Word("three", 34 / 15, 3)]
    frames = words_to_frames(words, VOCABULARY, 0.0, 34, 15)
    assert frames[0] == 2
    assert np.count_nonzero(frames) == 1


@pytest.mark.parametrize("frame", range(34))
def test_a_start_on_a_frame_border_belongs_to_the_frame_it_opens(frame):
    start = 731 / 15
    frames = words_to_frames([Word("one", start + frame / 15, 99)], VOCABULARY, start, 34, 15)
    assert np.flatnonzero(frames).tolist() == [frame]

"""What a window of speech is made of: the same for training and synthesis, and nothing that was not asked for."""

import numpy as np
import pytest

from ha2g_jax.data import speech
from ha2g_jax.features.audio import high_pass
from ha2g_jax.features.text import Vocabulary, Word

WORDS = (Word("one", 0.1, 0.4), Word("two", 2.3, 2.5), Word("six", 3.9, 4.3))
VOCABULARY = Vocabulary(("one", "two"))


@pytest.fixture(scope="module")
def audio():
    return np.random.default_rng(0).normal(0, 0.1, 5 * 16000).astype(np.float32)


@pytest.mark.parametrize("inputs", [("mel", "words"), ("audio", "words"), ("plain_words",), ("asr_mel",), ()])
def test_a_window_has_what_was_asked_for_in_its_shapes(audio, inputs):
    shapes = {"mel": (128, 70), "asr_mel": (80, 228), "audio": (36267,), "words": (34,), "plain_words": (32,)}
    assert shapes.keys() == set(speech.INPUTS)
    cut = speech.window(speech.prepare(audio, WORDS, inputs), inputs, VOCABULARY, 30, 34, 15)
    assert {name: array.shape for name, array in cut.items()} == {name: shapes[name] for name in inputs}


def test_a_window_starts_at_its_frame_and_past_the_end_there_is_silence(audio):
    prepared = speech.prepare(audio, WORDS, ("audio",))
    cut = speech.window(prepared, ("audio",), VOCABULARY, 45, 34, 15)["audio"]
    np.testing.assert_array_equal(cut[:32000], high_pass(audio)[48000:])
    assert not cut[32000:].any()


def test_words_of_a_window_with_and_without_their_times(audio):
    prepared = speech.prepare(audio, WORDS, ("words", "plain_words"))
    cut = speech.window(prepared, ("words", "plain_words"), VOCABULARY, 30, 34, 15)  # from 2 s to 4.27 s
    assert np.flatnonzero(cut["words"]).tolist() == [4, 28]
    # start, "two", a word that training did not have, end
    assert cut["plain_words"][:5].tolist() == [len(VOCABULARY), 3, 1, len(VOCABULARY) + 1, 0]


def test_a_sentence_that_is_too_long_keeps_its_marks(audio):
    words = tuple(Word("one", 0.01 * index, 0.01 * index + 0.01) for index in range(60))
    cut = speech.window(speech.prepare(audio, words, ("plain_words",)), ("plain_words",), VOCABULARY, 0, 34, 15)
    assert cut["plain_words"][[0, 1, -2, -1]].tolist() == [4, 2, 2, 5]

"""Times are shared out, mended or refused by the rules in the docstrings."""

import pathlib

import pytest

from ha2g_jax.features.text import Word
from ha2g_jax.features.words import inside, timing
from ha2g_jax.features.words.timing import Stretch

PATH = pathlib.Path("a.tsv")


def rounded(words):
    return [(text, round(start, 3), round(end, 3)) for text, start, end in words]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Don't — stop!", ["don't", "stop"]),
        ("‘Twenty-one’ isn’t 1,000.", ["twenty", "one", "isn't", "1000"]),
        ("Ça va, Łódź? ÜBER", ["ça", "va", "łódź", "über"]),
        ("हिन्दी में", ["हिन्दी", "में"]),
        ("cafe\u0301", ["café"]),
        ("... '' - _", []),
    ],
)
def test_spelling(text, words):
    """Any language; marks within a word stay in it, punctuation never does."""
    assert timing.split_words(text) == words


def test_spread_by_letters():
    assert timing.spread(["ab", "abcdef"], 1.0, 3.0) == [("ab", 1.0, 1.5), ("abcdef", 1.5, 3.0)]
    assert timing.spread([], 1.0, 3.0) == []


def test_overlaps_are_cut_and_order_is_restored():
    words = timing.to_words([Stretch("b", 1.0, 2.0), Stretch("a", 0.0, 1.5)], PATH)
    assert rounded(words) == [("a", 0.0, 1.0), ("b", 1.0, 2.0)]


def test_words_of_no_length_share_the_time_to_the_next():
    """Whisper writes such words; none may be lost or start after its end."""
    words = timing.to_words([Stretch("ab", 1.0, 1.0), Stretch("cd", 1.0, 1.0), Stretch("e", 1.06, 2.0)], PATH)
    assert rounded(words) == [("ab", 1.0, 1.03), ("cd", 1.03, 1.06), ("e", 1.06, 2.0)]


def test_too_many_words_for_the_time():
    """A damaged file with a thousand words in 10 ms leaves one, which does not reach into the next."""
    words = timing.to_words([*[Stretch("a", 1.0, 1.5)] * 1000, Stretch("b", 1.01, 2.0)], PATH)
    assert rounded(words) == [("a", 1.0, 1.01), ("b", 1.01, 2.0)]


def test_times_before_zero_are_cut():
    words = timing.to_words([Stretch("a", -2.0, -1.0), Stretch("b", -0.5, 0.5)], PATH)
    assert rounded(words) == [("b", 0.0, 0.5)]


def test_inside():
    """Cut to the recording at both ends."""
    words = [Word("a", -1.0, 0.0), Word("b", -0.1, 0.4), Word("c", 0.5, 2.0), Word("d", 1.0, 3.0)]
    assert inside(words, 1.0) == (("b", 0.0, 0.4), ("c", 0.5, 1.0))


def test_gaps():
    """A text without times needs 30 ms a letter between its neighbours, less the slack."""
    stretches = [Stretch("a", 0.0, 1.0), Stretch("b c", None, None), Stretch("d", 1.05, 2.0), Stretch("e", None, None)]
    assert [one.text for one in timing.fill_gaps(stretches, 0.0, None)] == ["a", "d"]
    assert [one.text for one in timing.fill_gaps(stretches, 0.0, 2.5, slack=0.01)] == ["a", "b c", "d", "e"]
    assert timing.fill_gaps(stretches[1:2], None, 9.0) == []

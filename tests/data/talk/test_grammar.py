"""Sentences are deterministic, speak of every gesture equally often, and are marked up without regard to the words."""

import collections
import itertools
import re

import numpy as np

from ha2g_jax.data.talk import grammar
from ha2g_jax.data.talk.lexicon import WORD_CLASSES, word_class
from ha2g_jax.features import espeak as speech


def sample(seed: int, count: int) -> list[str]:
    return list(itertools.islice(grammar.sentences(np.random.default_rng(seed)), count))


def words(markup: str) -> list[str]:
    return re.findall(r"[a-z']+", re.sub("<[^>]*>", " ", markup))


def test_deterministic():
    assert sample(3, 20) == sample(3, 20) != sample(4, 20)


def test_gesture_words_stand_in_carriers_only():
    """So their frequency is set in one place: each carrier has its own word, once, and no other text has any."""
    assert set(grammar.CARRIERS) == {word for members in WORD_CLASSES.values() for word in members}
    for word, options in grammar.CARRIERS.items():
        for option in options:
            assert [token for token in option.split() if word_class(token)] == [word], option
    for options in grammar.RULES.values():
        for option in options:
            assert not any(word_class(token.strip(",")) for token in option.split()), option


def test_every_symbol_is_replaced():
    for markup in sample(0, 500):
        spoken = re.sub("<[^>]*>", " ", markup)
        assert re.fullmatch(r"[a-z ,.']+", spoken), spoken
        assert not re.search(r"\ba [aeio]", spoken), spoken


def test_classes_are_even_and_frequent():
    counts = collections.Counter(word for markup in sample(0, 1000) for word in words(markup))
    carried = {word: counts[word] for word in grammar.CARRIERS}
    assert max(carried.values()) - min(carried.values()) <= 1
    assert 0.07 < sum(carried.values()) / counts.total() < 0.12
    assert 450 < len(counts) < 800


def test_espeak_speaks_the_words_and_nothing_else():
    """No racing over crowded markup, no punctuation read out."""
    for seed in range(8):
        voice = speech.sample_voice(np.random.default_rng(seed))
        for markup in sample(seed, 20):
            utterance = speech.say(markup, voice)
            assert [word.text for word in utterance.words] == words(markup)
            for first, third in zip(utterance.words, utterance.words[2:]):
                assert third.end - first.start > 0.12, markup
            assert len(utterance.audio) / 16000 - utterance.words[-1].end < 0.6


def test_emphasis_says_nothing_about_the_word():
    """Gesture-bearing words are emphasised as often as other content words."""
    emphasised, plain = collections.Counter(), collections.Counter()
    for markup in sample(1, 3000):
        for word in re.findall(r"%\">([a-z']+)[.,]?</", markup):
            emphasised[bool(word_class(word))] += 1
        for word in words(markup):
            if word not in grammar._FUNCTION_WORDS:
                plain[bool(word_class(word))] += 1
    rates = {kind: emphasised[kind] / plain[kind] for kind in (True, False)}
    assert abs(rates[True] - rates[False]) < 0.03

"""Sentences speak of every gesture equally often, and are marked up without regard to the words."""

import collections
import itertools
import re

import numpy as np
import pytest

from ha2g_jax import anatomy
from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import grammar, lexicon
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
            assert len(utterance.audio) / 16000 - utterance.words[-1].end < 1.0


@pytest.mark.parametrize("language", grammar.OTHER_LANGUAGES)
def test_other_languages_have_their_words_and_no_gesture(language):
    rng = np.random.default_rng(0)
    for markup in itertools.islice(grammar.sentences(rng, language), 4):
        spoken = re.sub("<[^>]*>", " ", markup).replace(",", "").replace(".", "").split()
        utterance = speech.say(markup, speech.sample_voice(rng)._replace(language=language))
        assert [word.text for word in utterance.words] == spoken
        times = [time for word in utterance.words for time in (word.start, word.end)]
        assert times == sorted(times) and times[-1] <= len(utterance.audio) / 16000
    assert not any(
        word_class(word.strip(",")) for text in grammar._LANGUAGES[language].values() for word in text.split()
    )


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


def test_every_class_has_words_a_shape_and_a_path():
    words = list(itertools.chain(*lexicon.WORD_CLASSES.values()))
    assert len(words) == len(set(words))
    assert lexicon.WORD_CLASSES.keys() == anatomy.HAND_SHAPES.keys() == lexicon.ARM_PATHS.keys()
    assert lexicon.word_class("Tiny") == "small"
    assert lexicon.word_class("table") == ""


def test_hand_shapes_are_told_apart_by_the_fingers_alone():
    for first, second in itertools.combinations(anatomy.HAND_SHAPES.values(), 2):
        assert np.linalg.norm(np.subtract(first, second)) > 0.6


@pytest.mark.parametrize("spread", [0.0, 14.0, 40.0])
def test_flexions_are_read_back_from_a_drawn_hand(spread):
    skeleton = skeletons.load_skeleton("ted_expressive")
    shapes = np.array(list(anatomy.HAND_SHAPES.values()))
    fingers = np.stack([shapes, shapes[::-1]], axis=1)
    trunk, head, shrug = (np.zeros((len(shapes), size)) for size in (3, 3, 2))
    body = anatomy.Body(
        trunk, head, shrug, np.full((len(shapes), 2, 7), 20.0), fingers, np.full((len(shapes), 2), spread)
    )
    read = anatomy.finger_flexions(skeleton, anatomy.body_directions(skeleton, body))
    np.testing.assert_allclose(read, fingers, atol=1e-6)
    straight = anatomy.body_directions(skeleton, body._replace(fingers=np.zeros_like(fingers)))
    index, little = (straight[:, skeleton.bone(f"left_{name}_3")] for name in ("index", "pinky"))
    np.testing.assert_allclose(np.rad2deg(np.arccos(np.sum(index * little, axis=-1))), spread, atol=1e-3)


def test_inverse_kinematics_reaches_every_path():
    skeleton = skeletons.load_skeleton("ted_expressive")
    for path in lexicon.ARM_PATHS.values():
        arms = np.zeros((1, 2, 7))
        arms[..., :4] = anatomy.reach(skeleton, np.array([path.peak]), np.array([20.0]))
        body = anatomy.Body(
            np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)), arms, np.zeros((1, 2, 5)), np.full((1, 2), 14.0)
        )
        assert all(np.allclose(a, b) for a, b in zip(body, anatomy.within_limits(body), strict=True))
        pose = skeletons.directions_to_positions(skeleton, anatomy.body_directions(skeleton, body))[0]
        for side, sign in (("left", 1), ("right", -1)):
            offset = pose[skeleton.joint(f"{side}_wrist")] - pose[skeleton.joint(f"{side}_shoulder")]
            np.testing.assert_allclose(offset * (sign, -1, -1), path.peak, atol=1e-5)

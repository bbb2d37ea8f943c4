"""Flite's speech is the same in any order, has the words of the markup, and follows voice and emphasis."""

import ctypes
import itertools

import numpy as np
import pytest

from ha2g_jax.data.talk import build, flite, grammar
from ha2g_jax.data.talk.flite import FLITE_VOICES, HELD_OUT_VOICES, FliteVoice, sample_flite_voice
from ha2g_jax.features.audio import SAMPLE_RATE

VOICE = FliteVoice("slt", 1.0, 1.0, 1.0)
TEXT = (
    '<prosody volume="+10%" pitch="+5%" rate="95%">we found it,</prosody> <break time="300ms"/> '
    '<prosody volume="+0%" pitch="-5%" rate="105%">but <break time="200ms"/> he\'s <prosody volume="+90%" '
    'pitch="+22%">gone.</prosody></prosody>'
)


def is_installed() -> bool:
    try:
        ctypes.CDLL("libflite.so.1")
    except OSError:
        return False
    return True


needs_flite = pytest.mark.skipif(not is_installed(), reason="Flite is not installed")


@needs_flite
@pytest.mark.parametrize("name", [*FLITE_VOICES, *HELD_OUT_VOICES])
def test_independent_of_what_was_said_before(name):
    """The noise of the voices would otherwise go on from one utterance to the next."""
    voice = VOICE._replace(name=name)
    first = flite.say(TEXT, voice)
    flite.say("something else.", VOICE)
    second = flite.say(TEXT, voice)
    assert first.words == second.words
    np.testing.assert_array_equal(first.audio, second.audio)


@needs_flite
def test_words_and_breaks():
    utterance = flite.say(TEXT, VOICE)
    words = utterance.words
    assert [word.text for word in words] == ["we", "found", "it", "but", "he's", "gone"]
    gaps = [after.start - before.end for before, after in itertools.pairwise(words)]
    np.testing.assert_allclose(gaps, [0, 0, 0.3, 0.2, 0], atol=1e-3)
    assert words[0].start == 0 and words[-1].end == pytest.approx(len(utterance.audio) / SAMPLE_RATE, abs=1e-3)


@needs_flite
def test_a_breath_is_silent_and_a_word_is_not():
    utterance = flite.say(TEXT, VOICE)
    silence = utterance.audio[round(utterance.words[2].end * SAMPLE_RATE) :][: round(0.29 * SAMPLE_RATE)]
    assert not silence[10:].any()
    for word in utterance.words:
        sound = utterance.audio[round(word.start * SAMPLE_RATE) : round(word.end * SAMPLE_RATE)]
        assert np.sqrt(np.mean(sound**2)) > 0.01


@needs_flite
def test_an_emphasised_word_is_louder_and_longer():
    plain = flite.say("we found it.", VOICE)
    strong = flite.say('we <prosody volume="+90%" pitch="+22%">found</prosody> it.', VOICE)

    def middle(utterance):
        word = utterance.words[1]
        sound = utterance.audio[round(word.start * SAMPLE_RATE) : round(word.end * SAMPLE_RATE)]
        return word.end - word.start, np.sqrt(np.mean(sound**2))

    (seconds, level), (long_seconds, high_level) = middle(plain), middle(strong)
    assert long_seconds / seconds == pytest.approx(1.22, abs=0.06)
    assert high_level / level == pytest.approx(1.9, rel=0.25)


@needs_flite
def test_rate_and_formants_are_independent():
    """A shorter vocal tract moves the spectrum up and leaves the duration as it is."""

    def describe(voice):
        audio = flite.say("the sailor found a brilliant answer in the garden.", voice).audio
        power = np.abs(np.fft.rfft(audio)) ** 2
        band = np.cumsum(power) / power.sum()
        return len(audio), np.interp(0.8, band, np.arange(len(power))) / len(power)

    duration, edge = describe(VOICE)
    assert describe(VOICE._replace(rate=1.2))[0] / duration == pytest.approx(1 / 1.2, rel=0.02)
    same, higher = describe(VOICE._replace(formants=1.15))
    assert same / duration == pytest.approx(1, rel=0.01) and higher / edge > 1.05


@needs_flite
def test_every_sentence_of_the_grammar_is_spoken():
    rng = np.random.default_rng(0)
    sentences = grammar.sentences(rng)
    for name in (*FLITE_VOICES, *HELD_OUT_VOICES) * 6:
        utterance = flite.say(next(sentences), sample_flite_voice(rng, name))
        times = [time for word in utterance.words for time in (word.start, word.end)]
        assert times == sorted(times) and all(word.end - word.start > 0.01 for word in utterance.words)
        assert np.isfinite(utterance.audio).all() and 0.02 < np.abs(utterance.audio).max() < 2


@needs_flite
def test_workers_do_not_change_the_bytes(tmp_path):
    for name, workers in (("a", 1), ("b", 2)):
        build.make_talk(tmp_path / name, speakers=2, minutes=2, workers=workers, synthesiser="both")
    for path in sorted((tmp_path / "a").iterdir()):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name

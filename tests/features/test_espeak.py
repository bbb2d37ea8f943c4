"""Speech is the same in any process and any order, and its words lie where the sound is."""

import hashlib
import subprocess
import sys
import time

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.features import espeak as speech
from ha2g_jax.features.audio import SAMPLE_RATE

MAN = speech.Voice("en-us", "m3", pitch=50, pitch_range=60, rate=160)
WOMAN = speech.Voice("en", "f2", pitch=40, pitch_range=60, rate=160)
TEXT = "The first of the ideas, <break time='300ms'/> and don't forget it, was found in the garden."


def decibels(audio: np.ndarray) -> float:
    return float(10 * np.log10(np.mean(np.square(audio)) + 1e-12))


def part(utterance: speech.Utterance, start: float, end: float) -> np.ndarray:
    return utterance.audio[round(start * SAMPLE_RATE) : round(end * SAMPLE_RATE)]


@pytest.mark.parametrize("voice", [MAN, WOMAN, MAN._replace(variant="adam")])
def test_independent_of_what_was_said_before(voice):
    """Echo, flutter and the phase of the voice would otherwise carry over from one utterance to the next.

    Breath would depend on the clock, in seconds.
    """
    first = speech.say(TEXT, voice)
    time.sleep(1.1)
    speech.say("Something else.", WOMAN._replace(variant="f5"))
    second = speech.say(TEXT, voice)
    assert first.words == second.words
    np.testing.assert_array_equal(first.audio, second.audio)


def test_same_in_another_process():
    code = (
        "from ha2g_jax.features import espeak as speech; import hashlib;"
        f"print(hashlib.sha256(speech.say({TEXT!r}, speech.{WOMAN}).audio.tobytes()).hexdigest())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == hashlib.sha256(speech.say(TEXT, WOMAN).audio.tobytes()).hexdigest()


@pytest.mark.parametrize("voice", [MAN, WOMAN])
def test_words_and_their_times(voice):
    """Every word once, in order, without punctuation; loud between its times and silent in the pause."""
    utterance = speech.say(TEXT, voice)
    texts = ["the", "first", "of", "the", "ideas", "and", "don't", "forget", "it", "was", "found", "in"]
    assert [word.text for word in utterance.words] == [*texts, "the", "garden"]
    times = [time for word in utterance.words for time in (word.start, word.end)]
    assert times == sorted(times)
    assert all(word.end - word.start > 0.02 for word in utterance.words)
    assert times[-1] <= len(utterance.audio) / SAMPLE_RATE
    before, after = utterance.words[4], utterance.words[5]
    assert after.start - before.end > 0.25
    silence = decibels(part(utterance, before.end + 0.05, after.start - 0.02))
    for word in utterance.words:
        assert decibels(part(utterance, word.start, word.end)) > silence + 20, word


def test_markup_changes_the_sound():
    """Emphasis makes a word louder and a slower rate makes it longer; neither changes the words."""

    def measure(prosody: str) -> tuple[float, float]:
        utterance = speech.say(f"we saw the <prosody {prosody}>table</prosody> in the house", MAN)
        word = utterance.words[3]
        assert word.text == "table"
        return decibels(part(utterance, word.start, word.end)), word.end - word.start

    plain, loud, slow = measure(""), measure('volume="+80%"'), measure('rate="70%"')
    assert loud[0] > plain[0] + 3
    assert slow[1] > 1.2 * plain[1]


def test_every_voice_speaks():
    """Each variant and accent exists, does not clip, and has a rate like that of people."""
    for variant in (*speech.MALE_VARIANTS, *speech.FEMALE_VARIANTS):
        utterance = speech.say("people like to hear a good story", MAN._replace(variant=variant))
        assert 0.05 < np.abs(utterance.audio).max() < 0.95, variant
    for language in speech.LANGUAGES:
        assert len(speech.say("hello world", MAN._replace(language=language)).words) == 2


def test_sampled_voices_differ():
    sampled = [speech.sample_voice(np.random.default_rng(seed)) for seed in range(24)]
    assert len(set(sampled)) == 24
    assert sampled == [speech.sample_voice(np.random.default_rng(seed)) for seed in range(24)]


def test_no_words():
    utterance = speech.say("...", MAN)
    assert utterance.words == ()


def test_missing_library(monkeypatch, tmp_path):
    monkeypatch.setattr("espeakng_loader.get_library_path", lambda: str(tmp_path / "none.so"))
    with pytest.raises(UserError, match="espeak-ng cannot be loaded"):
        speech.say("hello", MAN)

"""A text laid on sound: checked on synthetic speech, of which the true times of the words are known."""

import itertools

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.features import espeak as speech
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.words import alignment

VOICE = speech.Voice("en-us", "m3", pitch=50, pitch_range=60, rate=150)
TEXTS = (
    "Old ladies are what society has left behind, and nobody listens to them any more.",
    "The question that I do not even know to ask will only arise after a long walk.",
    "We met in nineteen eighty near the harbour, where Zbrigzell sold fresh bread.",
    "You find yourself standing on a mountain and staring out into the wide unknown.",
)


@pytest.fixture(scope="module")
def spoken():
    """43 s of four speakers with pauses of a second: (audio, true words)."""
    audio, words = np.zeros(SAMPLE_RATE // 2, np.float32), []
    for number in range(8):
        utterance = speech.say(TEXTS[number % 4], VOICE._replace(variant=("m3", "f2", "m5", "f4")[number // 2]))
        start = len(audio) / SAMPLE_RATE
        words += [word._replace(start=start + word.start, end=start + word.end) for word in utterance.words]
        audio = np.concatenate([audio, utterance.audio, np.zeros(SAMPLE_RATE, np.float32)])
    noise = np.random.default_rng(0).normal(0, 1e-3, len(audio))
    return (audio + noise).astype(np.float32), words


def test_synthetic_speech(spoken):
    """Longer than a piece, with an unknown word: every word once, in order, starts right to some hundredths."""
    pytest.importorskip("pocketsphinx")
    audio, true = spoken
    assert len(audio) > alignment.MAX_PIECE_SECONDS * SAMPLE_RATE
    words = alignment.align(audio, " ".join(TEXTS * 2))
    assert [word.text for word in words] == [word.text for word in true]
    errors = [abs(word.start - reference.start) for word, reference in zip(words, true, strict=True)]
    assert np.median(errors) < 0.06 and np.quantile(errors, 0.9) < 0.2


def test_text_that_is_not_spoken(spoken, caplog):
    """A second copy of the text fits nowhere and is left out, with a warning; the words before keep their times."""
    pytest.importorskip("pocketsphinx")
    audio, true = spoken
    audio = audio[: round(true[15].start * SAMPLE_RATE)]
    text = " ".join(word.text for word in true[:15])
    words = alignment.align(audio, f"{text} {text} {text}")
    assert len(words) < 3 * 15 and "left out" in caplog.text
    assert words[-1].end <= len(audio) / SAMPLE_RATE + 1e-6


def test_what_cannot_be_aligned_is_spread(spoken, monkeypatch, caplog):
    """Still every word, in order, in the voiced part of the sound; and a line in the log."""
    pytest.importorskip("pocketsphinx")
    audio, true = spoken
    audio = np.concatenate([np.zeros(5 * SAMPLE_RATE, np.float32), audio[: 5 * SAMPLE_RATE]])
    monkeypatch.setattr(alignment, "_decode", lambda *_: [])
    words = alignment.align(audio, TEXTS[0])
    assert [word.text for word in words] == [word.text for word in true[:15]]
    assert words[1].start > 4.5 and words[-1].end <= 10 + 1e-6
    assert "15 words from 0.0 to 10.0 s cannot be aligned; spread by letters" in caplog.text
    assert "0 of 15 words were recognised" in caplog.text


@pytest.mark.parametrize("seconds", [0, 0.01, 3])
def test_silence(seconds):
    pytest.importorskip("pocketsphinx")
    words = alignment.align(np.zeros(round(seconds * SAMPLE_RATE), np.float32), "hello 世界")
    assert all(0 <= word.start < word.end <= max(1, seconds) for word in words)


def test_no_words():
    with pytest.raises(UserError, match="has no words"):
        alignment.align(np.zeros(SAMPLE_RATE, np.float32), "... -")


@pytest.mark.parametrize("folder", ["zeroeggs_067", "zeroeggs_neutral_001"])
def test_genuine_recordings(private_data, folder):
    """Over a minute of real speech; the second one's reference comes from another aligner."""
    pytest.importorskip("pocketsphinx")
    [sound] = (private_data / folder).glob("*.wav")
    true = transcripts.read_words(private_data / folder / "words.tsv")
    words = alignment.align(read_audio(sound), " ".join(word.text for word in true))
    assert [word.text for word in words] == [word.text for word in true]
    errors = [abs(word.start - reference.start) for word, reference in zip(words, true, strict=True)]
    assert np.median(errors) < 0.03 and np.quantile(errors, 0.9) < 0.15


def test_guessed_pronunciations():
    """Near those of the dictionary, in its phones alone; numbers are read out."""
    phones = {phone for mapped in alignment._PHONES.values() for phone in mapped.split()}
    guessed = alignment.guess_pronunciations(["hello", "80", "zbrigzell", "café", "日"])
    assert guessed["hello"] == "HH AH L OW" and guessed["80"] == "EY T IY" and guessed["café"] == "K AE F EY"
    assert all(set(spoken.split()) <= phones and spoken for spoken in guessed.values())
    assert len(phones) == 39  # all of the CMU set


def test_voiced_clock():
    """It stands still in silence, nearly, and can be read backwards."""
    random = np.random.default_rng(0)
    audio = np.concatenate([np.zeros(SAMPLE_RATE), random.normal(0, 0.1, SAMPLE_RATE), np.zeros(2 * SAMPLE_RATE)])
    clock = alignment.voiced_clock(audio.astype(np.float32))
    assert clock.to_voiced(1.0) < 0.1 and clock.to_voiced(2.0) - clock.to_voiced(1.0) == pytest.approx(1, abs=0.05)
    assert clock.to_time(clock.to_voiced(1.5)) == pytest.approx(1.5)
    pieces = alignment.cut_at_quiet(audio.astype(np.float32), 1.5)
    assert pieces[0][0] == 0 and pieces[-1][1] == 4.0
    assert all(before[1] == after[0] for before, after in itertools.pairwise(pieces))
    assert max(end - start for start, end in pieces) <= 1.5

"""Words of a recording from a text or from sound alone, by a stand-in for Whisper, whose weights are not included.

They are checked on synthetic speech, of which the true times of the words are known.
"""

import itertools
import os
import sys
import types

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


SILENCE = np.zeros(SAMPLE_RATE, np.float32)


def segment(text, start, end):
    return types.SimpleNamespace(word=text, start=np.float64(start), end=np.float64(end))


@pytest.fixture
def whisper(monkeypatch):
    """A module faster_whisper whose model recognises what the test puts into `answer`; calls are recorded."""

    class WhisperModel:
        def __init__(self, model, **settings):
            stand_in.loaded = (model, settings)

        def transcribe(self, audio, **settings):
            stand_in.asked = settings
            words, language = stand_in.answer
            segments = [types.SimpleNamespace(words=words), types.SimpleNamespace(words=None)]
            return iter(segments), types.SimpleNamespace(language=language)

    stand_in = types.SimpleNamespace(WhisperModel=WhisperModel, answer=([], "en"), loaded=None, asked={})
    monkeypatch.setitem(sys.modules, "faster_whisper", stand_in)
    return stand_in


def test_other_languages_keep_the_times_of_whisper(whisper):
    """pocketsphinx knows English only. Words of no length and reversed ones are corrected."""
    whisper.answer = (
        [segment(" Grüß", 0.1, 0.4), segment(" Gott,", 0.4, 0.4), segment(" Frau-Holle!", 0.6, 0.5)],
        "de",
    )
    words = alignment.recognise(SILENCE, model="small")
    assert [word.text for word in words] == ["grüß", "gott", "frau", "holle"]
    assert all(word.start < word.end and type(word.start) is float for word in words)
    assert whisper.loaded == ("small", {"device": "cpu", "compute_type": "int8", "cpu_threads": 1})
    assert whisper.asked["word_timestamps"] is True
    assert whisper.asked["temperature"] == 0.0


def test_english_is_aligned_anew(whisper):
    """Whisper's times are off by half a second here; those of the alignment are not."""
    pytest.importorskip("pocketsphinx")
    utterance = speech.say("The old garden was full of yellow flowers.", speech.Voice("en-us", "m3", 50, 60, 150))
    whisper.answer = ([segment(" " + word.text, word.start + 0.5, word.end + 0.5) for word in utterance.words], "en")
    words = alignment.recognise(utterance.audio, model="tiny.en")
    assert [word.text for word in words] == [word.text for word in utterance.words]
    assert np.median([abs(a.start - b.start) for a, b in zip(words, utterance.words, strict=True)]) < 0.06


def test_nobody_speaks(whisper):
    assert alignment.recognise(SILENCE, model="tiny.en") == ()


def test_models_that_cannot_be_loaded(tmp_path, whisper, monkeypatch):
    """One line that tells where it looked and how to name a folder."""
    with pytest.raises(UserError, match=r"has no Whisper model in CTranslate2's format \(model.bin, tokenizer.json"):
        alignment.recognise(SILENCE, model=str(tmp_path))

    def refuse(*_, **__):
        raise OSError("ConnectError:\nno network")

    monkeypatch.setattr(whisper, "WhisperModel", refuse)
    with pytest.raises(UserError, match=r"Hugging Face Hub and in its cache .* or give a folder") as caught:
        alignment.recognise(SILENCE, model="tiny.en")
    assert "\n" not in str(caught.value)


def test_damaged_model(tmp_path):
    """The genuine library on a folder that holds nonsense."""
    pytest.importorskip("faster_whisper")
    for name in ("model.bin", "tokenizer.json", "config.json", "vocabulary.txt"):
        (tmp_path / name).write_bytes(b"nonsense")
    with pytest.raises(UserError, match=r"cannot be loaded .* searched in that folder") as caught:
        alignment.recognise(SILENCE, model=str(tmp_path))
    assert "\n" not in str(caught.value)


def test_genuine_model(private_data):
    """With the weights of tiny.en at hand (HA2G_WHISPER_MODEL): nearly all words of a real recording, in place."""
    pytest.importorskip("faster_whisper")
    model = os.environ.get("HA2G_WHISPER_MODEL")
    if model is None:
        pytest.skip("no Whisper model here (set HA2G_WHISPER_MODEL to a folder)")
    words = transcripts.words_of(read_audio(private_data / "video" / "sample.mp4"), None, recognise=model)
    true = transcripts.read_words(private_data / "video" / "words.tsv")
    assert abs(len(words) - len(true)) <= 3
    starts = {word.text: word.start for word in true if len(word.text) > 5}
    found = [abs(starts[word.text] - word.start) for word in words if word.text in starts]
    assert len(found) > 10 and np.median(found) < 0.1


def test_source_of_words(tmp_path, whisper):
    """A file with times is read and cut to the recording; a plain text is aligned; without either a model is asked."""
    pytest.importorskip("pocketsphinx")
    table = tmp_path / "a.tsv"
    table.write_text("start\tend\tword\n0.5\t0.8\tone\n0.9\t1.8\ttwo\n2\t3\tthree\n")
    assert transcripts.words_of(SILENCE, table, recognise="tiny.en") == (("one", 0.5, 0.8), ("two", 0.9, 1.0))
    assert whisper.loaded is None
    text = tmp_path / "a.txt"
    text.write_text("The old garden.")
    utterance = speech.say("The old garden.", speech.Voice("en-us", "m3", 50, 60, 150))
    assert [word.text for word in transcripts.words_of(utterance.audio, text, recognise=None)] == [
        "the",
        "old",
        "garden",
    ]
    text.write_text("Mary: The old garden.\nJohn: Good morning to you.")
    assert [
        word.text for word in transcripts.words_of(utterance.audio, text.with_name("a.txt#Mary"), recognise=None)
    ] == [
        "the",
        "old",
        "garden",
    ]
    whisper.answer = ([segment(" un", 0.1, 0.4)], "fr")
    assert transcripts.words_of(SILENCE, None, recognise="base") == (("un", 0.1, 0.4),)
    with pytest.raises(UserError, match="no transcript beside it; give one"):
        transcripts.words_of(SILENCE, None, recognise=None)

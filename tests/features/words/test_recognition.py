"""Recognised words, with a stand-in for Whisper, whose weights are not included; and the origin of words."""

import os
import sys
import types

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.features import espeak as speech
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.words import recognition

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
    words = recognition.recognise(SILENCE, model="small", language="de")
    assert [word.text for word in words] == ["grüß", "gott", "frau", "holle"]
    assert all(word.start < word.end and type(word.start) is float for word in words)
    assert whisper.loaded == ("small", {"device": "cpu", "compute_type": "int8", "cpu_threads": 1})
    assert whisper.asked["word_timestamps"] is True and whisper.asked["language"] == "de"
    assert whisper.asked["temperature"] == 0.0


def test_english_is_aligned_anew(whisper):
    """Whisper's times are off by half a second here; those of the alignment are not."""
    pytest.importorskip("pocketsphinx")
    utterance = speech.say("The old garden was full of yellow flowers.", speech.Voice("en-us", "m3", 50, 60, 150))
    whisper.answer = ([segment(" " + word.text, word.start + 0.5, word.end + 0.5) for word in utterance.words], "en")
    words = recognition.recognise(utterance.audio)
    assert [word.text for word in words] == [word.text for word in utterance.words]
    assert np.median([abs(a.start - b.start) for a, b in zip(words, utterance.words, strict=True)]) < 0.06


def test_nobody_speaks(whisper):
    assert recognition.recognise(SILENCE) == ()


def test_models_that_cannot_be_loaded(tmp_path, whisper, monkeypatch):
    """One line that tells where it looked and how to name a folder."""
    with pytest.raises(UserError, match=r"has no Whisper model in CTranslate2's format \(model.bin, tokenizer.json"):
        recognition.recognise(SILENCE, model=str(tmp_path))

    def refuse(*_, **__):
        raise OSError("ConnectError:\nno network")

    monkeypatch.setattr(whisper, "WhisperModel", refuse)
    with pytest.raises(UserError, match=r"Hugging Face Hub and in its cache .* or give a folder") as caught:
        recognition.recognise(SILENCE, model="tiny.en")
    assert "\n" not in str(caught.value)


def test_damaged_model(tmp_path):
    """The genuine library on a folder that holds nonsense."""
    pytest.importorskip("faster_whisper")
    for name in ("model.bin", "tokenizer.json", "config.json", "vocabulary.txt"):
        (tmp_path / name).write_bytes(b"nonsense")
    with pytest.raises(UserError, match=r"cannot be loaded .* searched in that folder") as caught:
        recognition.recognise(SILENCE, model=str(tmp_path))
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
    whisper.answer = ([segment(" un", 0.1, 0.4)], "fr")
    assert transcripts.words_of(SILENCE, None, recognise="base") == (("un", 0.1, 0.4),)
    with pytest.raises(UserError, match="no transcript beside it; give one"):
        transcripts.words_of(SILENCE, None, recognise=None)

"""Any transcript gives the same words and times in whichever dialect a program writes it."""

import json
import logging
import pathlib

import numpy as np
import pytest
from fixtures.transcripts import DIALECTS, cues, text_grid
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.features.words import read_words, words_of


@st.composite
def transcripts(draw) -> list[tuple[str, float, float]]:
    """Draw words of 0.3 to 2 s, at whole milliseconds, after pauses of 0.1 to 3 s."""
    time, words = 0, []
    for text in draw(st.lists(st.text("abcdefgh", min_size=1, max_size=9), min_size=1, max_size=6)):
        start = time + draw(st.integers(100, 3_000))
        time = start + draw(st.integers(300, 2_000))
        words.append((text, start / 1000, time / 1000))
    return words


@pytest.mark.parametrize("name", DIALECTS)
@settings(max_examples=20, derandomize=True, database=None, deadline=None)
@given(words=transcripts())
def test_any_transcript_is_the_same_in_every_dialect(tmp_path_factory, name, words):
    path = tmp_path_factory.mktemp("a") / name
    content = DIALECTS[name](words)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    found = read_words(path)
    assert [word.text for word in found] == [text for text, _, _ in words]
    times = [time for word in found for time in (word.start, word.end)]
    assert times == pytest.approx([time for _, *pair in words for time in pair], abs=1e-6)


@pytest.mark.parametrize("name", ["list.json", "aeneas.json", "audacity.txt", "units.csv", "long.txt", "voices.txt"])
def test_tags_sounds_and_labels_are_no_words_in_any_dialect(tmp_path, name):
    lines = [("[Mary]: hello (laughs)", 0, 1), ("♪ <i>yes</i>", 1, 2), ("[music]", 2, 3), (">> Bob: at 12:30", 3, 4)]
    content = DIALECTS[name](lines)
    (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
    assert [word.text for word in read_words(tmp_path / name)] == ["hello", "yes", "at", "12", "30"]


WORDS = [("hello", 0.1, 0.475), ("there", 0.5, 0.875)]
BY_PROGRAM = {
    "Polly": "\n".join(
        [
            '{"time":100,"type":"sentence","start":0,"end":12,"value":"Hello there."}',
            '{"time":100,"type":"word","start":0,"end":5,"value":"Hello"}',
            '{"time":100,"type":"viseme","value":"k"}',
            '{"time":500,"type":"word","start":6,"end":11,"value":"there"}',
        ]
    ),
    "edge-tts": "\n".join(
        [
            '{"type":"WordBoundary","offset":1000000,"duration":3750000,"text":"Hello"}',
            '{"type":"WordBoundary","offset":5000000,"duration":3750000,"text":"there"}',
        ]
    ),
    "segments, of which one has no words": json.dumps(
        [
            {"start": 0.1, "end": 0.475, "text": "Hello", "words": []},
            {"start": 0.5, "end": 0.875, "text": "there", "words": [{"word": "there", "start": 0.5, "end": 0.875}]},
        ]
    ),
    "a word without a text, and one that ends before it starts": json.dumps(
        [
            {"word": "hello", "start": 0.1, "end": 0.475},
            {"word": None, "start": 0.475, "end": 0.5},
            {"word": "there", "start": 0.5, "end": 0.49},
        ]
    ),
}


@pytest.mark.parametrize("program", BY_PROGRAM)
def test_files_as_programs_write_them(tmp_path, program):
    (tmp_path / "a.json").write_text(BY_PROGRAM[program])
    words = read_words(tmp_path / "a.json")
    assert [word.text for word in words] == [text for text, _, _ in WORDS]
    assert [word.start for word in words] == pytest.approx([start for _, start, _ in WORDS], abs=0.002)


def test_sounds_without_times_are_no_words(tmp_path):
    """As whisperX and YouTube write what their aligner does not spell."""
    words = [{"word": "[Music]"}, {"word": "hello", "start": 1.0, "end": 1.4}, {"word": "(laughs)"}]
    (tmp_path / "a.json").write_text(json.dumps({"segments": [{"start": 0.0, "end": 3.0, "text": "", "words": words}]}))
    assert [word.text for word in read_words(tmp_path / "a.json")] == ["hello"]


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ([(0, None, "hello"), (0.4, 0.8, "there")], [0, 0.4, 0.4, 0.8]),
        ([(0, 0.4, "hello"), (0.4, None, "there")], [0, 0.4, 0.4, 1.2]),
        ([(None, 0.4, "hello"), (None, 0.8, "there")], [0, 0.4, 0.4, 0.8]),
    ],
)
def test_open_times(tmp_path, entries, expected):
    """A missing end is the next start or slow speech, a missing start is the end before."""
    path = tmp_path / "a.json"
    path.write_text(json.dumps([dict(zip(("start", "end", "text"), entry, strict=True)) for entry in entries]))
    assert [time for word in read_words(path) for time in word[1:]] == pytest.approx(expected)


def test_words_within_a_line_of_youtube(tmp_path):
    """Only their starts are known, from that of the line."""
    line = {"tStartMs": 500, "dDurationMs": 3000, "segs": [{"utf8": "so"}, {"utf8": " good", "tOffsetMs": 700}]}
    (tmp_path / "a.json").write_text(json.dumps({"events": [{"tStartMs": 0, "id": 1}, line]}))
    assert [(word.text, word.start) for word in read_words(tmp_path / "a.json")] == [
        ("so", 0.5),
        ("good", pytest.approx(1.2)),
    ]


TEXTS = {
    "cp1252": "déjà “vu”, it’s naïve",
    "mac_roman": "mañana está canción",
    "utf-16-le": "café мир",
    "utf-16-be": "café мир",
    "utf-32": "café мир",
}
FOREIGN = {
    "cp1251": "Привет",
    "shift_jis": "こんにちは",
    "cp1250": "zażółć gęślą",
    "cp1254": "kadın ağaç",
    "gbk": "你好",
}


@pytest.mark.parametrize("encoding", TEXTS)
def test_encodings_of_real_programs(tmp_path, encoding):
    (tmp_path / "a.srt").write_bytes(cues([(TEXTS[encoding], 0, 1)], ",").encode(encoding))
    (tmp_path / "b.srt").write_text(cues([(TEXTS[encoding], 0, 1)], ","))
    assert read_words(tmp_path / "a.srt") == read_words(tmp_path / "b.srt")


@pytest.mark.parametrize("encoding", FOREIGN)
def test_an_encoding_that_cannot_be_known_is_refused(tmp_path, encoding):
    (tmp_path / "a.srt").write_bytes(cues([(FOREIGN[encoding], 0, 1)], ",").encode(encoding))
    with pytest.raises(UserError, match="in an encoding that cannot be known; save it as UTF-8"):
        read_words(tmp_path / "a.srt")


def test_text_that_was_encoded_twice_is_mended(tmp_path):
    text = cues([("café it’s soft\u00adly", 0, 1)], ",").encode().decode("cp1252")
    (tmp_path / "a.srt").write_bytes(text.encode() + b"\x1a")
    assert [word.text for word in read_words(tmp_path / "a.srt")] == ["café", "it's", "softly"]


SPEAKERS = {
    "a.vtt": "WEBVTT\n\n00:00.000 --> 00:01.000\n<v Mary Ann>hello</v>\n<v Bob>yes</v>\n",
    "a.srt": cues([("Mary Ann: hello", 0, 1), ("- Bob: yes", 1, 2)], ","),
    "a.json": json.dumps([{"start": i, "end": i + 0.4, "word": w, "speaker": s}
                          for i, (w, s) in enumerate([("hello", "Mary Ann"), ("yes", "Bob")])]),
    "a.TextGrid": text_grid(("Mary Ann - words", [(0, 1, "hello"), (1, 2, "too")]), ("Bob - words", [(0, 1, "yes")])),
}  # fmt: skip


@pytest.mark.parametrize("name", SPEAKERS)
def test_the_choice_among_speakers_is_the_users(tmp_path, caplog, name):
    """A warning lists them, FILE#NAME chooses one, and a name that is not there is refused with those that are."""
    path = tmp_path / name
    path.write_text(SPEAKERS[name])
    with caplog.at_level(logging.WARNING):
        read_words(path)
    assert "Mary Ann" in caplog.text and "Bob" in caplog.text and "FILE#NAME" in caplog.text
    assert [word.text for word in read_words(pathlib.Path(f"{path}#bob"))] == ["yes"]
    with pytest.raises(UserError, match=r"no speaker 'Joe'; expected one of: 'Mary Ann.*'Bob"):
        read_words(pathlib.Path(f"{path}#Joe"))


@pytest.mark.parametrize("name", SPEAKERS)
def test_in_a_corpus_the_words_are_of_who_is_recorded(tmp_path, name):
    """Nobody can choose for each of many files: another name is refused."""
    (tmp_path / name).write_text(SPEAKERS[name])
    silence = np.zeros(32_000, np.float32)
    own = words_of(silence, tmp_path / name, recognise=None, speaker="Bob")
    assert [word.text for word in own] == ["yes"]
    with pytest.raises(UserError, match=r"Mary Ann.*'Bob.*the recording is of 'take 3'; leave the words of one"):
        words_of(silence, tmp_path / name, recognise=None, speaker="take 3")


UNKNOWN = {
    "binary.TextGrid": (b"ooBinaryFile\x08TextGrid", "a binary file of Praat; save it from Praat as text file"),
    "lyrics.txt": (b"[00:01.20]so\n[00:02.00]we\n[00:03.10]go\n", "in a form that is not known; save it as SRT"),
    "otter.txt": (b"Ann  0:03\nso\n\nBob  0:10\nwe\n\nAnn  0:15\ngo\n", "in a form that is not known"),
    "timed.txt": (b'<?xml version="1.0"?><tt><p begin="1s">so</p></tt>', "in a form that is not known"),
    "clock.txt": (b"We met at 12:30.\nOr so.\n", "is a text without times"),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_other_forms_are_named_and_never_read_as_speech(tmp_path, name):
    content, message = UNKNOWN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=message):
        read_words(tmp_path / name)

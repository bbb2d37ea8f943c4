"""Any transcript gives the same words and times in whichever dialect a program writes it."""

import json
import logging
import pathlib

import pytest
from fixtures.transcripts import short_form, text_grid
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.features.words import read_words


def clock(time: float, mark: str) -> str:
    return f"{int(time) // 3600:02d}:{int(time) // 60 % 60:02d}:{time % 60:06.3f}".replace(".", mark)


def cues(words, mark: str, label: str = "") -> str:
    return "".join(f"{clock(a, mark)} --> {clock(b, mark)}\n{label}{text}\n\n" for text, a, b in words)


def rows(words, names: str, row: str) -> str:
    """Return a table of rows in the format `row`, of a text, its start and end in seconds and in milliseconds."""
    return names + "".join(row.format(t=t, a=a, b=b, A=ms(a), B=ms(b), D=ms(b) - ms(a)) + "\n" for t, a, b in words)


def ms(time: float) -> int:
    return round(1000 * time)


DIALECTS = {
    "whispercpp.json": lambda w: {
        "transcription": [{"offsets": {"from": ms(a), "to": ms(b)}, "text": f" {t}"} for t, a, b in w]},
    "transformers.json": lambda w: {"chunks": [{"text": f" {t}", "timestamp": [a, b]} for t, a, b in w]},
    "mfa.json": lambda w: {"tiers": {
        "words": {"entries": [[a, b, t] for t, a, b in w]}, "phones": {"entries": [[0, 9, "AH"]]}}},
    "vosk.json": lambda w: [{"text": ""}, *({"result": [{"word": t, "start": a, "end": b}]} for t, a, b in w)],
    "deepgram.json": lambda w: {"results": {"channels": [{"alternatives": [
        {"words": [{"word": t, "start": a, "end": b, "confidence": 1} for t, a, b in w]}]}]}},
    "aws.json": lambda w: {"results": {"items": [
        *({"start_time": f"{a}", "end_time": f"{b}", "alternatives": [{"content": t}]} for t, a, b in w),
        {"type": "punctuation", "alternatives": [{"content": "."}]}]}},
    "google.json": lambda w: {"results": [{"alternatives": [
        {"words": [{"startTime": f"{a}s", "endTime": f"{b}s", "word": t} for t, a, b in w]}]}]},
    "azure.json": lambda w: {"phrases": [
        {"text": t, "offsetMilliseconds": ms(a), "durationMilliseconds": ms(b) - ms(a)} for t, a, b in w]},
    "assemblyai.json": lambda w: {"words": [{"text": t, "start": ms(a), "end": ms(b)} for t, a, b in w]},
    "list.json": lambda w: [{"text": t, "start": a, "duration": b - a} for t, a, b in w],
    "audacity.txt": lambda w: rows(w, "", "{a:.6f}\t{b:.6f}\t{t}\n\\\t100.0\t2000.0"),
    "whisper.txt": lambda w: rows(w, "start\tend\ttext\n", "{A}\t{B}\t{t}"),
    "units.csv": lambda w: rows(w, "Speaker,Word,Duration (ms),start_s\n", "A,{t},{D},{a}"),
    "commas.csv": lambda w: rows(w, "text;end;start\n", "{t};{b};{a}").replace(".", ","),
    "mfa.csv": lambda w: rows(w, "Begin,End,Label,Type\n0,1,AH,phones\n", "{a},{b},{t},words"),
    "labels.srt": lambda w: cues(w, ",", "Jordan Rivers: "),
    "voices.txt": lambda w: "WEBVTT\n\n" + cues(w, ".", "<v Jordan Rivers>"),
    "long.txt": lambda w: text_grid(('the ""best"" words', [(a, b, t) for t, a, b in w])),
    "short.TextGrid": lambda w: short_form(text_grid(('words ""A""', [(a, b, t) for t, a, b in w]))),
}  # fmt: skip


@st.composite
def transcripts(draw) -> list[tuple[str, float, float]]:
    """Draw words of 0.3 to 2 s, at whole milliseconds, after pauses of up to 3 s."""
    time, words = 0, []
    for text in draw(st.lists(st.text("abcdefgh", min_size=1, max_size=9), min_size=1, max_size=6)):
        start = time + draw(st.integers(0, 3_000))
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

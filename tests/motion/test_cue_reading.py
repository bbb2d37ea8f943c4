"""Cues are read from JSON and from subtitles, and a mistake is one line that says what there is."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.features.words import read_words
from ha2g_jax.motion import cues
from ha2g_jax.motion.cues import Cue, reading

TALK = """1
00:00:01,000 --> 00:00:02,000
There are [count:3] three

2
00:00:02,000 --> 00:00:03,000
JOHN: well [open] [nod]

[Music]

3
00:00:05,000 --> 00:00:06,000
[point:left]

4
00:00:09,000 --> 00:00:10,000
[wave:right] Bye
"""


def test_a_marker_belongs_to_the_word_after_it_else_to_the_one_before(tmp_path):
    (tmp_path / "talk.srt").write_text(TALK)
    words = {word.text: word.start for word in read_words(tmp_path / "talk.srt")}
    assert list(words) == ["there", "are", "three", "well", "bye"]  # no marker is spoken
    read = reading.read_cues(tmp_path / "talk.srt")
    assert [cue.name for cue in read] == ["count:3", "open", "nod", "point:left", "wave"]
    assert [cue.time for cue in read] == [words["three"], words["well"], words["well"], 5.0, words["bye"]]


def test_a_cue_alone_in_a_subtitle_peaks_at_its_beginning_without_a_gap_behind_it(tmp_path):
    (tmp_path / "a.srt").write_text(
        "1\n00:00:01,000 --> 00:00:05,000\n[wave]\n\n2\n00:00:05,000 --> 00:00:07,000\nhello [nod] everyone\n"
    )
    wave, nod = reading.read_cues(tmp_path / "a.srt")
    assert (wave.name, wave.time) == ("wave", 1) and 5 < (nod.time or 0) < 7


@pytest.mark.parametrize("line", ["<i>[wave]</i>", "[wave] [Music]", "BOB: [wave]", "{\\an8}[wave]"])
def test_a_cue_is_alone_beside_tags_sounds_and_a_label(line, tmp_path):
    text = "1\n00:00:01,000 --> 00:00:05,000\nBOB: well\n\n2\n00:00:05,000 --> 00:00:07,000\n{}\n\n"
    text += "3\n00:00:07,000 --> 00:00:09,000\nBOB: hello <i>you</i>\n"
    (tmp_path / "a.srt").write_text(text.format(line))
    (wave,) = reading.read_cues(tmp_path / "a.srt")
    assert wave.time == 5


def test_the_beginning_of_a_subtitle_is_that_of_its_own_cues_alone(tmp_path):
    (tmp_path / "a.srt").write_text(
        "1\n00:00:00,000 --> 00:00:04,000\n[nod]\n\n2\n00:00:01,000 --> 00:00:03,000\nhello there [wave] friend\n"
    )
    nod, wave = sorted(reading.read_cues(tmp_path / "a.srt"), key=lambda cue: cue.name)
    assert nod.time == 0 and 2 < (wave.time or 0) < 3


def test_a_cue_after_the_last_word_stays_there_before_a_subtitle_of_cues_alone(tmp_path):
    (tmp_path / "a.srt").write_text(
        "1\n00:00:01,000 --> 00:00:03,000\nthat is all of them [nod]\n\n2\n00:00:03,000 --> 00:00:06,000\n[shrug]\n\n"
        "3\n00:00:06,000 --> 00:00:07,000\nyes\n"
    )
    nod, shrug = sorted(reading.read_cues(tmp_path / "a.srt"), key=lambda cue: cue.name)
    assert 2 < (nod.time or 0) < 3 and shrug.time == 3


def test_a_cue_is_at_the_word_after_it_however_many_others_the_subtitle_has(tmp_path):
    text = "1\n00:00:00,000 --> 00:00:08,000\nwe have seen it all {} so {} go {} on\n"
    (tmp_path / "a.srt").write_text(text.format("[nod]", "[shrug]", "[wave]"))
    (tmp_path / "plain.srt").write_text(text.format("", "", ""))
    starts = {word.text: word.start for word in read_words(tmp_path / "plain.srt")}
    found = {cue.name: cue.time for cue in reading.read_cues(tmp_path / "a.srt")}
    assert found == {"nod": starts["so"], "shrug": starts["go"], "wave": starts["on"]}


def test_a_cue_where_nothing_is_spoken_is_refused(tmp_path):
    (tmp_path / "a.srt").write_text("1\n00:00:01,000 --> 00:00:05,000\n[nod] one (quietly [wave] here) you\n")
    with pytest.raises(UserError, match=r"has the cue \[wave\] where nothing is spoken"):
        reading.read_cues(tmp_path / "a.srt")


def test_cues_in_subtitles_count_from_the_beginning_of_the_video(tmp_path, monkeypatch):
    """Its sound, from which a motion counts, begins two seconds later."""
    monkeypatch.setattr(reading, "sound_delay", lambda media: 2.0)
    (tmp_path / "talk.srt").write_text(TALK)
    plain, late = (reading.read_cues(tmp_path / "talk.srt", media) for media in (None, tmp_path / "talk.mp4"))
    assert [cue.time for cue in late] == [max((cue.time or 0) - 2, 0) for cue in plain]


def test_timed_words_of_a_vtt_keep_their_times(tmp_path):
    text = "WEBVTT\n\n00:01.000 --> 00:04.000\nso<00:01.500><c> [clip:a b.bvh] today</c><00:02.500><c> we [bow]</c>\n"
    (tmp_path / "talk.vtt").write_text(text)
    assert reading.read_cues(tmp_path / "talk.vtt") == (Cue("clip:a b.bvh", 1.5), Cue("bow", 2.5))


def test_lines_of_json_have_times_or_words(tmp_path):
    lines = ['{"cue": "count:3:right", "time": 1.2}', "", '{"cue": "nod", "word": "Three"}']
    (tmp_path / "talk.jsonl").write_text("\n".join(lines))
    read = reading.read_cues(tmp_path / "talk.jsonl")
    assert read == (Cue("count:3", 1.2), Cue("nod", None, "three"))
    placed = cues.place(read, [Word("two", 0.5, 1.0), Word("three", 1.5, 2.0)])
    assert [cue.time for cue in placed] == [1.2, 1.5]
    assert [reading.read_cue(json.dumps(one)) for one in cues.describe(read)] == list(read)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.srt", TALK.replace("[open]", "[jump]"), "no cue 'jump'; expected nod, shake, bow"),
        ("a.srt", TALK.replace("[", "("), "has no cues"),
        ("a.srt", "[nod] hello", "no subtitles with times"),
        ("a.jsonl", '{"cue": "nod"}', "line 1: the cue nod has neither a time nor a word"),
        ("a.jsonl", '{"cue": "nod", "time": 1}\n{"cue": "nod", "at": 1}', "line 2: a cue has no 'at'"),
        ("a.txt", "[nod] hello", "expected one of .srt, .vtt, .jsonl"),
    ],
)
def test_a_mistake_in_a_file_is_one_line(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        reading.read_cues(tmp_path / name)
    assert "\n" not in str(caught.value)


_NAMES = st.sampled_from(["nod", "count:3", "count:9", "clip:x.npz", "", "point"]) | st.text(max_size=9)
_VALUES = st.none() | st.booleans() | st.floats() | st.integers() | _NAMES | st.lists(st.integers(), max_size=2)
_MESSAGES = st.fixed_dictionaries({"cue": _NAMES | _VALUES}, optional={"time": _VALUES, "word": _VALUES, "x": _VALUES})


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=60) | _MESSAGES.map(json.dumps))
def test_any_text_is_a_cue_or_one_line(text):
    try:
        cue = reading.read_cue(text)
    except UserError as error:
        assert "\n" not in str(error) and len(str(error)) < 400
    else:
        assert cue.name in cues.NAMES
        assert cue.time is None or cue.time >= 0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.sampled_from(["[nod]", "[", "]", "[count:", "hello", "\n", "00:01.000 --> 00:02.000", "JOE:"])))
def test_any_subtitles_are_cues_or_one_line(tmp_path_factory, parts):
    path = tmp_path_factory.mktemp("cues") / "talk.vtt"
    path.write_text("WEBVTT\n\n00:00.000 --> 00:01.000\n" + " ".join(parts))
    try:
        assert all(cue.name == "nod" for cue in reading.read_cues(path))
    except UserError as error:
        assert "\n" not in str(error)

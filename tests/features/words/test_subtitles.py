"""Subtitles that time every word in ways of their own."""

import pytest

from ha2g_jax.features import words as transcripts
from ha2g_jax.features.words import labels
from ha2g_jax.features.words.timing import Stretch, split_words

# YouTube puts lines of one blank, here ~, into its cues: they do not end them.
YOUTUBE = """WEBVTT
Kind: captions
Language: en

00:00:01.000 --> 00:00:03.000 align:start position:0%
~
so<00:00:01.400><c> good</c><00:00:02.000><c> morning</c>

00:00:03.000 --> 00:00:03.010 align:start position:0%
so good morning
~

00:00:03.010 --> 00:00:09.000 align:start position:0%
so good morning
everyone<00:00:04.000><c> here</c>

00:00:09.000 --> 00:00:09.010 align:start position:0%
everyone here
~

00:00:09.010 --> 00:00:10.000 align:start position:0%
everyone here
yes
"""

HIGHLIGHTED = """1
00:00:01,000 --> 00:00:01,400
<u>So</u> good morning

2
00:00:01,400 --> 00:00:02,000
So <u>good</u> morning

3
00:00:02,000 --> 00:00:02,100
So good morning

4
00:00:02,100 --> 00:00:03,000
So good <u>morning</u>
"""


def test_youtube(tmp_path):
    """Each word once, with its own start; the last of a line does not last through the pause after it."""
    path = tmp_path / "a.en.vtt"
    path.write_text(YOUTUBE.replace("~", " "))
    words = transcripts.read_words(path)
    assert [word.text for word in words] == ["so", "good", "morning", "everyone", "here", "yes"]
    assert [word.start for word in words] == pytest.approx([1.0, 1.4, 2.0, 3.01, 4.0, 9.01])
    assert words[4].end == pytest.approx(4.7)


def test_rolling_lines_are_read_once(tmp_path):
    """YouTube's automatic captions as other programs convert them to SubRip, without times of words."""
    lines = ["hello my friend", "how are you", "i am well"]
    shown = [lines[:1], lines[:1], lines[:2], lines[1:2], lines[1:3], lines[2:]]
    times = [(0.0, 2.0), (2.0, 2.01), (2.01, 4.0), (4.0, 4.01), (4.01, 6.0), (6.0, 6.01)]
    clock = "00:00:{:06.3f}".format
    text = "\n\n".join(
        f"{number}\n{clock(start)} --> {clock(end)}\n".replace(".", ",") + "\n".join(rows)
        for number, ((start, end), rows) in enumerate(zip(times, shown, strict=True), start=1)
    )
    (tmp_path / "a.srt").write_text(text)
    words = transcripts.read_words(tmp_path / "a.srt")
    assert [word.text for word in words] == " ".join(lines).split()
    assert [word.start for word in words if word.text in ("hello", "how", "i")] == pytest.approx([0, 2.01, 4.01])


def test_highlighted_words(tmp_path):
    """Whisper's --highlight_words repeats the line for each of its words."""
    path = tmp_path / "a.srt"
    path.write_text(HIGHLIGHTED)
    words = transcripts.read_words(path)
    assert [tuple(word) for word in words] == [("so", 1.0, 1.4), ("good", 1.4, 2.0), ("morning", 2.1, 3.0)]


def test_underlining_alone_is_style(tmp_path):
    """A line with an emphasised word is spoken whole."""
    path = tmp_path / "a.srt"
    path.write_text(HIGHLIGHTED[: HIGHLIGHTED.index("2\n")])
    assert [word.text for word in transcripts.read_words(path)] == ["so", "good", "morning"]


@pytest.mark.parametrize(
    ("raw", "spoken"),
    [
        ("JOHN: Hello", " Hello"),
        (">> DR. WHO: hello", " hello"),
        ("- Speaker 1: Hi\n- there", " Hi\nthere"),
        ("[SPEAKER_00]: Hi", "hi"),
        ("Remember: It is late", "Remember: It is late"),
        ("he said: Go\nThings I like: tea", "he said: Go\nThings I like: tea"),
        ("Jordan Rivers: two", "two"),
        ("Dr. Jean-Luc van der Berg: hi", "hi"),
        ("José: Hola", "Hola"),
        ("Мария Иванова: привет", "привет"),
        ("(Mary Ann): yes\n>> so", "yes so"),
        ("I met my friend\nJordan: the best", "I met my friend\nJordan: the best"),
        ("hello. >> MARY: yes", "hello yes"),
        ("- Mary: hi\n- Bob: so", "hi so"),
        ("[00:03] Mary O'Brien: hi", "hi"),
        ("<v.loud Mary>hi", "hi"),
        ("MARY:hi", "hi"),
        ("田中：はい", "はい"),
        ("At 12:30: go, http://a.b", "At 12:30: go, http://a.b"),
        ("[tense music\nplaying] {\\k20}hel{\\k30}lo\\Nyou", "hello you"),
        ('<font color="red">A &amp; B</font> (laughs)', "A & B"),
    ],
)
def test_labels_and_sounds_are_not_spoken(raw, spoken):
    words = " ".join(stretch.text for stretch in labels.spoken([Stretch(raw, 0, 1)], 1))
    assert words.split() == split_words(spoken)


@pytest.mark.parametrize(
    ("cues", "names"),
    [
        (["so we go", "Paris: the city", "more", "yet more"], set()),
        (["Mary: hello", "more", "yet more", "and", "Mary: again"], {"Mary"}),
        (["Mary: hello", "Mary: so", "José: hola"], {"Mary", "José"}),
        (["At 10: we go", "Step 1: do it", "Speaker 2: hm", "spk_0: hm"], {"Speaker 2", "spk_0"}),
        (["mary: hi", "bob: so", "mary: yes", "bob: no"], {"mary", "bob"}),
        (["Mary: hi", "Bob: so"], {"Mary", "Bob"}),
        (["so", "we", "go", "on", "on", "Star Wars: A New Hope"], set()),
        (["so", "P1: go", "on", "on", "on", "JOHN: go"], {"P1", "JOHN"}),
        (["Remember:", "Paris:", "so", "Paris:", "on"], set()),
        (["REMEMBER: IT IS", "THE WEATHER: RAIN", "AND SO ON", "ON", "ON"], set()),
    ],
)
def test_labels_of_a_file(cues, names):
    assert labels.find_labels([[cue] for cue in cues]) == names


def test_quadratic_time_is_out_of_reach(tmp_path):
    """Long runs of blanks, of lone digits or of arrows are read in one pass; it would take hours otherwise."""
    path = tmp_path / "a.srt"
    for filler in (" " * 300_000, "\n" * 300_000, "1 " * 90_000, "1\n" * 150, "1:2:3,4 --> " * 20_000):
        path.write_text(subtitles_with(filler))
        words = transcripts.read_words(path)
        assert words[0].text == "hello"


def subtitles_with(filler: str) -> str:
    return f"1\n00:00:01,000 --> 00:00:02,000\nhello\n{filler}\n"


def test_unreadable_cues_are_reported(tmp_path, caplog):
    path = tmp_path / "a.vtt"
    path.write_text("WEBVTT\n\n00:01.000 --> 00:02.000\nhello\n\n00:x2.000 --> 00:03.000\nlost\n")
    assert [word.text for word in transcripts.read_words(path)] == ["hello"]
    assert "1 of 2 cues cannot be read" in caplog.text


def test_brackets_are_found_as_the_first_that_closes():
    assert labels.without_brackets("a (b [c) d] e", "[(", "-") == "a - d] e"
    assert labels.without_brackets("(" + "x" * 200 + ")y(" + "x" * 201 + ")", "(", "") == "y(" + "x" * 201 + ")"
    assert labels.without_brackets("<a\n> <b>", "<", "") == "<a\n> "


def test_two_highlighted_words_are_each_read_once(tmp_path):
    """A line of two words is shown twice, as with --max_words_per_line 2."""
    path = tmp_path / "a.srt"
    cues = ["<u>so</u> good", "so <u>good</u>", "<u>we</u> go", "we <u>go</u>"]
    path.write_text("".join(f"{n}\n00:00:0{n},000 --> 00:00:0{n + 1},000\n{cue}\n\n" for n, cue in enumerate(cues, 1)))
    assert [word.text for word in transcripts.read_words(path)] == ["so", "good", "we", "go"]


@pytest.mark.parametrize("cue", ["<00:00:{:02}.100>yes", "no<00:00:{:02}.500><c> no</c>"])
def test_what_is_said_twice_is_read_twice(cue, tmp_path):
    """A line with times of its own was spoken; only one without may be that above it."""
    path = tmp_path / "a.vtt"
    path.write_text(
        "WEBVTT\n\n" + "".join(f"00:00:{s:02}.000 --> 00:00:{s + 1:02}.000\n{cue.format(s)}\n\n" for s in (1, 2, 30))
    )
    words = [word.text for word in transcripts.read_words(path)]
    assert len(words) == 3 * (1 + cue.startswith("no")) and set(words) <= {"yes", "no"}


def test_times_before_the_beginning_are_those_of_a_shifted_file(tmp_path):
    (tmp_path / "a.srt").write_text(
        "1\n-00:00:02,500 --> -00:00:01,000\ngone\n\n2\n-00:00:00,500 --> 00:00:01,000\nfirst\n\n"
        "3\n00:00:01,000 --> 00:00:02,000\nsecond\n"
    )
    words = transcripts.read_words(tmp_path / "a.srt")
    assert [(word.text, word.start, word.end) for word in words] == [("first", 0, 1), ("second", 1, 2)]

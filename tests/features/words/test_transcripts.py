"""The transcript of a recording is found by rules; every format gives the same words, a hostile file one line."""

import itertools
import json
import os
import resource
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts

# As to_words must give them, whatever the format.
WORDS = [("old", 0.5, 0.9), ("ladies", 0.9, 1.5), ("it's", 2.0, 2.25), ("80", 2.25, 2.5)]

LONG_GRID = """File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 3
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "IntervalTier"
        name = "phones"
        xmin = 0
        xmax = 3
        intervals: size = 1
        intervals [1]:
            xmin = 0
            xmax = 3
            text = "AH"
    item [2]:
        class = "IntervalTier"
        name = "S1 - words"
        xmin = 0
        xmax = 3
        intervals: size = 6
        intervals [1]:
            xmin = 0
            xmax = 0.5
            text = ""
        intervals [2]:
            xmin = 0.5
            xmax = 0.9
            text = "Old"
        intervals [3]:
            xmin = 0.9
            xmax = 1.5
            text = "ladies,"
        intervals [4]:
            xmin = 1.5
            xmax = 2.0
            text = "<sil>"
        intervals [5]:
            xmin = 2.0
            xmax = 2.25
            text = "it’s"
        intervals [6]:
            xmin = 2.25
            xmax = 2.5
            text = "80"
"""
SHORT_GRID = """File type = "ooTextFile"
Object class = "TextGrid"

0
3
<exists>
1
"IntervalTier"
"ORT"
0
3
6
0
0.5
""
0.5
0.9
"Old"
0.9
1.5
"ladies,"
1.5
2
"sp"
2
2.25
"it's"
2.25
2.5
"80"
"""
GENTLE = {
    "transcript": "Old ladies, uh it's 80",
    "words": [
        {"case": "success", "alignedWord": "old", "word": "Old", "start": 0.5, "end": 0.9},
        {"case": "success", "alignedWord": "ladies", "word": "ladies", "start": 0.9, "end": 1.5},
        {"case": "success", "alignedWord": "it's", "word": "it's", "start": 2.0, "end": 2.25},
        {"case": "success", "alignedWord": "<unk>", "word": "80", "start": 2.25, "end": 2.5},
    ],
}
TIMED = [{"word": f" {text}", "start": start, "end": end, "probability": 0.9} for text, start, end in WORDS]
WHISPER = {"text": "...", "language": "en", "segments": [{"start": 0.5, "end": 2.5, "text": "...", "words": TIMED}]}
WHISPERX = {
    "segments": [
        {"start": 0.5, "end": 1.5, "text": "Old ladies,", "words": TIMED[:2]},
        {"start": 2.0, "end": 2.5, "text": "it's 80", "words": [TIMED[2], {"word": "80"}]},
    ],
    "word_segments": TIMED,
}
OPENAI = {"segments": [{"start": 0.5, "end": 2.5, "text": "Old ladies, it's 80"}], "words": TIMED}
SRT = """1
00:00:00,500 --> 00:00:00,900
<i>Old</i>

2
00:00:00,900 --> 00:00:01,500
MARY: ladies, (laughs)

3
00:00:02,000 --> 00:00:02,250
{\\an8}- it's

4
00:00:02,250 --> 00:00:02,500
80 [music]
"""
VTT = """WEBVTT - a talk

NOTE nothing

00:00.500 --> 00:00.900 align:start
<v Mary>Old</v>

two
00:00:00.900 --> 00:00:01.500
<c.yellow>ladies</c>, &lrm;

00:00:02.000 --> 00:00:02.250
it&#39;s

00:00:02.250 --> 00:00:02.500
80
"""
TSV = "word\tend\tstart\nOld\t0.9\t0.5\nladies,\t1.5\t0.9\nit's\t2.25\t2.0\n80\t2.5\t2.25\n"
CSV = 'start,end,text\n0.5,0.9,Old\n0.9,1.5,"ladies,"\n2.0,2.25,it\'s\n2.25,2.5,80\n'
WHISPER_TSV = "start\tend\ttext\n500\t900\tOld\n900\t1500\tladies,\n2000\t2250\tit's\n2250\t2500\t80\n"
NO_HEADER = "0.5\t0.9\tOld\n0.9\t1.5\tladies,\n2.0\t2.25\tit's\n2.25\t2.5\t80\n"

FILES = {
    "long.TextGrid": LONG_GRID.encode(),
    "long16.TextGrid": LONG_GRID.encode("utf-16"),
    "dos.TextGrid": LONG_GRID.replace("\n", "\r\n").encode("utf-8-sig"),
    "short.TextGrid": SHORT_GRID.encode(),
    "gentle.json": json.dumps(GENTLE).encode(),
    "whisper.json": json.dumps(WHISPER).encode(),
    "whisperx.json": json.dumps(WHISPERX).encode(),
    "words_only.json": json.dumps({"word_segments": TIMED}).encode(),
    "openai.json": json.dumps(OPENAI).encode(),
    "a.srt": SRT.encode(),
    "dos.srt": SRT.replace("\n", "\r\n").encode("utf-8-sig"),
    "a.vtt": VTT.encode(),
    "misnamed.srt": VTT.encode(),
    "a.tsv": TSV.encode(),
    "a.csv": CSV.encode(),
    "whisper.tsv": WHISPER_TSV.encode(),
    "bare.tsv": NO_HEADER.encode(),
}


def check(words):
    """What every reader promises of its words."""
    assert words
    for word in words:
        assert word.text == word.text.lower() and word.text.strip() == word.text != ""
        assert 0 <= word.start < word.end < 1e6
    assert all(before.end <= after.start + 1e-9 for before, after in itertools.pairwise(words))


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_words(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(FILES[name])
    words = transcripts.read_words(path)
    check(words)
    assert [word.text for word in words] == [text for text, _, _ in WORDS]
    times = [time for word in words for time in (word.start, word.end)]
    assert times == pytest.approx([time for _, *pair in WORDS for time in pair], abs=1e-6)


@pytest.mark.parametrize("folder", ["zeroeggs_067", "zeroeggs_neutral_001"])
def test_genuine_textgrids(private_data, folder):
    """The same words within a millisecond as in the tables that come with them."""
    [grid] = (private_data / folder).glob("*.TextGrid")
    words, reference = transcripts.read_words(grid), transcripts.read_words(private_data / folder / "words.tsv")
    check(words)
    assert len(words) > 100
    assert [word.text for word in words] == [word.text for word in reference]
    for word, true in zip(words, reference, strict=True):
        assert word.start == pytest.approx(true.start, abs=1e-3) and word.end == pytest.approx(true.end, abs=1e-3)


def test_words_without_times(tmp_path):
    """Gentle: laid into the gap if it fits there, else left out. whisperX: always spoken. A segment: spread."""
    path = tmp_path / "a.json"
    missed = {"case": "not-found-in-audio", "word": "dear"}
    path.write_text(
        json.dumps({"words": [*GENTLE["words"][:1], missed, GENTLE["words"][1], missed, GENTLE["words"][2]]})
    )
    words = transcripts.read_words(path)
    assert [word.text for word in words] == ["old", "ladies", "dear", "it's"]
    assert words[2].start == pytest.approx(1.5) and words[2].end == pytest.approx(2.0)
    segment = {
        "start": 0.0,
        "end": 1.0,
        "text": "",
        "words": [{"word": "in", "start": 0, "end": 1.0}, {"word": "1999."}],
    }
    path.write_text(json.dumps({"segments": [segment]}))
    assert [word.text for word in transcripts.read_words(path)] == ["in", "1999"]
    path.write_text(json.dumps({"segments": [{"start": 1.0, "end": 2.0, "text": " Ab, cdef [music] gh?"}]}))
    words = transcripts.read_words(path)
    assert [tuple(word) for word in words] == [("ab", 1.0, 1.25), ("cdef", 1.25, 1.75), ("gh", 1.75, 2.0)]


def test_word_tier(tmp_path):
    """Without a tier of that name the one with most labels, phones aside; phones alone are refused."""
    path = tmp_path / "a.TextGrid"
    path.write_text(LONG_GRID.replace("S1 - words", "Mary"))
    assert [word.text for word in transcripts.read_words(path)] == [text for text, _, _ in WORDS]
    path.write_text(SHORT_GRID.replace('"ORT"', '"phones"'))
    with pytest.raises(UserError, match=r"no interval tier with words \(tiers: 'phones'\)"):
        transcripts.read_words(path)


HOSTILE = {
    "empty.srt": (b"", "empty file"),
    "blank.vtt": (b" \n\n", "white space"),
    "binary.tsv": (bytes(range(256)), "not text|binary"),
    "nul.srt": (b"1\n\0\0", "binary"),
    "cut16.TextGrid": (LONG_GRID.encode("utf-16")[:-1], "not valid utf-16"),
    "cut.json": (json.dumps(WHISPER).encode()[:-9], "damaged JSON"),
    "deep.json": (b'{"segments":' + b"[" * 100_000, "nested too deep"),
    "other.json": (b'{"a": 1}', "without `segments` or `words`"),
    "list.json": (b"[1]", "not JSON of Gentle"),
    "number.json": (b'{"segments":[{"start":' + b"1" * 5000 + b"}]}", "not JSON of Gentle"),
    "nan.json": (b'{"segments":[{"start":NaN,"end":2,"text":"a"}]}', "the times nan to 2 s"),
    "string.json": (b'{"segments":[{"start":"1","end":2,"text":"a"}]}', "not a number"),
    "huge.tsv": (b"start\tend\tword\n0\t1e300\ta\n", "0 to 1e.300 s"),
    "infinite.tsv": (b"start\tend\tword\n0\tinf\ta\n", "0 to inf s"),
    "reversed.tsv": (b"start\tend\tword\n2\t1\ta\n", "2 to 1 s"),
    "columns.tsv": (b"a\tb\tc\n1\t2\tw\n", "expected start, end and word"),
    "row.tsv": (b"start\tend\tword\n1\t2\n", "line 2, has 2 columns instead of 3"),
    "number.tsv": (b"start\tend\tword\n1\tx\tw\n", "line 2, has a time that is not a number"),
    "quote.csv": (b'start,end,word\n1,2,"w\n', "is damaged"),
    "million.TextGrid": (LONG_GRID.replace("size = 6", "size = 1000000000").encode(), "declares 1000000000 intervals"),
    "million2.TextGrid": (SHORT_GRID.replace("\n6\n", "\n1000000000\n").encode(), "declares 1000000000 intervals"),
    "cut.TextGrid": (LONG_GRID[:-12].encode(), "damaged TextGrid"),
    "cut2.TextGrid": (LONG_GRID[: LONG_GRID.index("    item [2]")].encode(), "declares 2 tiers but has 1"),
    "cut3.TextGrid": (
        LONG_GRID[: LONG_GRID.index("        intervals [5]")].encode(),
        "declares 6 intervals but has 4",
    ),
    "cut4.TextGrid": (SHORT_GRID[: SHORT_GRID.index("2.25\n2.5")].encode(), "declares 6 intervals but has 5"),
    "quotes.TextGrid": ((LONG_GRID + 'text = "x' * 100_000).encode(), "a label of more than"),
    "other.TextGrid": (b"hello", "not a TextGrid"),
    "words.txt": (b"hello there", "or a text together with its audio"),
    "words.docx": (b"hello there", "expected one of .TextGrid"),
    "other.srt": (b"hello there", "not valid SubRip"),
    "digits.srt": (b"1" * 1_000_000, "more than 30 digits"),
    "late.srt": (b"1\n9" + b"9" * 20 + b":00:01,0 --> 00:00:02,0\na\n", "not valid SubRip"),
    "none.vtt": (b"WEBVTT\n\n00:00:01,000 --> 00:00:02,000\nhello\n", "no words with times"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files(tmp_path, name):
    """One line: the file, what was found, what to do."""
    data, message = HOSTILE[name]
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(UserError, match=message) as caught:
        transcripts.read_words(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "talk.tsv")
    with pytest.raises(UserError, match=r"talk\.tsv is not a file"):
        transcripts.read_words(tmp_path / "talk.tsv")


def test_a_gigabyte_is_not_read(tmp_path):
    path = tmp_path / "a.srt"
    with path.open("wb") as file:
        file.truncate(1 << 30)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match=r"a\.srt is larger than 16 MiB"):
        transcripts.read_words(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 10 * limits.MAX_TRANSCRIPT_BYTES / 1024
    with pytest.raises(UserError, match="no file at"):
        transcripts.read_words(tmp_path / "missing.srt")


@pytest.mark.parametrize(
    "name", ["long.TextGrid", "short.TextGrid", "gentle.json", "whisperx.json", "a.srt", "a.vtt", "a.tsv"]
)
def test_fuzz(tmp_path_factory, name):
    """Bytes at random, and genuine files with bytes changed, cut or doubled: words as promised, or a UserError."""
    path = tmp_path_factory.mktemp("fuzz") / name
    genuine = FILES[name]
    outcomes = {"words": 0, "refused": 0}

    @settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
    @given(
        st.one_of(
            st.binary(max_size=300),
            st.tuples(st.integers(0, len(genuine)), st.integers(0, 9), st.binary(max_size=6)).map(
                lambda change: genuine[: change[0]] + change[2] + genuine[change[0] + change[1] :]
            ),
            st.integers(1, len(genuine)).map(lambda size: genuine[:size]),
        )
    )
    def read(data):
        path.write_bytes(data)
        try:
            words = transcripts.read_words(path)
        except UserError as error:
            assert str(path) in str(error) and "\n" not in str(error)
            outcomes["refused"] += 1
        else:
            check(words)
            outcomes["words"] += 1

    read()
    assert min(outcomes.values()) > 0, outcomes


@pytest.mark.parametrize("text", [",,,\n,,,\n", ",,\n"])
def test_a_table_without_rows_is_refused(tmp_path, text):
    """It must not end the import of the other files."""
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UserError, match=r"a\.csv has no rows; expected start, end and word"):
        transcripts.read_words(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["a.TextGrid", "a.b.tsv", "words.tsv"], "a.b.tsv"),  # the longer stem is nearer
        (["a.srt", "a.json", "a.textgrid", "a.txt"], "a.textgrid"),
        (["a.vtt", "a.txt"], "a.vtt"),
        (["a.en.vtt", "words.tsv"], "a.en.vtt"),
        (["a.info.json", "a.txt"], "a.txt"),
        (["ab.tsv", "words.tsv"], "words.tsv"),
        (["words.tsv", "words.TextGrid"], None),
        (["ab.tsv", "a.md"], None),
        ([], None),
    ],
)
def test_the_transcript_of_a_recording_is_found_by_rules(tmp_path, names, found):
    for name in names:
        (tmp_path / name).write_text("x")
    (tmp_path / "a.dir.tsv").mkdir()
    expected = found and tmp_path / found
    assert transcripts.find(tmp_path / "a.b.bvh") == expected


def test_no_transcript_in_a_folder_that_is_missing(tmp_path):
    assert transcripts.find(tmp_path / "missing" / "a.wav") is None


def test_the_transcripts_of_genuine_recordings_are_found(private_data):
    found = transcripts.find(private_data / "zeroeggs_067" / "067_Speech_2_x_1_0.mixamo.bvh")
    assert found is not None and found.name == "067_Speech_2_x_1_0.TextGrid"
    assert transcripts.find(private_data / "video" / "sample.mp4") == private_data / "video" / "words.tsv"


def test_a_transcript_needs_no_synthesiser_and_no_reader_of_another_format(tmp_path):
    (tmp_path / "a.tsv").write_bytes(FILES["a.tsv"])
    others = ("srt", "webvtt", "praatio", "espeakng_loader", "pocketsphinx")
    code = f"""import pathlib, sys; from ha2g_jax.features import words; words.read_words(pathlib.Path('a.tsv'))
print([name for name in {others} if name in sys.modules])"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize(
    ("name", "module", "package"),
    [
        ("a.srt", "srt", "srt"),
        ("a.vtt", "webvtt", "webvtt-py"),
        ("short.TextGrid", "praatio.utilities.textgrid_io", "praatio"),
    ],
)
def test_a_format_whose_package_is_missing_names_the_extra(tmp_path, monkeypatch, name, module, package):
    (tmp_path / name).write_bytes(FILES[name])
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UserError, match=rf"{name} .* needs {package}: pip install 'ha2g-jax\[import\]'"):
        transcripts.read_words(tmp_path / name)

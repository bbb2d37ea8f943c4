"""The transcript of a recording is found by rules; every format gives the same words, a hostile file one line."""

import json
import resource
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from fixtures.motions import swaying
from fixtures.transcripts import FILES, GENTLE, LONG_GRID, SHORT_GRID, WORDS, check_words, text_grid
from fixtures.videos import make_video

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.motion import formats


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_words(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(FILES[name])
    words = transcripts.read_words(path)
    check_words(words)
    assert [word.text for word in words] == [text for text, _, _ in WORDS]
    times = [time for word in words for time in (word.start, word.end)]
    assert times == pytest.approx([time for _, *pair in WORDS for time in pair], abs=1e-6)


@pytest.mark.parametrize("folder", ["zeroeggs_067", "zeroeggs_neutral_001"])
def test_genuine_textgrids(private_data, folder):
    """The same words within a millisecond as in the tables that come with them."""
    [grid] = (private_data / folder).glob("*.TextGrid")
    words, reference = transcripts.read_words(grid), transcripts.read_words(private_data / folder / "words.tsv")
    check_words(words)
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
    "binary.tsv": (bytes(range(256)), "not text|binary"),
    "cut16.TextGrid": (LONG_GRID.encode("utf-16")[:-1], "not valid utf-16"),
    "deep.json": (b'{"segments":' + b"[" * 100_000, "nested too deep"),
    "nan.json": (b'{"segments":[{"start":NaN,"end":2,"text":"a"}]}', "the times nan to 2 s"),
    "reversed.tsv": (b"start\tend\tword\n2\t1\ta\n", "2 to 1 s"),
    "row.txt": (b"0.1\t0.2\ta\n0.2\t0.3\tb\n0.3\tc\n", "line 3, has 2 columns instead of 3"),
    "row.tsv": (b"start\tend\tword\n1\t2\n", "line 2, has 2 columns instead of 3"),
    "million.TextGrid": (LONG_GRID.replace("size = 6", "size = 1000000000").encode(), "declares 1000000000 intervals"),
    "words.docx": (b"hello there", "expected one of .TextGrid"),
    "digits.srt": (b"1" * 1_000_000, "no subtitles with times"),
    "header.tsv": (b"start\tend\tword\n", "no words with times"),
    "none.vtt": (b"WEBVTT\n\n00:00:01,000 --> 00:00:02,000\n[music]\n", "no words with times"),
}


def test_a_silent_word_tier_is_not_replaced_by_another(tmp_path):
    tiers = ("words", [(0, 4, "sil")]), ("gesture", [(0, 2, "stroke"), (2, 4, "hold")])
    (tmp_path / "a.TextGrid").write_text(text_grid(*tiers))
    with pytest.raises(UserError, match="has no words with times"):
        transcripts.read_words(tmp_path / "a.TextGrid")


def test_a_transcript_of_another_recording_is_refused(tmp_path):
    (tmp_path / "a.tsv").write_text("start\tend\tword\n100\t100.5\thello\n101\t103\tthere\n")
    with pytest.raises(UserError, match=r"a\.tsv has words from 100\.0 to 103\.0 s and the recording lasts 10\.0 s"):
        transcripts.words_of(np.zeros(160_000, np.float32), tmp_path / "a.tsv", recognise=None)


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files(tmp_path, name):
    """One line: the file, what was found, what to do."""
    data, message = HOSTILE[name]
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(UserError, match=message) as caught:
        transcripts.read_words(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 400


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
        (["a.ann.srt", "a.ann.mp4"], None),  # of another recording
        (["A.B.tsv", "a.vtt"], "A.B.tsv"),  # in other case
        (["A.B.tsv", "a.b.vtt"], "a.b.vtt"),
        (["A.B.tsv", "A.B.wav"], "A.B.tsv"),
        (["a.b.bvh.srt", "a.vtt"], "a.b.bvh.srt"),  # as whisper.cpp names its files
        (["a.b.es-419.vtt", "a.vtt"], "a.b.es-419.vtt"),
        (["A.B.tsv", "A.B.bvh"], None),
        ([], None),
    ],
)
def test_the_transcript_of_a_recording_is_found_by_rules(tmp_path, names, found):
    for name in names:
        (tmp_path / name).write_text("x")
    (tmp_path / "a.dir.tsv").mkdir()
    expected = found and tmp_path / found
    assert transcripts.find(tmp_path / "a.b.bvh") == expected


def test_languages_beside_a_recording_are_said_once(tmp_path, caplog):
    for name in ("talk.de.vtt", "talk.en.vtt"):
        (tmp_path / name).write_text("x")
    for _ in range(2):
        assert transcripts.find(tmp_path / "talk.mp4") == tmp_path / "talk.de.vtt"
    assert caplog.text.count("has transcripts in several languages (talk.de.vtt, talk.en.vtt)") == 1
    (tmp_path / "other.en.vtt").write_text("x")
    transcripts.find(tmp_path / "other.mp4")
    assert "other" not in caplog.text


TABLES = {
    "commas in a text": (
        "start,end,text\n0,2,hello, my friend\n2,3,bye\n",
        [("hello", 0), ("friend", None), ("bye", 2)],
    ),
    "a line break in a text": ('start,end,text\n0,2,"hello there\nmy friend"\n', [("hello", 0), ("there", None)]),
    "numbered rows": ("1\t3.2\t3.9\thello\n2\t4\t4.4\tmy\n3\t5\t5.5\tfriend\n", [("hello", 3.2), ("friend", 5)]),
    "ELAN without participants": (
        "A\t1.1\t2\t0.9\thello\nB\t1.2\t2.2\t1\tother\nA\t3.1\t4\t0.9\tagain\n",
        [("hello", 1.1), ("again", 3.1)],
    ),
    "names of rows": ("u1\t1.1\t2\t0.9\thello\nu2\t2.2\t3\t0.8\tagain\n", [("hello", 1.1), ("again", 2.2)]),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_as_people_write_them(tmp_path, name):
    text, expected = TABLES[name]
    (tmp_path / "a.csv").write_text(text)
    found = {word.text: word.start for word in transcripts.read_words(tmp_path / "a.csv")}
    for word, start in expected:
        assert word in found and (start is None or found[word] == pytest.approx(start))
    assert "other" not in found


def test_exported_motion_is_no_transcript(tmp_path):
    for suffix in (".json", ".csv"):
        formats.export(swaying(), tmp_path / f"a{suffix}")
    (tmp_path / "a.srt").write_text("x")
    assert transcripts.find(tmp_path / "a.bvh") == tmp_path / "a.srt"


def test_subtitles_count_from_the_beginning_of_the_file(tmp_path):
    """A transport stream has a clock that is ahead, and FFmpeg does not read NIST SPHERE, as of TIMIT."""
    (tmp_path / "a.srt").write_text("1\n00:00:02,000 --> 00:00:03,000\none\n")
    samples = np.zeros(6 * 16000, np.float32)
    soundfile.write(tmp_path / "nist.wav", samples, 16000, format="NIST")
    files = {tmp_path / "nist.wav": 2.0}
    for name in ("a.mp4", "a.ts"):
        files[make_video(tmp_path / name, sound_start=0.5)] = 1.5
    for media, start in files.items():
        (word,) = transcripts.words_of(samples, tmp_path / "a.srt", recognise=None, media=media)
        assert word.start == pytest.approx(start, abs=0.1), media.name


def test_the_transcripts_of_genuine_recordings_are_found(private_data):
    found = transcripts.find(private_data / "zeroeggs_067" / "067_Speech_2_x_1_0.mixamo.bvh")
    assert found is not None and found.name == "067_Speech_2_x_1_0.TextGrid"
    assert transcripts.find(private_data / "video" / "sample.mp4") == private_data / "video" / "words.tsv"


def test_a_transcript_needs_no_synthesiser_and_no_reader_of_another_format(tmp_path):
    (tmp_path / "a.tsv").write_bytes(FILES["a.tsv"])
    others = ("espeakng_loader", "pocketsphinx")
    code = f"""import pathlib, sys; from ha2g_jax.features import words; words.read_words(pathlib.Path('a.tsv'))
print([name for name in {others} if name in sys.modules])"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"

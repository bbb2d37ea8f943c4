"""The transcript of a recording is found by rules, never by chance."""

import pytest

from ha2g_jax.features import words as transcripts


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
def test_find(tmp_path, names, found):
    for name in names:
        (tmp_path / name).write_text("x")
    (tmp_path / "a.dir.tsv").mkdir()
    expected = found and tmp_path / found
    assert transcripts.find(tmp_path / "a.b.bvh") == expected


def test_nowhere(tmp_path):
    assert transcripts.find(tmp_path / "missing" / "a.wav") is None


def test_genuine_recordings(private_data):
    found = transcripts.find(private_data / "zeroeggs_067" / "067_Speech_2_x_1_0.mixamo.bvh")
    assert found is not None and found.name == "067_Speech_2_x_1_0.TextGrid"
    assert transcripts.find(private_data / "video" / "sample.mp4") == private_data / "video" / "words.tsv"

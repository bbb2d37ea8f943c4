"""`ha2g view`: files in, one page out, and one line for every mistake."""

import json
import pathlib

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli


def contents(path):
    text = path.read_text()
    start = text.index('id="content">') + len('id="content">')
    return json.loads(text[start : text.index("</script>", start)])


@pytest.fixture
def folder(make_motion, tmp_path):
    for name in ("a/talk.npz", "b/talk.npz", "other.npz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        make_motion(frames=20).save(tmp_path / name)
    soundfile.write(tmp_path / "talk.wav", np.random.default_rng(0).normal(0, 0.1, 24000), 16000)
    (tmp_path / "words.srt").write_text("1\n00:00:00,200 --> 00:00:00,900\nhello there\n")
    return tmp_path


def view(*arguments):
    return cli.main(["view", *map(str, arguments)])


def test_one_page_of_several_files(folder, capsys):
    out = folder / "new" / "view.html"
    motions = [folder / "other.npz", folder / "a" / "talk.npz", folder / "b" / "talk.npz"]
    assert view(*motions, "--audio", folder / "talk.wav", "--words", folder / "words.srt", "-o", out) == 0
    assert capsys.readouterr().out.strip() == str(out)
    content = contents(out)
    assert [motion["name"] for motion in content["motions"]] == ["other", "a/talk", "b/talk"]
    assert content["duration"] == 1.5
    assert [word[0] for word in content["words"]] == ["hello", "there"]
    assert content["sound"]


def test_words_need_no_sound(folder):
    assert view(folder / "other.npz", "--words", folder / "words.srt", "-o", folder / "v.html") == 0
    content = contents(folder / "v.html")
    assert len(content["words"]) == 2
    assert content["sound"] is None


def test_motion_capture_stands_beside_it(private_data, folder):
    recording = sorted(pathlib.Path(private_data).glob("zeroeggs*/*.bvh"))[0]
    assert view(recording, folder / "other.npz", "-o", folder / "v.html") == 0
    captured, _ = contents(folder / "v.html")["motions"]
    assert captured["name"] == recording.stem
    assert captured["fps"] == 30


@pytest.mark.parametrize(
    "arguments",
    [
        ["missing.npz"],
        ["talk.wav"],
        ["other.npz", "other.npz"],
        ["other.npz", "--audio", "missing.wav"],
        ["other.npz", "--words", "talk.wav"],
        ["other.npz", "-o", "other.npz"],
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(folder, arguments, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert view(*arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before

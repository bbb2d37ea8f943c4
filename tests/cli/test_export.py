"""`ha2g export`: a file for each, and one line for every mistake."""

import argparse
import codecs

import av
import numpy as np
import pytest
import soundfile
from fixtures.glb_reader import GlbReader
from PIL import Image

from ha2g_jax import cli
from ha2g_jax.cli import export
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import find_motions
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture
def files(tmp_path):
    """Two motions of a second, one of them twice, a sound, and words, in a folder."""
    folder = tmp_path / "in"
    (folder / "more").mkdir(parents=True)
    for name, skeleton in (("a", "ted_expressive"), ("b", "ted_gesture"), ("more/a", "ted_expressive")):
        mean = load_skeleton(skeleton).mean_directions
        Motion.from_directions(load_skeleton(skeleton), np.repeat(mean[None], 15, axis=0), 15).save(
            folder / f"{name}.npz"
        )
    soundfile.write(folder / "speech.wav", np.random.default_rng(0).normal(0, 0.1, 16000), 16000)
    (folder / "words.tsv").write_text("start\tend\tword\n0.1\t0.4\thello\n0.5\t0.9\tthere\n")
    (folder / "text.npz").write_text("not a motion")
    return folder


def run(*arguments) -> None:
    parsed = cli.make_parser().parse_args([str(argument) for argument in arguments])
    parsed.run(parsed)


def test_video_of_several_motions_with_sound(files, tmp_path, capfd):
    out = tmp_path / "x.mp4"
    run("export", files / "a.npz", files / "b.npz", "--audio", files / "speech.wav", "-o", out, "--size", "160x96")
    with av.open(str(out)) as container:
        video = container.streams.video[0]
        assert (video.width, video.height, video.frames) == (160, 96, 30)
        assert container.streams.audio
    message = capfd.readouterr()
    assert message.out.split() == [str(out)]
    assert message.err == ""


def test_video_says_when_motion_and_sound_differ_in_length(files, tmp_path, capsys):
    soundfile.write(files / "long.wav", np.random.default_rng(0).normal(0, 0.1, 32000), 16000)
    out = tmp_path / "x.mp4"
    run("export", files / "a.npz", "--audio", files / "long.wav", "-o", out, "--size", "64x64")
    assert capsys.readouterr().err == "ha2g: a lasts 1.0 s, the sound 2.0 s\n"
    with av.open(str(out)) as container:
        assert container.streams.video[0].frames == 60


def test_each_motion_of_a_folder_is_written_on_a_rig(files, tmp_path, capsys):
    out = tmp_path / "out"
    with pytest.raises(UserError, match="1 of 4 files failed, for the reasons above"):
        run("export", files, "--format", "bvh", "--rig", "mixamo", "-o", out)
    assert {path.relative_to(out).as_posix() for path in out.rglob("*.*")} == {"a.bvh", "b.bvh", "more/a.bvh"}
    assert "mixamorig:Hips" in (out / "more" / "a.bvh").read_text()
    message = capsys.readouterr()
    assert sorted(message.out.split()) == [str(out / name) for name in ("a.bvh", "b.bvh", "more/a.bvh")]
    assert "text.npz failed: " in message.err
    run("export", files / "a.npz", files / "more" / "a.npz", "--format", ".glb", "-o", out)
    assert {path.relative_to(out).as_posix() for path in out.rglob("*.glb")} == {"in/a.glb", "more/a.glb"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "x.bvh"), "in is a folder; name the format of its motions with --format"),
        (("-o", "x.bvh", "--format", "glb"), "x.bvh would be a folder, for the motions in the format .glb"),
        (("-o", "x", "--format", "mp4"), "--format mp4 is not a format of motion; expected .glb"),
        (("-o", "x", "--format", "bvh", "--rig", "poser"), "no rig poser"),
        (("-o", "x", "--format", "bvh", "--unit", "1"), "does not depend on --unit"),
    ],
)
def test_what_a_folder_cannot_become_is_said_in_one_line(arguments, message, files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (files / "text.npz").unlink()
    with pytest.raises(UserError, match=message):
        run("export", files, *arguments)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_keyframes_of_several_motions_with_words(files, tmp_path, suffix):
    out = tmp_path / f"strip{suffix}"
    options = ["--words", files / "words.tsv", "--count", 2, "--size", 64, "--names", "ground truth", "HA2G"]
    run("export", files / "a.npz", files / "b.npz", "-o", out, *options)
    if suffix == ".png":
        with Image.open(out) as image:
            assert image.width == 2 * 70 + 6
    else:
        assert all(text in out.read_text() for text in ("ground truth", "HA2G", "hello", "there"))


def test_video_and_key_frames_show_a_bvh_beside_a_motion(files, tmp_path):
    run("export", files / "a.npz", "-o", files / "true.bvh")
    run("export", files / "true.bvh", files / "a.npz", "-o", tmp_path / "x.mp4", "--size", "64x64")
    run("export", files / "true.bvh", files / "a.npz", "-o", tmp_path / "x.svg", "--count", 2, "--size", 64)
    assert all(name in (tmp_path / "x.svg").read_text() for name in ("true", "a"))
    with av.open(str(tmp_path / "x.mp4")) as container:
        assert container.streams.video[0].frames == 30


def test_motions_go_by_the_names_of_their_files_and_if_need_be_folders(files):
    def names(*paths, names=None):
        arguments = argparse.Namespace(
            motions=[files / path for path in paths], names=names, joint_map=None, source_fps=None, unit=None, fps=None
        )
        return list(export._load(arguments))

    assert names("a.npz", "b.npz") == ["a", "b"]
    assert names("a.npz", "more/a.npz") == ["in/a", "more/a"]
    assert names("a.npz", "b.npz", names=["x", "y"]) == ["x", "y"]
    run("export", files / "a.npz", "-o", files / "a.bvh")
    assert names("a.npz", "a.bvh") == ["in/a.npz", "in/a.bvh"]
    with pytest.raises(UserError, match="the same name, as it is shown"):
        names("a.npz", "b.npz", names=[110 * "a" + which + 110 * "b" for which in "12"])


def test_the_motions_of_a_folder_are_written_below_another(files, tmp_path):
    (files / "notes.csv").touch()
    run("export", files / "a.npz", "-o", files / "a.csv")
    (files / "a.csv").write_bytes(codecs.BOM_UTF8 + (files / "a.csv").read_bytes())  # as Excel saves it
    run("export", files / "a.npz", files / "a.csv", "--format", "bvh", "-o", tmp_path / "out")
    names = ["in/a.csv.bvh", "in/a.npz.bvh"]
    assert sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*")) == names
    assert not any(path.name.startswith("notes") for path in find_motions(files).values())


def test_a_capture_and_what_was_generated_for_its_sound_are_two_motions(files, tmp_path):
    (files / "text.npz").unlink()
    (files / "b.npz").rename(files / "b_gestures.npz")
    (files / "b.json").write_text('[{"word": "hello", "start": 0.1, "end": 0.4}]')
    assert find_motions(files)["b"].name == "b_gestures.npz"
    run("export", files / "a.npz", "-o", files / "a_gestures.bvh")
    run("export", files, "--format", "csv", "-o", tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").glob("*")} == {"a.csv", "a_gestures.csv", "b_gestures.csv", "more"}
    with pytest.raises(UserError, match=r"a\.npz and .*a_gestures\.bvh are motions of one clip"):
        find_motions(files)


def test_a_glb_names_the_sound_that_is_given(files, tmp_path, capsys):
    soundfile.write(files / "long.wav", np.random.default_rng(0).normal(0, 0.1, 32000), 16000)
    run("export", files / "a.npz", "--audio", files / "long.wav", "-o", tmp_path / "x.glb")
    extras = GlbReader(tmp_path / "x.glb").tree["scenes"][0]["extras"]
    assert (extras["audio"], extras["audio_seconds"], extras["frames"]) == ("long.wav", 2.0, 15)
    assert "lasts 1.0 s, the sound 2.0 s" in capsys.readouterr().err


MISTAKES = {
    "not a motion": (["export", "{}/text.npz", "-o", "{out}/x.bvh"], "is not a whole .npz"),
    "overwrites": (["export", "{}/a.npz", "-o", "{}/a.npz"], "overwrite"),
    "no such suffix": (["export", "{}/a.npz", "-o", "{out}/x.avi"], "expected one of .mp4, .html"),
    "option of a page": (
        ["export", "{}/a.npz", "-o", "{out}/x.mp4", "--words", "w.tsv"],
        "--words does not apply to .mp4",
    ),
    "two motions": (["export", "{}/a.npz", "{}/b.npz", "-o", "{out}/x.bvh"], "holds one motion, not 2"),
    "odd size": (["export", "{}/a.npz", "-o", "{out}/x.mp4", "--size", "101x100"], "even sides"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(files, tmp_path, name):
    arguments, what = MISTAKES[name]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    with pytest.raises(UserError) as error:
        run(*(argument.format(files, out=tmp_path / "out") for argument in arguments))
    assert what in str(error.value)
    assert "\n" not in str(error.value)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before

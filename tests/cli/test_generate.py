"""`ha2g generate`: both files or neither, and one line for every mistake."""

import json
import shutil
import subprocess
import sys

import av
import numpy as np
import pytest
import soundfile
from fixtures.motions import swaying
from fixtures.pages import Page

from ha2g_jax import cli
from ha2g_jax.apps.generate import generate_files, load
from ha2g_jax.apps.tasks import find_transcript, out_paths, plan
from ha2g_jax.errors import UserError
from ha2g_jax.figure import CAMERAS
from ha2g_jax.limits import MAX_SEED
from ha2g_jax.motion.control import rest_pose
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture
def speech(tmp_path):
    path = tmp_path / "in" / "speech.wav"
    path.parent.mkdir()
    soundfile.write(path, np.random.default_rng(0).normal(0, 0.1, (44100, 2)), 44100)
    return path


def generate(*arguments) -> int:
    return cli.main(["generate", *map(str, arguments)])


def test_a_folder_where_nothing_can_be_written_is_told_before_the_work(speech, tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)
    for sounds in (speech, [speech, speech.parent]):
        with pytest.raises(UserError, match=r"cannot write in .*give another folder with --out"):
            plan(sounds, tmp_path / "out")


def test_writes_motion_and_video(debug_folder, speech, tmp_path, capsys):
    out = tmp_path / "new" / "talk"
    assert generate(speech, "-o", out, "--checkpoint", debug_folder, "--speaker", "ada", "--fps", 24) == 0
    assert capsys.readouterr().out.split() == [f"{out}.npz", f"{out}.mp4"]
    assert sorted(path.name for path in out.parent.iterdir()) == ["talk.mp4", "talk.npz"]
    with np.load(f"{out}.npz", allow_pickle=False) as arrays:
        assert arrays["directions"].shape == (24, 42, 3)
        assert arrays["positions"].shape == (24, 43, 3)
        assert arrays["joint_names"].shape == (43,)
        meta = json.loads(str(arrays["meta"]))
    assert meta["speech"] == "speech.wav"
    assert meta["style"] == {"kind": "speaker", "speaker": "ada", "variation": 0.3}
    with av.open(f"{out}.mp4") as container:
        assert (container.duration or 0) / av.time_base == pytest.approx(1, abs=0.04)


def test_takes_are_those_of_their_seeds_with_a_page_to_choose_from(debug_folder, speech, tmp_path, capsys):
    options = [speech, "--checkpoint", debug_folder]
    speech.with_suffix(".srt").write_text("1\n00:00:00,100 --> 00:00:00,500\nhello\n")
    assert generate(*options, "-o", tmp_path / "talk.npz", "--takes", 3, "--seed", 8, "--camera", "close") == 0
    names = ["talk_seed8.npz", "talk_seed9.npz", "talk_seed10.npz", "talk_takes.html"]
    assert capsys.readouterr().out.split() == [str(tmp_path / name) for name in names]
    assert generate(*options, "-o", tmp_path / "one.npz", "--seed", 9) == 0
    takes = [Motion.load(tmp_path / name).directions for name in names[:3]]
    np.testing.assert_array_equal(takes[1], Motion.load(tmp_path / "one.npz").directions)
    assert all((takes[0] != take).any() for take in takes[1:])
    content = json.loads(Page((tmp_path / names[3]).read_text()).of("content"))
    assert [motion["name"] for motion in content["motions"]] == ["seed 8", "seed 9", "seed 10"]
    assert content["view"] == list(CAMERAS["close"])
    assert content["sound"] and "hello" in json.dumps(content["words"])
    speech.with_suffix(".srt").write_text("no words with times")
    assert generate(*options, "-o", tmp_path / "page.html") == 0
    assert "the page has no words: " in capsys.readouterr().err
    assert generate(*options, "-o", tmp_path / "one.bvh", "--words", speech.with_suffix(".srt")) == 2
    assert "leave --words out, or write .html" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--takes", "0"], "0 takes; expected 1 to 12"),
        (["--takes", "13"], "13 takes; expected 1 to 12"),
        (
            ["--camera", "close", "--format", "bvh"],
            "--camera does not apply to .bvh; leave it out, or write .mp4 or .html",
        ),
    ],
)
def test_takes_and_cameras_that_are_none_are_refused(speech, capsys, options, message):
    assert generate(speech, *options) == 2
    assert capsys.readouterr().err.startswith(f"ha2g: {message}")
    assert list(speech.parent.iterdir()) == [speech]


def test_controls_reach_the_motion_and_its_record(debug_folder, speech, tmp_path):
    skeleton = load_skeleton("ted_expressive")
    pose = rest_pose(skeleton)
    Motion.from_directions(skeleton, np.repeat(pose[None], 20, axis=0), 30).save(tmp_path / "still.npz")
    options = ["--checkpoint", debug_folder, "--style", "ada:0.3,ben:0.7", "--seed-pose", tmp_path / "still.npz"]
    options += ["--energy", 1.2, "--extent", 0.9, "--handedness", "left", "--mirror", "--smooth", 0.2, "--fps", 30]
    options += ["--pin", f"0.5:0.6:{tmp_path / 'still.npz'}@0.3", "--pin", "0.8:0.8:rest", "--mute", "0.1:0.2"]
    assert generate(speech, "-o", tmp_path / "out", "--size", "64x32", *options) == 0
    motion = Motion.load(tmp_path / "out.npz")
    assert motion.meta["style"] == {"kind": "mixture", "speakers": {"ada": 0.3, "ben": 0.7}, "variation": 0.3}
    assert motion.meta["seed_pose"] == "still.npz"
    assert motion.meta["smoothing"] == 0.2
    assert motion.meta["controls"] == {
        "energy": 1.2,
        "extent": 0.9,
        "handedness": "left",
        "mirror": True,
        "pins": [
            {"start": 0.5, "end": 0.6, "pose": "still.npz@0.3"},
            {"start": 0.8, "end": 0.8, "pose": "rest"},
        ],
        "mutes": [{"start": 0.1, "end": 0.2}],
    }
    np.testing.assert_allclose(motion.directions[15:19], np.broadcast_to(pose, (4, 42, 3)), atol=1e-6)
    with av.open(tmp_path / "out.mp4") as container:
        assert (container.streams.video[0].width, container.streams.video[0].height) == (64, 32)


def test_the_result_lies_beside_the_speech_or_in_a_folder(speech, tmp_path):
    beside = speech.parent / "speech_gestures.npz", speech.parent / "speech_gestures.mp4"
    assert out_paths(speech, None) == beside
    assert out_paths(speech, tmp_path)[0] == tmp_path / "speech_gestures.npz"
    assert out_paths(speech, f"{tmp_path}/new/", ".bvh") == (tmp_path / "new" / "speech_gestures.bvh",)
    assert out_paths(speech, "my.take.v2", ".glb")[0].name == "my.take.v2.glb"
    assert out_paths(speech.with_name("speech.v2.wav"), None)[0].name == "speech.v2_gestures.npz"


def test_a_file_that_is_given_twice(speech, tmp_path):
    with pytest.raises(UserError, match=r"speech\.wav is given twice; give each file once"):
        plan([speech, speech.parent / ".." / speech.parent.name / speech.name], tmp_path)


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".npz", ".mp4", ".html"])
def test_a_format_is_written_and_nothing_else(debug_folder, speech, tmp_path, capsys, suffix):
    out = tmp_path / "new" / f"talk{suffix}"
    size = ("--size", 64) if suffix == ".mp4" else ()
    assert generate(speech, "-o", out, "--checkpoint", debug_folder, *size) == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert [path.name for path in out.parent.iterdir()] == [out.name]
    content = out.read_bytes()
    starts = {".bvh": b"HIERARCHY", ".glb": b"glTF", ".npz": b"PK", ".html": b"<!"}
    assert content.startswith(starts.get(suffix, b"")) and len(content) > 1000


@pytest.mark.parametrize("rig", [[], ["--rig", "mixamo"]])
def test_a_file_of_another_program_is_that_of_export(debug_folder, speech, tmp_path, rig):
    assert generate(speech, "-o", tmp_path / "a.bvh", "--checkpoint", debug_folder, *rig) == 0
    assert generate(speech, "-o", tmp_path / "b.npz", "--checkpoint", debug_folder) == 0
    assert cli.main(["export", str(tmp_path / "b.npz"), "-o", str(tmp_path / "b.bvh"), *rig]) == 0
    assert (tmp_path / "a.bvh").read_bytes() == (tmp_path / "b.bvh").read_bytes()


def test_a_format_that_is_not_known_is_refused_before_the_speech_is_read(tmp_path, capsys):
    assert generate(tmp_path / "missing.wav", "-o", tmp_path / "out.xyz") == 2
    line = capsys.readouterr().err
    assert line.startswith("ha2g: cannot write out.xyz: .xyz; expected one of .bvh, .glb") and line.count("\n") == 1


# Their imports take longer than the work on a few seconds of speech, for which none is needed.
UNUSED = {"librosa", "numba", "optax", "orbax", "pygltflib", "scipy", "sklearn"}


def test_another_process_gives_the_same_bytes_and_imports_little(debug_folder, speech, tmp_path):
    options = ["--checkpoint", str(debug_folder), "--seed", "3"]
    assert generate(speech, "-o", tmp_path / "a", *options) == 0
    command = [sys.executable, "-X", "importtime", "-m", "ha2g_jax.cli", "generate", str(speech), *options]
    done = subprocess.run([*command, "-o", str(tmp_path / "b")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines()}
    assert "jax" in imported and not imported & UNUSED
    for suffix in (".npz", ".mp4"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.fixture
def bad_files(debug_folder, speech, tmp_path):
    """Everything that can be wrong with the files, in one folder."""
    folder = tmp_path / "bad"
    folder.mkdir()
    (folder / "text.wav").write_text("these are words\n" * 40)
    soundfile.write(folder / "nan.wav", np.full(16000, np.nan), 16000, subtype="FLOAT")
    for name in ("film.mp4", "film_gestures.mp4", "speech.flac"):
        (folder / name).write_bytes(speech.read_bytes())
    (folder / "text.png").write_text("not a picture")
    swaying().save(folder / "wave.npz")
    (folder / "cues.jsonl").write_text(json.dumps({"cue": f"clip:{folder}/wave.npz", "time": 0.5}))
    (folder / "no_model").mkdir()
    (folder / "cut_model").mkdir()
    for path in debug_folder.iterdir():
        content = path.read_bytes()
        is_weights = path.suffix == ".safetensors"
        (folder / "cut_model" / path.name).write_bytes(content[: len(content) // 2] if is_weights else content)
    return folder


MISTAKES = {
    "text": ["{bad}/text.wav"],
    "nan": ["{bad}/nan.wav"],
    "folder without sound": ["{bad}/no_model"],
    "one name for two": ["{speech}", "{bad}/speech.flac"],
    "file for two": ["{speech}", "{bad}/nan.wav", "-o", "{bad}/out.bvh"],
    "one overwrites the other": ["{bad}/film.mp4", "{bad}/film_gestures.mp4", "-o", "{bad}"],
    "image": ["{speech}", "--reference-image", "{bad}/text.png"],
    "pin after the end": ["{speech}", "--pin", "2:3:rest"],
    "style": ["{speech}", "--style", "ada:0.3,eve:0.7"],
    "rig of a video": ["{speech}", "--rig", "mixamo"],
    "size of the video": ["{speech}", "--size", "8192"],
    "no size": ["{speech}", "--size", "0"],
    "no frame rate": ["{speech}", "--fps", "nan"],
    "frame rate of takes": ["{speech}", "--fps", "inf", "--takes", "2"],
    "no path": ["{speech}", "-o", ""],
    "format": ["{speech}", "-o", "{bad}/out.xyz"],
    "cut checkpoint": ["{speech}", "--checkpoint", "{bad}/cut_model"],
    "unwritable": ["{speech}", "-o", "{bad}/text.wav/out"],
    "overwrites the speech": ["{bad}/film.mp4", "-o", "{bad}/film"],
    "overwrites the motion of a pin": ["{speech}", "--pin", "0:1:{bad}/wave.npz", "-o", "{bad}/wave.npz"],
    "overwrites the clip of a cue": ["{speech}", "--cues", "{bad}/cues.jsonl", "-o", "{bad}/wave.npz"],
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(debug_folder, speech, bad_files, tmp_path, capfd, name):
    arguments = [argument.format(bad=bad_files, speech=speech) for argument in MISTAKES[name]]
    before = sorted(tmp_path.rglob("*"))
    arguments += [] if "-o" in arguments else ["-o", str(tmp_path / "out")]
    arguments += [] if "--checkpoint" in arguments else ["--checkpoint", str(debug_folder)]
    assert generate(*arguments) == 2
    message = capfd.readouterr()
    assert message.out == ""
    assert message.err.startswith("ha2g: ")
    assert message.err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_a_damaged_recording_of_a_folder_fails_and_the_others_are_done(speech, debug_folder, tmp_path, capsys):
    (speech.parent / "damaged.m4a").write_bytes(speech.read_bytes()[:20])
    out = ["--out", str(tmp_path / "out"), "--format", "npz", "--checkpoint", str(debug_folder)]
    assert generate(str(speech.parent), *out) == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["speech_gestures.npz"]
    assert "damaged.m4a failed: " in capsys.readouterr().err


@pytest.fixture
def recordings(speech):
    """A folder with two recordings, notes, what is hidden, a folder, and the result of an earlier run."""
    folder = speech.parent
    for name in ("second.flac", "speech_gestures.mp4", "speech_gestures_seed3.mp4", ".hidden.wav"):
        shutil.copy(speech, folder / name)
    (folder / "notes.txt").write_text("first: speech, second: second")
    (folder / "older.wav").mkdir()
    return folder


def test_the_speech_of_a_folder_is_its_sound(recordings, tmp_path, capsys):
    tasks = plan(recordings)
    assert [task.speech.name for task in tasks] == ["second.flac", "speech.wav"]
    assert tasks[0].paths == (recordings / "second_gestures.npz", recordings / "second_gestures.mp4")
    message = f"skipping subfolders and files that are not speech in {recordings}: older.wav/, notes.txt, "
    message += "speech_gestures.mp4, "
    message += "speech_gestures_seed3.mp4\n"
    assert capsys.readouterr().err == message
    in_folder = plan([recordings / "second.flac", recordings / "speech.wav"], tmp_path / "new", ".bvh")
    assert [task.paths for task in in_folder] == [
        (tmp_path / "new" / f"{n}_gestures.bvh",) for n in ("second", "speech")
    ]


def test_a_transcript_that_is_found_is_not_overwritten(speech, tmp_path, monkeypatch):
    class Reader:
        reads_words = True

    transcript = speech.with_suffix(".json")
    transcript.write_text("[]")
    monkeypatch.setattr("ha2g_jax.apps.generate.load", lambda *_: Reader())
    with pytest.raises(UserError, match=r"would overwrite .*speech\.json"):
        generate_files(speech, transcript)
    assert transcript.read_text() == "[]"


def test_a_transcript_may_be_of_one_speaker(debug_folder, speech, tmp_path):
    cues = tmp_path / "cues.jsonl"
    cues.write_text('{"cue": "nod", "word": "two"}\n')
    words = tmp_path / "words.vtt"
    words.write_text("WEBVTT\n\n00:00.100 --> 00:00.500\n<v Mary>one two\n\n00:00.600 --> 00:00.900\n<v John>three\n")
    common = ("--cues", cues, "--checkpoint", debug_folder)
    assert generate(speech, "-o", tmp_path / "a.npz", "--words", f"{words}#Mary", *common) == 0
    assert generate(speech, "-o", tmp_path / "b.npz", "--words", f"{words}#John", *common) == 2
    assert generate(speech, "-o", words, "--words", f"{words}#Mary", *common) == 2 and "Mary" in words.read_text()


def test_one_transcript_is_not_that_of_several_recordings(speech):
    transcript = speech.with_name("words.json")
    transcript.write_text("[]")
    shutil.copy(speech, speech.with_name(f"{speech.stem}_gestures.wav"))
    assert find_transcript(speech) == transcript
    shutil.copy(speech, speech.with_name("other.wav"))
    assert find_transcript(speech) is None


def test_a_file_that_fails_is_named_and_the_others_are_written(debug_folder, recordings, tmp_path, capsys):
    soundfile.write(recordings / "nan.wav", np.full(16000, np.nan), 16000, subtype="FLOAT")
    out = tmp_path / "out"
    assert generate(recordings, "-o", out, "--format", "npz", "--checkpoint", debug_folder) == 2
    found = capsys.readouterr()
    names = ["second_gestures.npz", "speech_gestures.npz"]
    assert found.out.splitlines() == [str(out / name) for name in names]
    assert sorted(path.name for path in out.iterdir()) == names
    skipped, failed, last = found.err.splitlines()
    assert skipped.startswith("skipping") and failed.startswith(f"{recordings / 'nan.wav'} failed: ")
    assert last == "ha2g: 1 of 3 files failed, for the reasons above"


def test_several_files_are_those_of_one_at_a_time(debug_folder, speech, recordings, tmp_path):
    options = ["--checkpoint", debug_folder, "--size", 64, "--seed", 5]
    assert generate(recordings / "second.flac", speech, "-o", tmp_path / "out", *options) == 0
    assert generate(speech, "-o", tmp_path / "one", *options) == 0
    for suffix in (".npz", ".mp4"):
        one = (tmp_path / f"one{suffix}").read_bytes()
        assert (tmp_path / "out" / f"speech_gestures{suffix}").read_bytes() == one


def test_an_interrupt_leaves_the_files_that_are_complete(debug_folder, recordings, tmp_path, monkeypatch, capsys):
    def write(path, *_, **__):
        path.write_bytes(b"a video")
        if "speech" in path.name:
            raise KeyboardInterrupt

    monkeypatch.setattr("ha2g_jax.motion.formats.video.write_video", write)
    assert generate(recordings, "-o", tmp_path / "out", "--checkpoint", debug_folder) == 130
    names = ["second_gestures.mp4", "second_gestures.npz"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_the_last_take_has_a_seed_before_anything_is_made(tmp_path):
    with pytest.raises(UserError, match="a seed is above"):
        generate_files(tmp_path / "missing.wav", tmp_path / "out", seed=MAX_SEED, takes=2)


def test_a_backend_that_there_is_not_is_no_other_one():
    with pytest.raises(UserError, match="no backend 'ONNX'; expected jax or onnx"):
        load("demo", "ONNX")

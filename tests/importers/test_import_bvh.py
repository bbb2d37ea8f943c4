"""Importing motion capture: pairing, units, axes, broken files, and a real recording."""

import logging
import pathlib
import re
import shutil

import numpy as np
import pytest
import soundfile
from fixtures.videos import make_video
from motion.readers import bvh_files

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.importers.mocap import ImportOptions, import_bvh, with_constant_lengths
from ha2g_jax.motion import formats, readers
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.motion.readers.recordings import other_rate
from ha2g_jax.skeleton import bone_lengths, load_skeleton, positions_to_directions

EXPRESSIVE, GESTURE = load_skeleton("ted_expressive"), load_skeleton("ted_gesture")
SECONDS = 6.0


def mixamo(joint: str) -> str:
    """Our joints by their names at Mixamo."""
    names = {"hips": "Hips", "spine": "Spine2", "neck": "Neck", "head": "Head"}
    if joint in names:
        return names[joint]
    side, *rest = joint.split("_")
    part = {"shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand"}.get(rest[0], f"Hand{rest[0].title()}")
    return f"mixamorig:{side.title()}{part}{''.join(rest[1:])}"


@pytest.fixture
def recording():
    """Writes a recording: motion, noise as its sound, and a word each half second."""

    def write(folder: pathlib.Path, stem: str, *, seconds: float = SECONDS, sound: float | None = None, **how):
        folder.mkdir(parents=True, exist_ok=True)
        joint_angles = bvh_files.swing(seconds, 30, how.pop("with_fingers", True))
        (folder / f"{stem}.bvh").write_text(bvh_files.bvh(joint_angles, name=mixamo, **how))
        noise = np.random.default_rng(0).normal(0, 0.1, round((sound or seconds) * 16000))
        with (folder / f"{stem}.wav").open("wb") as file:
            soundfile.write(file, noise, 16000, format="WAV")
        rows = [f"{0.5 * i}\t{0.5 * i + 0.4}\tword{i}" for i in range(int(2 * seconds))]
        (folder / f"{stem}.tsv").write_text("\n".join(["start\tend\tword", *rows]) + "\n")
        return folder / f"{stem}.bvh"

    return write


@pytest.fixture(autouse=True)
def _one_core(monkeypatch):
    """Processes start slowly; the tests that are about them ask for more."""
    monkeypatch.setattr("os.cpu_count", lambda: 1)


def test_one_file(recording, tmp_path):
    report = import_bvh(recording(tmp_path / "in", "talk"), tmp_path / "out", ImportOptions(licence="mine"))["train"]
    corpus = Corpus.open(tmp_path / "out")
    (clip,) = corpus.clips("train")
    assert (clip.recording, clip.speaker, corpus.fps, corpus.metadata["licence"]) == ("talk", "talk", 15, "mine")
    assert clip.positions.shape == (90, 43, 3) and clip.positions.dtype == np.float32
    assert len(clip.audio) == SECONDS * 16000 and [word.text for word in clip.words] == [f"word{i}" for i in range(12)]
    assert (report.videos, report.clips, report.kept) == (1, 1, len(clip.window_starts)) and report.kept > 3
    assert corpus.metadata["import"]["train"]["windows"] == report.windows
    assert corpus.metadata["motion"] == {"joint map mixamo, unit 0.01 m, y up": 1}


def test_a_unit_that_cannot_be(recording, tmp_path):
    path = recording(tmp_path, "talk", per_metre=6)
    with pytest.raises(UserError, match=r"talk\.bvh: it has arms 3\.3 units long .* \(--unit\)"):
        read_motion(path, EXPRESSIVE, fps=15)
    assert read_motion(path, EXPRESSIVE, fps=15, unit=1 / 6).unit == pytest.approx(1 / 6)
    with pytest.raises(UserError, match="expected metres"):
        import_bvh(path, tmp_path / "out", unit=float("nan"))


def test_a_part_of_the_fingers_is_named(recording, tmp_path, caplog):
    path = recording(tmp_path / "in", "talk")
    assert readers.read_motion(path).skeleton.name == EXPRESSIVE.name and not caplog.text
    path.write_text(path.read_text().replace("Ring", "Other"))
    assert readers.read_motion(path).skeleton.name == GESTURE.name
    assert "talk.bvh is read without hands, as it lacks left_ring_1, left_ring_2" in caplog.text


def test_without_fingers(recording, tmp_path):
    path = recording(tmp_path / "in", "talk", with_fingers=False)
    with pytest.raises(UserError, match="ted_gesture"):
        import_bvh(path, tmp_path / "out")
    import_bvh(path, tmp_path / "out", ImportOptions(skeleton="ted_gesture"))
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    positions = clip.positions.mean(axis=0)
    assert clip.positions.shape == (90, 10, 3)
    assert positions[GESTURE.joint("left_shoulder"), 0] < -0.1  # TED-Gesture sees the left at -x
    assert (
        positions[GESTURE.joint("head"), 1] < positions[GESTURE.joint("nose"), 1] < positions[GESTURE.joint("neck"), 1]
    )
    assert positions[GESTURE.joint("nose"), 2] > positions[GESTURE.joint("head"), 2]


def test_a_folder_of_speakers(recording, tmp_path, monkeypatch):
    """In order of the paths, with the folder as speaker; several processes give the same bytes as one would."""
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    for speaker, stem in (("ben", "b"), ("ada", "z"), ("ada", "c")):
        recording(tmp_path / "in" / speaker, stem)
    import_bvh(tmp_path / "in", tmp_path / "out", ImportOptions(split="val"))
    corpus = Corpus.open(tmp_path / "out")
    assert [(clip.recording, clip.speaker) for clip in corpus.clips("val")] == [
        ("c", "ada"),
        ("z", "ada"),
        ("b", "ben"),
    ]
    import_bvh(tmp_path / "in" / "ada", tmp_path / "flat")
    assert Corpus.open(tmp_path / "flat").speakers == ("ada",)
    import_bvh(tmp_path / "in" / "ben" / "b.bvh", tmp_path / "alone", ImportOptions(speaker="ben"))
    assert corpus.clips("val").record(2) == Corpus.open(tmp_path / "alone").clips("train").record(0)


def test_gltf_is_imported_and_one_take_in_two_formats_once(recording, tmp_path):
    path = recording(tmp_path / "in", "talk")
    formats.export(readers.read_motion(path), path.with_suffix(".glb"), rig="mixamo")
    (tmp_path / "in" / "scores.csv").write_text("name,score\na,1\n")
    assert import_bvh(tmp_path / "in", tmp_path / "both")["train"].videos == 1
    path.unlink()
    import_bvh(tmp_path / "in", tmp_path / "gltf")
    both, gltf = (Corpus.open(tmp_path / name).clips("train")[0] for name in ("both", "gltf"))
    assert (gltf.recording, gltf.audio.shape, len(gltf.words)) == ("talk", both.audio.shape, 12)
    hand = EXPRESSIVE.bone("left_wrist")
    ours, theirs = (positions_to_directions(EXPRESSIVE, clip.positions)[:, hand] for clip in (gltf, both))
    assert np.degrees(np.arccos(np.clip((ours * theirs).sum(axis=-1), -1, 1))).max() < 5


def test_sound_and_words_of_ones_own(recording, tmp_path):
    path = recording(tmp_path / "in", "talk")
    (tmp_path / "in" / "talk.wav").rename(tmp_path / "sound.wav")
    (tmp_path / "in" / "talk.tsv").rename(tmp_path / "said.tsv")
    with pytest.raises(UserError, match=r"talk\.bvh has no audio; put talk.wav beside it"):
        import_bvh(path, tmp_path / "out")
    with pytest.raises(UserError, match=r"talk\.bvh has no transcript; put talk.TextGrid"):
        import_bvh(path, tmp_path / "out", ImportOptions(audio=tmp_path / "sound.wav"))
    options = ImportOptions(audio=tmp_path / "sound.wav", words=tmp_path / "said.tsv", speaker="ada")
    import_bvh(path, tmp_path / "out", options)
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    assert clip.speaker == "ada" and len(clip.words) == 12
    import_bvh(path, tmp_path / "silent", ImportOptions(audio=tmp_path / "sound.wav", with_words=False))
    (clip,) = Corpus.open(tmp_path / "silent").clips("train")
    assert clip.words == () and clip.window_starts
    recording(tmp_path / "in", "second")
    with pytest.raises(UserError, match=r"holds 2 files of motion; give --audio and --words for one file only"):
        import_bvh(tmp_path / "in", tmp_path / "third", ImportOptions(audio=tmp_path / "sound.wav"))


@pytest.mark.parametrize("late", [0.0, 1.5])
def test_sound_of_a_video_keeps_its_place_among_the_images(recording, tmp_path, late):
    """Protects motion that was tracked in a video whose microphone was on after the camera."""
    path = recording(tmp_path / "in", "talk")
    (tmp_path / "in" / "talk.wav").unlink()
    make_video(tmp_path / "in" / "talk.mkv", seconds=SECONDS, sound_start=late)
    import_bvh(path, tmp_path / "out")
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    sound = np.abs(np.asarray(clip.audio, np.float32)) > 0.05
    assert np.argmax(sound) / 16000 == pytest.approx(late, abs=0.03)
    assert clip.words[0].start == pytest.approx(late, abs=0.03)  # words count from the beginning of the sound


def test_a_transcript_called_words_is_of_one_recording_only(recording, tmp_path):
    path = recording(tmp_path / "in", "talk")
    (tmp_path / "in" / "talk.tsv").rename(tmp_path / "in" / "words.tsv")
    import_bvh(path, tmp_path / "out")
    shutil.copy(tmp_path / "in" / "talk.wav", tmp_path / "in" / "other.wav")
    shutil.copy(path, tmp_path / "in" / "other.bvh")
    with pytest.raises(UserError, match="no transcript"):
        import_bvh(tmp_path / "in", tmp_path / "second")


def test_a_name_that_is_not_utf8_is_imported_as_text(recording, tmp_path):
    name = "t\udcff\udce9 lk"
    import_bvh(recording(tmp_path / name, name), tmp_path / "out")
    (clip,) = Corpus.open(tmp_path / "out").clips("train")
    assert clip.recording == clip.speaker == "t\\xff\\xe9 lk"


@pytest.mark.parametrize(
    ("motion", "fps", "sound", "rate"),
    [(127.07, 15, 64.1, 30), (60, 60, 30, 120), (60, 25, 50, 30), (60, 30, 59, None), (60, 30, 43, None)],
)
def test_the_rate_that_makes_motion_and_sound_equally_long_is_named(motion, fps, sound, rate):
    """A whole ratio before a usual rate, also where the sound goes on for half a second more, as in BEAT2."""
    found = other_rate(motion, fps, sound)
    assert found.endswith(f"(--source-fps {rate})") if rate else found == ""


def test_lengths_that_differ(recording, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        import_bvh(recording(tmp_path / "a", "talk", sound=SECONDS + 0.4), tmp_path / "nearly")
        assert not caplog.records
        import_bvh(recording(tmp_path / "b", "talk", sound=SECONDS - 1), tmp_path / "shorter")
    assert "talk.bvh has 6.00 s of motion and 5.00 s of audio; cut to the shorter" in caplog.text
    (clip,) = Corpus.open(tmp_path / "shorter").clips("train")
    assert len(clip.positions) == 75 and max(word.end for word in clip.words) <= 5
    with pytest.raises(UserError, match=r"6\.00 s of motion and 2\.90 s of audio, which do not belong together"):
        import_bvh(recording(tmp_path / "c", "talk", sound=2.9), tmp_path / "other")


@pytest.mark.parametrize(("stated", "true"), [(24, 120), (120, 30), (60, 30), (30, 25), (15, 45)])
def test_a_rate_that_is_stated_wrongly(stated, true, recording, tmp_path, caplog):
    """The message names the rate at which motion and sound have one length, and with it they have."""
    path = recording(tmp_path / "in", "talk", seconds=SECONDS * true / 30, sound=SECONDS)
    (tmp_path / "in" / "talk.tsv").unlink()
    plain = ImportOptions(with_words=False)
    path.write_text(re.sub("Frame Time: .*", f"Frame Time: {1 / stated:.7f}", path.read_text()))
    option = rf"\(--source-fps {true}\)"
    if max(stated, true) > 2 * min(stated, true):
        with pytest.raises(UserError, match=f"as {true / stated:.3g} to 1.* {true} frames per second.*{option}"):
            import_bvh(path, tmp_path / "out", plain)
    else:
        import_bvh(path, tmp_path / "out", plain)
        assert re.search(option, caplog.text)
    caplog.clear()
    import_bvh(path, tmp_path / "right", plain, source_fps=true)
    assert not caplog.records


def test_nothing_is_left_of_a_failure(recording, tmp_path):
    for stem in ("a", "b"):
        path = recording(tmp_path / "in", stem)
        path.write_text(re.sub("Frames: .*", "Frames: 1000000000000", path.read_text()))
    with pytest.raises(UserError, match=r"all 2 files failed; the first: .*a\.bvh, line 247: Frames") as caught:
        import_bvh(tmp_path / "in", tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_longer_than_any_sound(tmp_path):
    """Refused before the motion is worked out, which would take many times the memory."""
    path = tmp_path / "long.bvh"
    header = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n}\nMOTION\nFrames: 8000\nFrame Time: 1\n"
    path.write_text(header + "0\n" * 8000)
    with pytest.raises(UserError, match=r"long\.bvh has 133 minutes of motion; expected at most 130"):
        read_motion(path, EXPRESSIVE, fps=15)


@pytest.fixture(scope="module", params=[EXPRESSIVE, GESTURE], ids=lambda skeleton: skeleton.name)
def real(request, private_data, tmp_path_factory):
    """The clips of a real recording, and the skeleton they were imported with."""
    out = tmp_path_factory.mktemp("real") / "corpus"
    import_bvh(private_data / "zeroeggs_067", out, ImportOptions(skeleton=request.param.name))
    return list(Corpus.open(out).clips("train")), request.param


def test_a_real_recording_is_whole(real):
    """Bones keep their length within 1 %, and words lie within the sound, which is as long as the motion."""
    clips, skeleton = real
    positions = np.concatenate([clip.positions for clip in clips])
    assert positions.shape[1:] == (skeleton.num_joints, 3)
    lengths = bone_lengths(skeleton, positions)
    assert (np.ptp(lengths, axis=0) < 0.01 * lengths.mean(axis=0)).all()
    assert 60 < len(positions) / 15 <= 69 and sum(len(clip.words) for clip in clips) > 130
    for clip in clips:
        assert all(0 <= word.start < word.end <= len(clip.audio) / 16000 + 1e-6 for word in clip.words)
        assert len(clip.audio) / 16000 == pytest.approx(len(clip.positions) / 15, abs=0.05)


def test_bones_that_are_none_keep_their_direction():
    """A shrug changes the distance from neck to shoulder in the file, and its direction alone in the clip."""
    rng = np.random.default_rng(0)
    moving = EXPRESSIVE.mean_pose + rng.normal(0, 0.005, (20, EXPRESSIVE.num_joints, 3))
    even = with_constant_lengths(moving, EXPRESSIVE)
    before, after = (positions_to_directions(EXPRESSIVE, positions) for positions in (moving, even))
    np.testing.assert_allclose(after, before, atol=1e-9)
    np.testing.assert_array_equal(even[:, 0], moving[:, 0])
    shoulder = np.linalg.norm(even[:, EXPRESSIVE.joint("left_shoulder")] - even[:, EXPRESSIVE.joint("neck")], axis=-1)
    assert np.ptp(shoulder) < 1e-9


def test_a_real_recording_is_a_person(real):
    """Upright, facing the viewer, hands where hands are."""
    clips, skeleton = real
    positions = np.concatenate([clip.positions for clip in clips])
    joint = dict(zip(skeleton.joints, np.moveaxis(positions, 1, 0), strict=True))
    mean = dict(zip(skeleton.joints, skeleton.mean_pose, strict=True))
    left, ahead = np.sign(mean["left_shoulder"][0]), np.sign(mean["nose"][2] - mean["neck"][2])
    trunk = joint["neck"] - joint["spine"]
    assert (trunk[:, 1] < 0).all()  # y points down
    assert np.degrees(np.arccos(-trunk[:, 1] / np.linalg.norm(trunk, axis=-1))).mean() < 20
    assert (left * joint["left_shoulder"][:, 0] > left * joint["right_shoulder"][:, 0]).all()
    for side, sign in (("left", left), ("right", -left)):
        wrist = joint[f"{side}_wrist"]
        assert sign * wrist[:, 0].mean() > 0.1
        assert wrist[:, 1].mean() > joint["nose"][:, 1].mean()
        assert ahead * (wrist - joint["spine"])[:, 2].mean() > 0.05
        for finger in ("thumb", "index", "middle", "ring", "pinky") if skeleton is EXPRESSIVE else ():
            parts = [joint[f"{side}_{finger}_{part}"] - wrist for part in (1, 2, 3)]
            reach = [np.linalg.norm(part, axis=-1).mean() for part in parts]
            assert 0.04 < reach[0] < reach[1] < reach[2] < 0.2
    behind = joint["left_ear"] if skeleton is EXPRESSIVE else joint["head"]
    assert np.mean(ahead * (joint["nose"] - behind)[:, 2] > 0) > 0.95

"""Folders of motion are paired by name, and files of any kind are read at one frame rate."""

import json

import numpy as np
import pytest
import soundfile
from fixtures.motions import swaying

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import from_folders, list_motions, read_directions, references_of
from ha2g_jax.metrics.beats.stops import angle_change_rates, make_clips
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import directions_to_positions

SECONDS = 4


@pytest.fixture
def write(skeleton, perform, tmp_path):
    """A function that writes clips to a folder and returns it."""

    def write(folder, names, *, fps=15, suffix=".npz", delay=0.0):
        clips = perform(len(names), SECONDS * 15, delay=delay)
        for name, clip in zip(names, clips, strict=True):
            path = tmp_path / folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            motion = Motion.from_directions(skeleton, np.repeat(clip.directions, fps // 15, axis=0), fps)
            if suffix == ".npz":
                motion.save(path.with_name(f"{path.name}.npz"))
            else:
                values = {"positions": motion.positions.tolist(), "fps": fps, "joint_names": motion.joint_names}
                path.with_name(f"{path.name}.json").write_text(json.dumps(values))
        return tmp_path / folder

    return write


def test_a_number_behind_the_name_or_a_folder_of_samples_makes_one_of_several_motions(write):
    motion = write("motion", ["a.1", "a_gestures.2", "b", "c.1", "b.x", "sample_2/b"])
    reference = write("reference", ["a", "b", "c.1"])
    folders = from_folders(motion, reference)
    assert [clip.id for clip in folders.motion] == ["a", "a", "b", "c.1", "b"]
    assert [clip.id for clip in folders.reference] == ["a", "b", "c.1"]
    assert folders.notes == ["files of motion that have no counterpart and are left out: 1, b.x"]


@pytest.mark.parametrize("fps", [24, 30])
def test_a_format_does_not_change_the_score(fps, tmp_path):
    """Also of motion beyond the range of joints, and of rates that are no multiple of the one that is scored."""
    motion = swaying(frames=5 * fps, fps=fps, size=0.9)
    beats = {}
    for suffix in {*formats.SUFFIXES} - {".vrma"}:  # which has other joints
        formats.export(motion, tmp_path / f"x{suffix}")
        found = read_directions(tmp_path / f"x{suffix}", "ted_expressive")
        [rate] = angle_change_rates(motion.skeleton, [found.directions])
        [clip] = make_clips([rate], [np.zeros(0)], 15)
        beats[suffix] = clip.beats
        assert found.fps == fps
    assert len(beats[".npz"]) > 3
    for suffix, times in beats.items():
        np.testing.assert_allclose(times, beats[".npz"], atol=1e-3, err_msg=suffix)


def write_sound(path, seconds=SECONDS):
    audio = np.zeros(int(seconds * 16000), np.float32)
    for start in range(8000, len(audio) - 800, 9000):
        audio[start : start + 800] = 0.5 * np.sin(0.2 * np.arange(800))
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, audio, 16000)


def test_files_are_paired_by_name_whatever_their_kind(write):
    motion = write("motion", ["a", "b_gestures", "extra"], suffix=".json")
    reference = write("reference", ["a", "b", "c", "d"], fps=30)
    for name in "ab":
        write_sound(reference / f"{name}.WAV")
    folders = from_folders(motion, reference)
    assert [clip.id for clip in folders.motion] == [clip.id for clip in folders.reference] == ["a", "b"]
    assert folders.skeleton.name == "ted_gesture"
    assert {clip.fps for clip in (*folders.motion, *folders.reference)} == {15}
    assert all(clip.num_frames == SECONDS * 15 for clip in folders.reference)
    assert all(clip.onsets is not None and len(clip.onsets) >= 5 for clip in folders.reference)
    assert folders.notes == [
        "files of motion that have no counterpart and are left out: 1, extra",
        "files of reference that have no counterpart and are left out: 2, c, d",
        "clips whose reference was resampled from 30 to 15 frames per second: 2",
    ]


def test_names_are_paired_in_any_unicode_form(write):
    names = ["caf\u00e9", "cafe\u0301"]  # the same to a reader; the second is that of macOS
    motion, reference = (write(folder, [name]) for folder, name in zip(("motion", "reference"), names, strict=True))
    write_sound(reference / f"{names[0]}.wav")
    (clip,) = from_folders(motion, reference).reference
    assert clip.id == names[0] and clip.onsets is not None


def test_sound_may_lie_beside_the_motion_and_is_missed_where_it_is_not(write):
    motion, reference = write("motion", ["a", "b"]), write("reference", ["a", "b"])
    write_sound(motion / "a.wav")
    folders = from_folders(motion, reference, with_audio=True)
    first, second = folders.reference
    assert first.onsets is not None and first.audio is not None and len(first.audio) == SECONDS * 16000
    assert second.onsets is None and second.audio is None


@pytest.mark.parametrize("name", ["a.wav", "a.1.wav", "a.2.wav"])
def test_sound_beside_any_of_several_motions_is_that_of_the_clip(write, name):
    motion, reference = write("motion", ["a.1", "a.2"]), write("reference", ["a"])
    write_sound(motion / name)
    (clip,) = from_folders(motion, reference).reference
    assert clip.onsets is not None


def test_sound_beside_the_motion_of_any_system_counts(write):
    reference = write("reference", ["a"])
    systems = [write(name, ["a"]) for name in ("first", "second")]
    write_sound(systems[0] / "a.wav")
    clips = [from_folders(system, reference).reference[0] for system in systems]
    assert references_of(clips)["a"] is references_of(reversed(clips))["a"] is clips[0]


def test_the_sound_of_beat2_lies_in_a_folder_beside_that_of_its_motion(write):
    motion, reference = write("motion", ["a"]), write("beat2/smplxflame_30", ["a"])
    write_sound(reference.parent / "wave16k" / "a.wav")
    (clip,) = from_folders(motion, reference).reference
    assert clip.onsets is not None


def test_a_reference_is_as_long_as_its_sound(write):
    motion, reference = write("motion", ["a"]), write("reference", ["a"])
    write_sound(reference / "a.wav", 3)
    folders = from_folders(motion, reference)
    assert folders.reference[0].num_frames == 45
    assert "clips whose reference was cut to the length of the sound: 1" in folders.notes


def test_subfolders_are_recordings(write):
    names = ["x/a", "x/b", "y/a"]
    folders = from_folders(write("motion", names), write("reference", names))
    assert [clip.id for clip in folders.reference] == names
    assert [clip.recording for clip in folders.reference] == ["x", "x", "y"]


def test_one_reference_file_is_that_of_all_motion(write):
    motion, reference = write("motion", ["take", "other"]), write("reference", ["person"]) / "person.npz"
    for given, count in ((motion, 2), (motion / "take.npz", 1)):
        folders = from_folders(given, reference)
        assert [clip.id for clip in folders.motion] == ["person"] * count
        assert [clip.id for clip in folders.reference] == ["person"] and not folders.notes


def test_a_second_motion_or_sound_of_a_clip_is_named(write):
    motion, reference = write("motion", ["a", "b_gestures"]), write("reference", ["a", "b"])
    (motion / "a.bvh").write_text("HIERARCHY")
    (motion / "b.json").write_text('{"words": []}')
    (reference / "notes.txt").touch()
    for suffix in (".wav", ".flac"):
        write_sound(reference / f"a{suffix}")
    left = "that are not read, as another is of the same clip"
    assert from_folders(motion, reference).notes == [
        f"files of motion {left}: 1, a.bvh beside a.npz",
        f"files of sound {left}: 1, a.flac beside a.wav",
    ]
    [note] = from_folders(motion / "a.npz", reference / "a.npz").notes
    assert note.startswith("files of sound")


def test_words_beside_motion_are_no_motion(write, tmp_path):
    motion, reference = write("motion", ["a"]), write("reference", ["a"])
    (reference / "a.json").write_text('{"words": []}')
    assert len(from_folders(motion, reference).reference) == 1


def test_folders_that_cannot_be_evaluated_are_refused(write, tmp_path):
    motion = write("motion", ["a", "b"])
    (tmp_path / "empty").mkdir()
    (tmp_path / "pack.zip").write_bytes(b"PK\x05\x06")
    with pytest.raises(UserError, match=r"pack\.zip is a \.zip.*; unpack it and give the folder$"):
        from_folders(tmp_path / "pack.zip", write("true", ["talk"]))
    with pytest.raises(UserError, match=r"no motion in .*empty; expected files of \.npz, \.bvh, \.glb"):
        from_folders(motion, tmp_path / "empty")


def test_other_rates_are_resampled_and_borders_with_them(skeleton, perform, tmp_path):
    directions = perform(1, 60)[0].directions
    positions = directions_to_positions(skeleton, directions.astype(np.float64))
    arrays = {"positions": np.repeat(positions, 2, axis=0), "joint_names": np.array(skeleton.joints)}
    np.savez(tmp_path / "a.npz", fps=30, borders=[60, 90], **arrays)
    found = read_directions(tmp_path / "a.npz", skeleton.name)
    assert (found.fps, len(found.directions), found.borders) == (30, 60, (30, 45))
    np.testing.assert_allclose(
        directions_to_positions(skeleton, found.directions.astype(np.float64)), positions, atol=1e-5
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": None}, "has no fps"),
        ({"positions": np.zeros((5, 3, 3)).tolist()}, "shape .5, 3, 3. for 10 joint names"),
        ({"positions": np.zeros((5, 10, 3)).tolist()}, "in one place in frame 0"),
    ],
)
def test_what_is_no_motion_is_refused(change, message, skeleton, tmp_path):
    positions = directions_to_positions(skeleton, np.repeat(skeleton.mean_directions[None], 5, axis=0))
    values = {"positions": positions.tolist(), "fps": 15.0, "joint_names": skeleton.joints} | change
    (tmp_path / "a.json").write_text(json.dumps({name: value for name, value in values.items() if value is not None}))
    with pytest.raises(UserError, match=rf"a\.json.*{message}"):
        read_directions(tmp_path / "a.json", skeleton.name)


def test_a_transcript_beside_takes_is_no_motion(tmp_path):
    (tmp_path / "talk.json").write_text('{"segments": []}')
    for seed in (0, 1):
        swaying().save(tmp_path / f"talk_gestures_seed{seed}.npz")
    assert sorted(list_motions(tmp_path)) == ["talk_gestures_seed0", "talk_gestures_seed1"]

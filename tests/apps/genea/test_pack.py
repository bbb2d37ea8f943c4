"""A pack has five samples of each clip in the arrays of BEAT2, says how each was made, and is whole or not there."""

import dataclasses
import hashlib
import json
import os
import pathlib
import re
import shutil
import zipfile
from typing import Any

import numpy as np
import pytest
from apps.genea.conftest import FRAMES
from scipy.spatial.transform import Rotation

from ha2g_jax import cli
from ha2g_jax.apps.genea import pack as packs
from ha2g_jax.apps.genea import sample
from ha2g_jax.apps.genea.pack import check_pack, write_pack
from ha2g_jax.apps.genea.sample import WIDTHS
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import from_folders
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.smplx_body import JOINTS, Body, template

FILES = {f"sample_{number}/{clip}.npz" for number in range(1, 6) for clip in FRAMES}
FILE = "sample_2/1_wayne_0_1_1.npz"


def files_of(folder: pathlib.Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_numpy_alone_finds_a_pack_as_the_rules_ask(written):
    """Nothing of this program reads the files here."""
    paths = sorted(written.glob("*/*.npz"))
    assert {path.relative_to(written).as_posix() for path in paths} == FILES
    motions = {}
    for path in paths:
        with np.load(path, allow_pickle=False) as found:
            arrays = dict(found)
        frames = FRAMES[path.stem]
        shapes = {name: values.shape for name, values in arrays.items() if values.dtype.kind == "f"}
        assert shapes == {"betas": (300,), "poses": (frames, 165), "expressions": (frames, 100), "trans": (frames, 3)}
        facts = {name: values.item() for name, values in arrays.items() if name not in shapes}
        assert facts == {"model": "smplx2020", "gender": "neutral", "mocap_frame_rate": 30}
        assert np.isfinite(arrays["poses"]).all() and np.ptp(arrays["poses"], axis=0).max() > 0.01
        motions.setdefault(path.stem, set()).add(arrays["poses"].tobytes())
    assert {clip: len(found) for clip, found in motions.items()} == dict.fromkeys(FRAMES, 5)
    assert check_pack(written).findings == []


def test_the_manifest_has_seeds_and_hashes(written, speech, debug_model):
    manifest = json.loads((written / "manifest.json").read_text())
    assert manifest["checkpoint"] and manifest["fps"] == 30
    for clip, facts in manifest["clips"].items():
        assert facts["speech"]["sha256"] == hashlib.sha256((speech / f"{clip}.wav").read_bytes()).hexdigest()
        assert [each["seed"] for each in facts["samples"]] == [7, 8, 9, 10, 11]
        for each in facts["samples"]:
            assert each["sha256"] == hashlib.sha256((written / each["file"]).read_bytes()).hexdigest()


def test_a_sample_is_what_generate_makes_with_its_seed(written, speech, debug_folder, tmp_path):
    command = ["generate", str(speech / "1_wayne_0_1_1.wav"), "--checkpoint", str(debug_folder), "--seed", "8"]
    assert cli.main([*command, "--fps", "30", "-o", str(tmp_path / "x.npz")]) == 0
    assert cli.main(["export", str(tmp_path / "x.npz"), "--rig", "smplx", "-o", str(tmp_path / "y.npz")]) == 0
    with np.load(tmp_path / "y.npz") as ours, np.load(written / "sample_2" / "1_wayne_0_1_1.npz") as packed:
        np.testing.assert_allclose(packed["poses"], ours["poses"], atol=1e-6)


def test_the_same_arguments_give_the_same_zip(written, speech, debug_folder, tmp_path):
    for name in ("a.zip", "b.zip"):
        write_pack(speech, tmp_path / name, checkpoint=debug_folder, seed=7, samples=5)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.testzip() is None
        assert {name: archive.read(name) for name in archive.namelist()} == files_of(written)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zip", "b.zip"]


def test_a_clip_of_beat2_moves_as_its_speaker_where_the_model_has_them(
    debug_model, speech, debug_folder, tmp_path, monkeypatch
):
    model = packs.load(debug_folder)
    [first, *_] = model.assets.speakers.values()
    model.assets.speakers["scott"] = first
    monkeypatch.setattr(packs, "load", lambda *_: model)
    write_pack(speech, tmp_path / "pack", samples=1)
    manifest = json.loads((tmp_path / "pack" / "manifest.json").read_text())
    kinds = {clip: facts["samples"][0]["style"]["kind"] for clip, facts in manifest["clips"].items()}
    assert kinds == {"1_wayne_0_1_1": "random", "2_scott_0_3_3": "speaker"}


@pytest.mark.parametrize("layout", ["{clip}.{number}.npz", "sample_{number}/{clip}.npz"])
def test_motion_of_another_system_is_packed(layout, speech, files, tmp_path):
    with np.load(files["BEAT2"]) as given:
        arrays: dict[str, Any] = {name: given[name] for name in ("trans", "poses", "mocap_frame_rate")}
    arrays["betas"] = np.full(300, 0.1)
    for clip, frames in FRAMES.items():
        for number in range(1, 6):
            path = tmp_path / "theirs" / layout.format(clip=clip, number=number)
            path.parent.mkdir(parents=True, exist_ok=True)
            repeated: dict[str, Any] = {
                name: np.resize(arrays[name], (frames, WIDTHS[name])) for name in ("trans", "poses")
            }
            repeated["poses"][:, 60:] *= number / 5
            np.savez(path, **arrays | repeated)
    pack = write_pack(speech, tmp_path / "pack.zip", motion=tmp_path / "theirs")
    assert check_pack(pack, speech).findings == []
    with zipfile.ZipFile(pack) as archive, archive.open("sample_3/2_scott_0_3_3.npz") as file, np.load(file) as found:
        np.testing.assert_array_equal(found["betas"], np.full(300, 0.1, np.float32))
        expected = np.resize(arrays["poses"], (90, 165))[:, 60:] * 3 / 5
        np.testing.assert_array_equal(found["poses"][:, 60:], expected.astype(np.float32))
    with pytest.raises(UserError, match=r"theirs has 5 motions of 1_wayne_0_1_1; expected 3 of each clip"):
        write_pack(speech, tmp_path / "other", motion=tmp_path / "theirs", samples=3)


def test_motion_of_any_kind_is_packed(speech, files, tmp_path):
    (tmp_path / "theirs").mkdir()
    for clip in FRAMES:
        (tmp_path / "theirs" / f"{clip}.bvh").write_text(files["GENEA BVH"].read_text())
    pack = write_pack(speech, tmp_path / "pack", motion=tmp_path / "theirs")
    verdict = check_pack(pack, speech)
    assert verdict.findings == []
    assert verdict.notes == ["one sample of each clip, as of a system without randomness; others need 5"]


def test_shapes_are_those_of_the_speakers(speech, debug_folder, tmp_path):
    (tmp_path / "beat2").mkdir()
    for speaker, value in (("1_wayne", 0.1), ("2_scott", 0.2)):
        np.savez(tmp_path / "beat2" / f"{speaker}_0_9_9.npz", betas=np.full(300, value))
    pack = write_pack(speech, tmp_path / "pack", checkpoint=debug_folder, samples=1, shapes=tmp_path / "beat2")
    for clip, value in (("1_wayne_0_1_1", 0.1), ("2_scott_0_3_3", 0.2)):
        with np.load(pack / "sample_1" / f"{clip}.npz") as found:
            np.testing.assert_allclose(found["betas"], np.full(300, value), rtol=1e-6)
    (tmp_path / "beat2" / "2_scott_0_9_9.npz").unlink()
    with pytest.raises(UserError, match="has no file of 2_scott_0_3_3 or its speaker"):
        write_pack(speech, tmp_path / "other", checkpoint=debug_folder, shapes=tmp_path / "beat2")


def test_evaluate_takes_a_pack_as_five_motions_of_each_clip(written):
    folders = from_folders(written, written / "sample_1")
    assert [clip.id for clip in folders.motion].count("2_scott_0_3_3") == 5
    assert len(folders.motion) == 10 and len(folders.reference) == 2
    assert not any("no counterpart" in note for note in folders.notes)


def change(pack, **changes):
    """Change arrays of one file; None removes one."""
    with np.load(pack / FILE) as found:
        arrays = dict(found) | changes
    np.savez(pack / FILE, **{name: values for name, values in arrays.items() if values is not None})
    (pack / "manifest.json").unlink(missing_ok=True)


def still(count):
    return {name: np.zeros((count, width), np.float32) for name, width in WIDTHS.items()}


LYING = np.zeros((69, 165), np.float32)
LYING[:, 0] = np.pi / 2  # the root of a person who lies

WRONG = {
    "no betas": ({"betas": None}, "no array betas"),
    "SMPL-H": ({"poses": np.zeros((69, 156), np.float32)}, r"poses has shape \(69, 156\)"),
    "not finite": ({"trans": np.full((69, 3), np.nan, np.float32)}, "trans has values of float32 that are not finite"),
    "objects": ({"poses": np.zeros((69, 165), object)}, "sample_2"),
    "rate as text": ({"mocap_frame_rate": np.array("30")}, "mocap_frame_rate is 30 of type <U2"),
    "z up": ({"poses": LYING}, "expected y"),
    "length": (still(70), "samples of 1_wayne_0_1_1 have different numbers of frames"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_named(case, pack):
    changes, expected = WRONG[case]
    change(pack, **changes)
    [finding] = check_pack(pack).findings
    assert "\n" not in finding and re.search(expected, finding)


def test_a_changed_file_differs_from_the_manifest(pack):
    with np.load(pack / FILE) as found:
        arrays = dict(found)
    arrays["trans"] = arrays["trans"] + np.float32(0.01)
    np.savez(pack / FILE, **arrays)
    assert check_pack(pack).findings == [f"{FILE} is not the file of manifest.json"]


def test_missing_and_superfluous_files_are_found(pack):
    (pack / "manifest.json").unlink()
    (pack / FILE).unlink()
    (pack / "notes.txt").write_text("ours")
    shutil.copy(pack / "sample_1" / "2_scott_0_3_3.npz", pack / "sample_3" / "2_scott_0_3_3.npz")
    verdict = check_pack(pack)
    assert verdict.notes == ["no manifest.json: hashes are not checked"]
    assert sorted(verdict.findings) == [
        "notes.txt does not belong to a pack; expected sample_K/CLIP.npz",
        "sample_2 has no 1_wayne_0_1_1, which others have",
        "two samples of 2_scott_0_3_3 are the same motion; a system without randomness gives one",
    ]
    shutil.rmtree(pack / "sample_5")
    assert "samples 1, 2, 3, 4; expected 1 to 5" in check_pack(pack).findings


def test_samples_that_the_manifest_has_and_the_pack_lacks_are_found(pack):
    for number in range(2, 6):
        shutil.rmtree(pack / f"sample_{number}")
    assert check_pack(pack).findings == ["8 files of manifest.json are missing, such as sample_2/1_wayne_0_1_1.npz"]


def test_names_with_accents_of_their_own_are_those_with_letters_that_have_them(pack, speech, tmp_path):
    """macOS and other systems write them apart, as e and an accent."""
    sounds, motions = tmp_path / "sounds", tmp_path / "motions"
    sounds.mkdir()
    motions.mkdir()
    shutil.copy(speech / "1_wayne_0_1_1.wav", sounds / "cafe\u0301.wav")
    shutil.copy(pack / FILE, motions / "cafe\u0301.npz")
    made = write_pack(sounds, tmp_path / "made", motion=motions)
    assert check_pack(made, sounds).findings == [] and (made / "sample_1" / "caf\u00e9.npz").is_file()
    (made / "sample_1" / "caf\u00e9.npz").rename(made / "sample_1" / "cafe\u0301.npz")
    manifest = json.loads((made / "manifest.json").read_text())
    (made / "manifest.json").write_text(json.dumps(manifest, ensure_ascii=False).replace("\u00e9", "e\u0301"))
    assert check_pack(made, sounds).findings == []


def test_a_name_that_no_archive_can_have_is_refused_before_the_work(speech, tmp_path):
    sounds = tmp_path / "sounds"
    sounds.mkdir()
    shutil.copy(speech / "1_wayne_0_1_1.wav", sounds / os.fsdecode(b"\xff.wav"))
    with pytest.raises(UserError, match="not UTF-8"):
        write_pack(sounds, tmp_path / "made.zip", checkpoint="nowhere")


def test_a_body_that_is_stored_with_z_up_stands_where_the_same_stands_with_y_up(tmp_path):
    """AMASS turns the body about the origin of the body model, from which the pelvis is 35 cm away."""
    pelvis, turn = np.array([0.003, -0.351, 0.012]), Rotation.from_euler("x", 90, degrees=True)
    body = Body(template().points + pelvis, template().directions)
    poses, trans = np.zeros((60, 55, 3)), np.tile([0.1, 1.3, 0.2], (60, 1))
    poses[:, JOINTS.index("left_shoulder")], poses[:, JOINTS.index("right_shoulder")] = [0, 0, -1.1], [0, 0, 1.1]
    up = poses.copy()
    up[:, 0] = (turn * Rotation.from_rotvec(poses[:, 0])).as_rotvec()
    facts = {"betas": np.zeros(10), "mocap_frame_rate": 30, "gender": "neutral"}
    np.savez(tmp_path / "y.npz", poses=poses.reshape(60, -1), trans=trans, **facts)
    np.savez(tmp_path / "z.npz", poses=up.reshape(60, -1), trans=turn.apply(trans + pelvis) - pelvis, **facts)
    found, expected = (sample.from_file(tmp_path / f"{name}.npz", 60, body=body).trans for name in "zy")
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_clips_and_lengths_are_those_of_the_speech(pack, speech, tmp_path):
    assert check_pack(pack, speech).findings == []
    other = tmp_path / "speech"
    other.mkdir()
    shutil.copy(speech / "1_wayne_0_1_1.wav", other / "2_scott_0_3_3.wav")
    shutil.copy(speech / "1_wayne_0_1_1.wav", other / "4_lawrence_0_1_1.wav")
    assert sorted(check_pack(pack, other).findings) == [
        "1_wayne_0_1_1 has no speech in " + str(other),
        "2_scott_0_3_3 has 90 frames, and 2.310 s of speech are 69",
        "4_lawrence_0_1_1 has no motion",
    ]


def test_the_command_prints_and_ends_with_1_or_0(pack, capsys):
    assert cli.main(["genea", "check", str(pack)]) == 0
    assert capsys.readouterr().out == f"{pack} is valid\n"
    (pack / FILE).write_bytes(b"PK")
    assert cli.main(["genea", "check", str(pack), "--json"]) == 1
    assert FILE in json.loads(capsys.readouterr().out)["findings"][0]


def test_a_damaged_zip_and_a_folder_of_something_else_are_refused(pack, tmp_path):
    archive = shutil.make_archive(str(tmp_path / "packed"), "zip", pack)
    assert cli.main(["genea", "check", archive]) == 0
    data = bytearray((tmp_path / "packed.zip").read_bytes())
    (tmp_path / "cut.zip").write_bytes(data[: len(data) // 2])
    data[data.index(b"PK\x01\x02") // 3] ^= 0xFF  # within a member
    (tmp_path / "flipped.zip").write_bytes(data)
    assert check_pack(tmp_path / "flipped.zip").findings  # of one file; the others are checked
    with zipfile.ZipFile(tmp_path / "broken.zip", "w") as broken:
        broken.write(pack / FILE, FILE)
        broken.writestr("manifest.json", "{")
    for path in (*(tmp_path / f"{name}.zip" for name in ("cut", "none", "broken")), pack / "sample_1"):
        with pytest.raises(UserError, match=rf"^[^\n]*{re.escape(str(path))}[^\n]*$"):
            check_pack(path)


@pytest.mark.parametrize("name", ["p.tar", "p.tar.gz", "p.7z"])
def test_another_archive_than_a_zip_is_refused_before_the_work(name, speech, tmp_path):
    with pytest.raises(UserError, match=r"p\.[^ ]+; name it p\S*\.zip$"):
        write_pack(speech, tmp_path / name, checkpoint="nowhere")
    assert not list(tmp_path.iterdir())


LEGS = [JOINTS.index(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "knee", "ankle")]


def test_poses_of_beat2_keep_every_value(files, person):
    made = sample.from_file(files["BEAT2"], 60)
    np.testing.assert_array_equal(made.poses, person.poses.reshape(60, 165).astype(np.float32))
    np.testing.assert_array_equal(made.trans, person.trans.astype(np.float32))
    with np.load(files["BEAT2"]) as given:
        np.testing.assert_array_equal(made.expressions, given["expressions"].astype(np.float32))


def test_a_sample_has_exactly_the_frames_of_its_speech(files, person):
    poses = person.poses.reshape(60, 165).astype(np.float32)
    longer, shorter = sample.from_file(files["BEAT2"], 75), sample.from_file(files["BEAT2"], 50)
    np.testing.assert_array_equal(longer.poses, np.concatenate([poses, poses[[-1] * 15]]))
    np.testing.assert_array_equal(shorter.poses, poses[:50])
    for count in (29, 91):
        with pytest.raises(UserError, match=r"beat2\.npz lasts 2\.00 s, and the speech"):
            sample.from_file(files["BEAT2"], count)
    with pytest.raises(UserError, match=r"as 0.5 to 1, so that 15 frames .* \(--source-fps 15\)"):
        sample.from_file(files["BEAT2"], 120)


def test_another_rate_becomes_30_on_the_sphere(files, person, tmp_path):
    """Every second frame of a slow rotation about one axis, at 15 frames per second, gives the others back."""
    angles = np.zeros((61, 55, 3))
    angles[:, 16] = np.linspace(0, 1.2, 61)[:, None] * np.array([0.0, 0.6, -0.8])
    np.savez(tmp_path / "x.npz", poses=angles[::2].reshape(31, 165), mocap_frame_rate=15)
    made = sample.from_file(tmp_path / "x.npz", 61)
    np.testing.assert_allclose(made.poses.reshape(61, 55, 3), angles, atol=1e-6)


@pytest.mark.parametrize("kind", ["AMASS SMPL-X", "AMASS SMPL-H", "BVH"])
def test_legs_and_root_are_as_given_with_y_up(kind, files, person):
    """Rotations of the legs are those of the file, whatever its axes; of a BVH they are from the mean of its poses."""
    made = sample.from_file(files[kind], 60)
    poses = made.poses.reshape(60, 55, 3)
    legs = person.poses[:, LEGS] if kind != "BVH" else poses[:, LEGS]
    np.testing.assert_allclose(poses[:, LEGS], legs, atol=1e-5)
    assert np.ptp(poses[:, LEGS], axis=0).max() > 0.1
    np.testing.assert_allclose(np.ptp(made.trans[:, 1]), np.ptp(person.trans[:, 1]), atol=1e-3)
    assert not made.betas.any()


def test_a_motion_without_legs_stands_still(files):
    motion = read_motion(files["BEAT2"])
    made = sample.from_motion(dataclasses.replace(motion, lower=None, face={}), 60)
    assert not made.trans.any()
    assert not made.poses.reshape(60, 55, 3)[:, LEGS].any()
    assert not made.expressions.any()


def test_with_a_body_model_the_soles_are_on_the_floor(files):
    """The origin of a body model is not its pelvis."""
    motion = dataclasses.replace(read_motion(files["BEAT2"]), lower=None)
    body = Body(template().points + np.array([0.0, -0.4, 0.02]), 0.1 * np.ones((61, 3, 1)))
    made = sample.from_motion(motion, 60, betas=np.array([0.5]), body=body)
    feet = body.shaped(made.betas)[[JOINTS.index("left_foot"), JOINTS.index("right_foot")]] + made.trans[0]
    np.testing.assert_allclose(feet[:, 1], 0.02, atol=1e-6)
    assert made.betas[0] == 0.5 and not made.betas[1:].any()

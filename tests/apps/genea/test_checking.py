"""The check finds each way in which a pack is wrong, and names the file in one line."""

import json
import shutil
import zipfile

import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.apps.genea.pack import check_pack
from ha2g_jax.errors import UserError

FILE = "sample_2/1_wayne_0_1_1.npz"


def change(pack, **changes):
    """Change arrays of one file; None removes one."""
    with np.load(pack / FILE) as found:
        arrays = dict(found) | changes
    np.savez(pack / FILE, **{name: values for name, values in arrays.items() if values is not None})
    (pack / "manifest.json").unlink(missing_ok=True)


def lying(pack):
    """Poses of a person for whom z is up."""
    with np.load(pack / FILE) as found:
        poses = found["poses"].copy()
    poses[:, :3] = [np.pi / 2, 0, 0]
    return poses


WRONG = {
    "no betas": ({"betas": None}, "no array betas"),
    "short betas": ({"betas": np.zeros(16, np.float32)}, r"betas has shape \(16,\), expected \(300\)"),
    "SMPL-H": ({"poses": np.zeros((69, 156), np.float32)}, r"poses has shape \(69, 156\)"),
    "not finite": ({"trans": np.full((69, 3), np.nan, np.float32)}, "trans has values of float32 that are not finite"),
    "objects": ({"poses": np.zeros((69, 165), object)}, "sample_2"),
    "rate": ({"mocap_frame_rate": np.array(15)}, "mocap_frame_rate is 15 of type int64, expected the number 30"),
    "rate as text": ({"mocap_frame_rate": np.array("30")}, "mocap_frame_rate is 30 of type <U2"),
    "gender": ({"gender": np.array(b"neutral")}, "gender is"),
    "other body": ({"model": np.array("smplh")}, "model is 'smplh', expected smplx2020"),
    "no frames": (
        {name: np.zeros((0, n)) for name, n in (("poses", 165), ("trans", 3), ("expressions", 100))},
        "shape",
    ),
    "length": (
        {name: np.zeros((70, n), np.float32) for name, n in (("poses", 165), ("trans", 3), ("expressions", 100))},
        "samples of 1_wayne_0_1_1 have different numbers of frames",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_named(case, pack):
    changes, expected = WRONG[case]
    change(pack, **changes)
    [finding] = check_pack(pack).findings
    assert "\n" not in finding
    with pytest.raises(AssertionError, match=expected):
        raise AssertionError(finding)


def test_z_up_is_found(pack):
    change(pack, poses=lying(pack))
    [finding] = check_pack(pack).findings
    assert finding.startswith(FILE) and "expected y" in finding


def test_a_changed_file_differs_from_the_manifest(pack):
    with np.load(pack / FILE) as found:
        arrays = dict(found)
    arrays["trans"] = arrays["trans"] + np.float32(0.01)
    np.savez(pack / FILE, **arrays)
    assert check_pack(pack).findings == [f"{FILE} is not the file of manifest.json"]


def test_a_manifest_with_other_values_names_no_file(pack):
    content = json.loads((pack / "manifest.json").read_text())
    for facts in content["clips"].values():
        facts["samples"] = [{"file": [1], "sha256": None}]
    (pack / "manifest.json").write_text(json.dumps(content))
    assert f"{FILE} is not the file of manifest.json" in check_pack(pack).findings


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


def test_a_damaged_zip_and_a_folder_of_something_else_are_refused(pack, tmp_path, capsys):
    archive = shutil.make_archive(str(tmp_path / "packed"), "zip", pack)
    assert cli.main(["genea", "check", archive]) == 0
    data = bytearray((tmp_path / "packed.zip").read_bytes())
    (tmp_path / "cut.zip").write_bytes(data[: len(data) // 2])
    with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
        pass
    flipped = bytearray(data)
    flipped[data.index(b"PK\x01\x02") // 3] ^= 0xFF  # within a member
    (tmp_path / "flipped.zip").write_bytes(flipped)
    assert check_pack(tmp_path / "flipped.zip").findings  # of one file; the others are checked
    for name in ("cut.zip", "empty.zip", "none.zip", "."):
        with pytest.raises(UserError) as caught:
            check_pack(tmp_path / name if name != "." else tmp_path / "pack" / "sample_1")
        assert "\n" not in str(caught.value)

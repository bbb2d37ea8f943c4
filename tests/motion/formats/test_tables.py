"""JSON, CSV and SMPL-X arrays hold what forward kinematics and the importer find."""

import csv
import json

import numpy as np
import pytest

from ha2g_jax.motion import rotations, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import tables
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.motion.rigs import load_rig, retarget
from ha2g_jax.skeleton import load_skeleton, positions_to_directions


@pytest.mark.parametrize("rig", ["ha2g", "unreal"])
def test_json_holds_positions_directions_and_rotations(animate, tmp_path, rig):
    animation = animate(rig=rig)
    tables.write_json(tmp_path / "m.json", animation)
    read = json.loads((tmp_path / "m.json").read_text())
    assert (read["rig"], read["fps"], read["meta"]["seed"]) == (rig, 15.0, 3)
    assert [joint["name"] for joint in read["joints"]] == list(animation.armature.joints)
    frames = read["frames"]
    assert [frame["time"] for frame in frames[:3]] == [0.0, 0.066667, 0.133333]
    _, positions = world(animation)
    np.testing.assert_allclose([frame["positions"] for frame in frames], positions, atol=1e-6)
    np.testing.assert_allclose([frame["rotations"] for frame in frames], animation.rotations, atol=1e-6)
    parents = [joint["parent"] for joint in read["joints"]]
    expected = rotations.unit(positions[:, -1] - positions[:, parents[-1]])
    np.testing.assert_allclose([frame["directions"][-1] for frame in frames], expected, atol=1e-5)
    if rig == "ha2g":
        for name in ("spine", "left_clavicle", "left_index_0"):  # at their parents' place
            assert frames[3]["directions"][animation.armature.joint(name)] == [0, 0, 0]


def test_csv_has_a_named_column_for_every_number_of_the_json(animate, tmp_path):
    animation = animate("ted_gesture")
    tables.write_csv(tmp_path / "m.csv", animation)
    tables.write_json(tmp_path / "m.json", animation)
    frames = json.loads((tmp_path / "m.json").read_text())["frames"]
    with (tmp_path / "m.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(frames)
    assert len(rows[0]) == 2 + 10 * len(animation.armature.joints)
    for row, frame in zip(rows, frames, strict=True):
        index = animation.armature.joint("left_wrist")
        assert float(row["time"]) == frame["time"]
        assert [float(row[f"left_wrist_{axis}"]) for axis in "xyz"] == frame["positions"][index]
        assert [float(row[f"left_wrist_d{axis}"]) for axis in "xyz"] == frame["directions"][index]
        assert [float(row[f"left_wrist_q{axis}"]) for axis in "xyzw"] == frame["rotations"][index]


def test_the_importer_of_smplx_finds_the_same_directions(animate, tmp_path):
    """The importer hangs the rotations on a body in SMPL-X's T-pose, by code of its own."""
    skeleton = load_skeleton("ted_expressive")
    tables.write_smplx(tmp_path / "m.npz", animate(rig="smplx"))
    read = read_smplx(tmp_path / "m.npz", skeleton, template(), fps=15, up="y")
    ours = animate()
    _, positions = world(ours)
    positions = positions[:, [ours.armature.joint(name) for name in skeleton.joints]] * [1, -1, -1]
    expected = positions_to_directions(skeleton, positions)
    found = positions_to_directions(skeleton, read.positions.astype(np.float64))
    away = np.rad2deg(np.arccos(np.clip((found * expected).sum(axis=-1), -1, 1)))
    exact = [
        bone
        for bone, (_, child) in enumerate(skeleton.bones)
        if skeleton.joints[child].endswith(("_elbow", "_wrist", "_2", "_3"))
    ]
    assert len(exact) == 24
    assert away[:, exact].max() < 0.3


def test_a_zero_pose_that_is_read_and_written_keeps_collars_and_shoulders(tmp_path):
    """The skeleton's bone from the neck to a shoulder is the collar of a rig, whose own bone points elsewhere."""
    np.savez(tmp_path / "zero.npz", poses=np.zeros((30, 165), np.float32), mocap_frame_rate=30)
    animation = retarget(solver.animate(read_motion(tmp_path / "zero.npz")), load_rig("smplx"))
    names = [f"{side}_{joint}" for side in ("left", "right") for joint in ("collar", "shoulder")]
    turned = rotations.to_vector(animation.rotations[:, [animation.armature.joint(name) for name in names]])
    assert np.rad2deg(np.linalg.norm(turned, axis=-1)).max() < 3


def test_fields_and_what_stays_zero(animate, tmp_path):
    tables.write_smplx(tmp_path / "m.npz", animate(rig="smplx"))
    with np.load(tmp_path / "m.npz", allow_pickle=False) as arrays:
        fields = dict(arrays)
    assert (fields["poses"].shape, fields["poses"].dtype, fields["trans"].shape) == ((12, 165), np.float32, (12, 3))
    assert (fields["mocap_frame_rate"], str(fields["gender"])) == (15, "neutral")
    assert not fields["betas"].any()
    poses = fields["poses"].reshape(12, 55, 3)
    moved = {
        str(name) for name, values in zip(fields["joint_names"], poses.swapaxes(0, 1)) if np.abs(values).max() > 1e-6
    }
    assert moved.isdisjoint(("pelvis", "jaw", "left_eye_smplhf"))
    assert not any(part in name for name in moved for part in ("hip", "knee", "foot"))
    assert moved >= {"spine3", "neck", "left_shoulder", "right_elbow", "left_index1", "right_pinky2"}

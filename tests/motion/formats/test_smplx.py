"""SMPL-X poses, read back by this package's importer of such files, point where the motion points."""

import numpy as np

from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import tables
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.skeleton import load_skeleton, positions_to_directions


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


def test_fields_and_what_stays_zero(animate, tmp_path):
    animation = animate(rig="smplx")
    tables.write_smplx(tmp_path / "m.npz", animation)
    with np.load(tmp_path / "m.npz", allow_pickle=False) as arrays:
        fields = dict(arrays)
    assert fields["poses"].shape == (12, 165)
    assert fields["poses"].dtype == np.float32
    assert fields["trans"].shape == (12, 3)
    assert fields["mocap_frame_rate"] == 15
    assert str(fields["gender"]) == "neutral"
    assert not fields["betas"].any()
    names = [str(name) for name in fields["joint_names"]]
    poses = fields["poses"].reshape(12, 55, 3)
    moves = {name: bool(np.abs(poses[:, index]).max() > 1e-6) for index, name in enumerate(names)}
    assert not any(moves[name] for name in names if "hip" in name or "knee" in name or "foot" in name)
    assert not any(moves[name] for name in ("pelvis", "jaw", "left_eye_smplhf"))
    assert all(
        moves[name] for name in ("spine3", "neck", "left_shoulder", "right_elbow", "left_index1", "right_pinky2")
    )

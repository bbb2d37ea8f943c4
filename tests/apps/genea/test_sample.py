"""A motion of any kind becomes the arrays of BEAT2; poses of SMPL-X keep their values."""

import dataclasses

import numpy as np
import pytest

from ha2g_jax.apps.genea import sample
from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.smplx_body import JOINTS, Body, template

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

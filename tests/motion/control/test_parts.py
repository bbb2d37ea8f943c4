"""A motion is given by its rotations from any pose, and scaled rotations keep the shape of the hands."""

import numpy as np

from ha2g_jax.motion.control.parts import (
    apply_rotations,
    arm_parts,
    bones_of,
    parts,
    rest_pose,
    rotations_from,
    scale_about,
)
from ha2g_jax.motion.rotations import about, rotate
from ha2g_jax.skeleton import load_skeleton


def test_rotations_give_the_poses_back(skeleton, gestures):
    motion = gestures(skeleton)
    rotations = rotations_from(rest_pose(skeleton), motion, parts(skeleton))
    poses = apply_rotations(rest_pose(skeleton), rotations, parts(skeleton))
    assert sorted(bones_of(parts(skeleton))) == list(range(skeleton.num_bones))
    np.testing.assert_allclose(poses, motion[:, bones_of(parts(skeleton))], atol=1e-6)


def test_scale_0_is_the_pose_and_1_the_motion(skeleton, gestures):
    motion, pose = gestures(skeleton), gestures(skeleton, seed=3)[7]
    scale = np.linspace(0, 1, len(motion))
    scaled = scale_about(pose, motion, scale, parts(skeleton))
    np.testing.assert_array_equal(scaled[0], pose)
    np.testing.assert_array_equal(scaled[-1], motion[-1])
    np.testing.assert_array_equal(scale_about(pose, motion, 1.0, parts(skeleton)), motion)


def hand_turned(angles: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """The bones of the left hand where its turns about the forearm are scaled, and where the scaled turns have them."""
    skeleton = load_skeleton("ted_expressive")
    pose, arm = rest_pose(skeleton).astype(np.float64), arm_parts(skeleton, "left")
    axis, hand = pose[skeleton.bone("left_wrist")], [bone for part in arm[2:] for bone in part.bones]
    turned = np.repeat(pose[None], len(angles), axis=0)
    turned[:, hand] = rotate(about(axis, angles)[:, None], pose[hand])
    scaled = scale_about(pose, turned.astype(np.float32), scale, arm)
    return scaled[:, hand], rotate(about(axis, scale * angles)[:, None], pose[hand])


def test_a_hand_turned_over_stays_whole_half_way():
    """Half-way between palm down and palm up the means of the directions of the bones would cancel."""
    found, expected = hand_turned(np.linspace(0, np.pi - 0.1, 18), 0.5)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_hand_that_turns_past_half_a_turn_does_not_jump():
    found, _ = hand_turned(np.linspace(2.6, 3.8, 60), 0.5)
    assert np.linalg.norm(np.diff(found, axis=0), axis=-1).max() < 0.05


def test_an_arm_that_is_raised_past_the_opposite_of_its_rest_does_not_jump():
    skeleton = load_skeleton("ted_expressive")
    pose, arm = rest_pose(skeleton).astype(np.float64), arm_parts(skeleton, "left")
    bone = skeleton.bone("left_elbow")
    axis = np.cross(pose[bone], [0.0, 0, 1])
    raised = np.repeat(pose[None], 60, axis=0)
    bones = [bone for part in arm for bone in part.bones]
    raised[:, bones] = rotate(about(axis / np.linalg.norm(axis), np.linspace(2.6, 3.7, 60))[:, None], pose[bones])
    scaled = scale_about(pose, raised.astype(np.float32), 0.5, arm)
    assert np.linalg.norm(np.diff(scaled[:, bones], axis=0), axis=-1).max() < 0.05

"""A motion is given by its rotations from any pose, and scaled rotations keep the shape of the hands."""

import numpy as np
import pytest

from ha2g_jax.motion.control.parts import HAND, apply_rotations, arm_parts, parts, power, rest_pose, rotations_from
from ha2g_jax.motion.control.scaling import limit_scale, scale_about
from ha2g_jax.motion.rotations import about, rotate
from ha2g_jax.skeleton import load_skeleton


def test_every_bone_is_in_one_part_after_the_one_it_is_attached_to(skeleton):
    found = parts(skeleton)
    assert sorted(bone for part in found for bone in part.bones) == list(range(skeleton.num_bones))
    seen = {-1}
    for part in found:
        assert part.parent in seen
        seen.update(part.bones)


def test_rotations_give_the_poses_back(skeleton, gestures):
    motion = gestures(skeleton)
    rotations = rotations_from(rest_pose(skeleton), motion, parts(skeleton))
    for bone, vectors in apply_rotations(rest_pose(skeleton), rotations, parts(skeleton)).items():
        np.testing.assert_allclose(vectors, motion[:, bone], atol=1e-6)


def test_scale_0_is_the_pose_and_1_the_motion(skeleton, gestures):
    motion, pose = gestures(skeleton), gestures(skeleton, seed=3)[7]
    scale = np.linspace(0, 1, len(motion))
    scaled = scale_about(pose, motion, scale, parts(skeleton))
    np.testing.assert_array_equal(scaled[0], pose)
    np.testing.assert_array_equal(scaled[-1], motion[-1])
    np.testing.assert_array_equal(scale_about(pose, motion, 1.0, parts(skeleton)), motion)


def test_a_hand_turned_over_stays_whole_half_way():
    """Half-way between palm down and palm up the means of the directions of the bones would cancel."""
    skeleton = load_skeleton("ted_expressive")
    pose = rest_pose(skeleton).astype(np.float64)
    arm = arm_parts(skeleton, "left")
    forearm = skeleton.bone("left_wrist")
    hand = [bone for part in arm[2:] for bone in part.bones]
    turned = np.repeat(pose[None], 18, axis=0)
    angles = np.linspace(0, np.pi - 0.1, 18)
    turned[:, hand] = rotate(about(pose[forearm], angles)[:, None], pose[hand])
    half = scale_about(pose, turned.astype(np.float32), 0.5, arm)[:, hand]
    np.testing.assert_allclose(half, rotate(about(pose[forearm], angles / 2)[:, None], pose[hand]), atol=1e-5)


def test_a_hand_that_turns_past_half_a_turn_does_not_jump():
    skeleton = load_skeleton("ted_expressive")
    pose = rest_pose(skeleton).astype(np.float64)
    (hand,) = ([*part.bones] for part in arm_parts(skeleton, "left") if part.kind == HAND)
    axis = pose[skeleton.bone("left_wrist")]
    turned = np.repeat(pose[None], 60, axis=0)
    turned[:, hand] = rotate(about(axis, np.linspace(2.6, 3.8, 60))[:, None], pose[hand])
    half = scale_about(pose, turned.astype(np.float32), 0.5, arm_parts(skeleton, "left"))
    assert np.linalg.norm(np.diff(half, axis=0), axis=-1).max() < 0.05


def test_power_scales_the_angle():
    axis = np.array([[0.6, 0, 0.8]])
    for angle in (0.5, 3.0, 3.6):  # the last above 180 degrees
        np.testing.assert_allclose(power(about(axis, [angle]), np.array([0.5])), about(axis, [angle / 2]), atol=1e-9)
    np.testing.assert_allclose(power(np.array([[0.0, 0, 0, 1]]), np.array([0.5])), [[0, 0, 0, 1]])


@pytest.mark.parametrize("scale", [0.0, 0.3, 1.0])
def test_a_scale_up_to_1_is_not_limited(scale):
    np.testing.assert_array_equal(limit_scale(scale, np.array([0.5, 3.0]), np.array([1.0, 0.0])), scale)


def test_a_scale_above_1_adds_less_than_the_headroom():
    rise, headroom = np.meshgrid([-0.7, 1e-9, 0.2, 2.0], [0.0, 0.1, 5.0])
    scales = limit_scale(1.8, rise.ravel(), headroom.ravel())
    assert np.all((scales >= 1) & (scales <= 1.8))
    assert np.all((scales - 1) * np.abs(rise.ravel()) <= np.maximum(headroom.ravel(), 1e-3) + 1e-9)
    assert limit_scale(1.8, np.array([0.1]), np.array([5.0]))[0] == pytest.approx(1.8, abs=1e-3)

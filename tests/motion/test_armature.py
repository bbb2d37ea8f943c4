"""The armature stands in a T-pose, has every joint of the skeleton in its place, and forward kinematics moves it."""

import numpy as np
import pytest

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, carriers, export_axes, ha2g_armature, rest_directions, world
from ha2g_jax.skeleton import SKELETONS, load_skeleton


def at_rest(armature: Armature) -> dict[str, np.ndarray]:
    animation = Animation(armature, armature.rest[None], np.zeros((1, 3)), 15.0, {})
    _, positions = world(animation)
    return dict(zip(armature.joints, positions[0], strict=True))


def test_all_joints_are_there_each_after_its_parent_with_the_lengths_of_the_skeleton(skeleton):
    armature = ha2g_armature(skeleton)
    assert len(set(armature.joints)) == len(armature.joints)
    assert set(skeleton.joints) < set(armature.joints)
    assert armature.parents[0] == -1
    assert all(parent < joint for joint, parent in enumerate(armature.parents))
    np.testing.assert_array_equal(armature.rest, np.tile(rotations.IDENTITY, (len(armature.joints), 1)))
    places = at_rest(armature)
    for length, (parent, child) in zip(skeleton.lengths, skeleton.bones, strict=True):
        bone = places[skeleton.joints[child]] - places[skeleton.joints[parent]]
        assert np.linalg.norm(bone) == pytest.approx(length, abs=1e-6)


def test_each_bone_has_a_joint_of_its_own_that_turns_it(skeleton):
    armature = ha2g_armature(skeleton)
    turning = carriers(skeleton)
    assert len(set(turning)) == skeleton.num_bones
    for bone, (parent, child) in enumerate(skeleton.bones):
        end, start = armature.joint(skeleton.joints[child]), armature.joint(turning[bone])
        assert armature.parents[end] == start
        if turning[bone] != skeleton.joints[parent]:
            assert armature.parents[start] == armature.joint(skeleton.joints[parent])
            np.testing.assert_array_equal(armature.offsets[start], 0)


def test_carriers_have_the_names_that_are_documented():
    expressive, gesture = (set(ha2g_armature(load_skeleton(name)).joints) for name in SKELETONS)
    assert {"left_clavicle", "right_clavicle", "head", "left_eye_0", "left_index_0", "right_thumb_0"} < expressive
    assert gesture - set(load_skeleton("ted_gesture").joints) == {"left_clavicle", "right_clavicle", "nose_0"}


def test_the_rest_pose_is_a_t_pose_that_faces_ahead(skeleton):
    places = at_rest(ha2g_armature(skeleton))
    for side, sign in (("left", 1), ("right", -1)):
        arm = places[f"{side}_wrist"] - places[f"{side}_shoulder"]
        np.testing.assert_allclose(rotations.unit(arm), [sign, 0, 0], atol=1e-12)
        mirrored = places[f"{side}_elbow"] * [sign, 1, 1]
        np.testing.assert_allclose(mirrored, places["left_elbow"], atol=1e-6)
    assert rotations.unit(places["neck"]) @ [0, 1, 0] == pytest.approx(1)
    assert places["nose"][1] > places["neck"][1]
    assert places["nose"][2] > 0.05
    assert abs(places["nose"][0]) < 1e-6


def test_both_skeletons_are_exported_upright_with_the_left_at_plus_x_facing_plus_z(skeleton):
    mean = skeleton.mean_pose * export_axes(skeleton)
    assert np.prod(export_axes(skeleton)) == 1  # a rotation, not a mirror
    assert mean[skeleton.joint("left_shoulder"), 0] > 0.1
    assert mean[skeleton.joint("neck"), 1] > mean[0, 1] + 0.1
    assert mean[skeleton.joint("nose"), 2] > mean[skeleton.joint("neck"), 2] + 0.03
    np.testing.assert_allclose(np.linalg.norm(rest_directions(skeleton), axis=-1), 1, atol=1e-12)


def test_a_turned_shoulder_moves_the_arm_and_nothing_else():
    armature = ha2g_armature(load_skeleton("ted_gesture"))
    local = np.stack([armature.rest, armature.rest])
    shoulder = armature.joint("left_shoulder")
    local[1, shoulder] = rotations.about(np.array([0.0, 0.0, 1.0]), -np.pi / 2)
    turned, positions = world(Animation(armature, local, np.array([[0.0, 0, 0], [0, 1, 0]]), 15.0, {}))
    moved = {
        joint
        for joint, shift in zip(armature.joints, positions[1] - positions[0] - [0, 1, 0], strict=True)
        if np.abs(shift).max() > 1e-9
    }
    assert moved == {"left_elbow", "left_wrist"}
    length = positions[0, armature.joint("left_wrist"), 0] - positions[0, shoulder, 0]
    hanging = positions[1, shoulder] - [0, length, 0]
    np.testing.assert_allclose(positions[1, armature.joint("left_wrist")], hanging, atol=1e-12)
    np.testing.assert_allclose(turned[1, armature.joint("left_wrist")], local[1, shoulder], atol=1e-12)

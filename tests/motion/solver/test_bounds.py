"""Joints stay within the range of the table, what is within is not touched, and the table is about our joints."""

import json
from importlib import resources

import numpy as np
import pytest

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import ha2g_armature
from ha2g_jax.motion.solver.bounds import clamp, from_angles, joint_angles, joint_limits, limits_of, without_jumps
from ha2g_jax.skeleton import load_skeleton

EXPRESSIVE = ha2g_armature(load_skeleton("ted_expressive"))
EXPRESSIVE_JOINTS = len(EXPRESSIVE.joints)


def rotated(name: str, **degrees: float) -> np.ndarray:
    angles = joint_angles(name, rotations.IDENTITY[None])
    return from_angles(name, np.deg2rad([[degrees.get(angle, 0.0) for angle in angles]]))


def test_every_line_of_the_table_is_about_a_joint_and_has_sources():
    used = [limits_of(joint) for joint in EXPRESSIVE.joints]
    assert all(limits in used for limits in joint_limits().values())
    for limits in joint_limits().values():
        assert all(low < 0 < high for low, high in limits.values())
    table = json.loads((resources.files("ha2g_jax") / "assets" / "joint_limits.json").read_text(encoding="utf-8"))
    assert "American Academy" in " ".join(table["comment"])
    assert limits_of("nose_0") == limits_of("head") != {}
    assert limits_of("spine") == limits_of("left_index_3") == {}


def test_random_rotations_end_within_the_limits_and_stay_there(skeleton):
    armature = ha2g_armature(skeleton)
    local = rotations.unit(np.random.default_rng(0).normal(size=(100, len(armature.joints), 4)))
    clamped = clamp(armature, local)
    for joint, joint_name in enumerate(armature.joints):
        if not (limits := limits_of(joint_name)):
            np.testing.assert_array_equal(clamped[:, joint], local[:, joint])
            continue
        for angle, values in joint_angles(joint_name, clamped[:, joint]).items():
            low, high = limits.get(angle, (-180, 180))
            assert np.rad2deg(values).min() > low - 1e-3
            assert np.rad2deg(values).max() < high + 1e-3
    again = clamp(armature, clamped)
    np.testing.assert_allclose(rotations.angle_between(clamped, again), 0, atol=1e-6)


def test_a_joint_within_its_limits_is_not_touched_when_another_is_clamped():
    local = np.tile(rotations.IDENTITY, (1, len(EXPRESSIVE.joints), 1))
    elbow, wrist = EXPRESSIVE.joint("left_elbow"), EXPRESSIVE.joint("left_wrist")
    local[:, elbow] = rotated("left_elbow", forward=-80)
    local[:, wrist] = rotated("left_wrist", up=30, forward=10, twist=40)
    clamped = clamp(EXPRESSIVE, local)
    changed = np.flatnonzero((clamped != local).any(axis=(0, 2)))
    assert list(changed) == [elbow]
    low, _ = limits_of("left_elbow")["forward"]
    assert np.rad2deg(joint_angles("left_elbow", clamped[:, elbow])["forward"]) == pytest.approx(low)


@pytest.mark.parametrize(
    ("joint", "degrees", "moved"),
    [
        ("left_elbow", {"forward": 90}, (0, 0, 1)),
        ("right_elbow", {"forward": 90}, (0, 0, 1)),
        ("left_wrist", {"up": 60}, (0.5, 0.866, 0)),
        ("right_wrist", {"up": 60}, (-0.5, 0.866, 0)),
        ("left_wrist", {"forward": 30}, (0.866, 0, 0.5)),
        ("right_index_1", {"up": -90}, (0, -1, 0)),
    ],
)
def test_forward_and_up_are_where_the_table_says_on_both_sides(joint, degrees, moved):
    out = np.array([1.0 if joint.startswith("left") else -1.0, 0.0, 0.0])
    np.testing.assert_allclose(rotations.rotate(rotated(joint, **degrees), out), [moved], atol=1e-3)


def test_twist_is_pronation_on_both_sides_and_the_head_yaws_to_the_left():
    for side in ("left", "right"):
        thumb = rotations.rotate(rotated(f"{side}_elbow", twist=90), np.array([0.0, 0.0, 1.0]))
        np.testing.assert_allclose(thumb, [[0, -1, 0]], atol=1e-9)
    nose = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(rotations.rotate(rotated("head", yaw=90), nose), [[1, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(rotations.rotate(rotated("head", pitch=90), nose), [[0, -1, 0]], atol=1e-9)
    top = rotations.rotate(rotated("head", roll=90), np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(top, [[1, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("joint", ["left_wrist", "right_shoulder", "left_index_1", "head", "left_thumb_1"])
def test_a_joint_that_rotates_by_360_degrees_does_not_jump_from_end_to_end(joint):
    along = np.array([1.0, 0.0, 0.0]) if joint != "head" else np.array([0.0, 1.0, 0.0])
    local = np.tile(rotations.IDENTITY, (360, len(EXPRESSIVE.joints), 1))
    index = EXPRESSIVE.joint(joint)
    local[:, index] = rotations.about(along, np.linspace(0, 2 * np.pi, 360))
    clamped = clamp(EXPRESSIVE, local)[:, index]
    assert np.rad2deg(rotations.angle_between(clamped[1:], clamped[:-1])).max() < 8


def test_from_one_end_of_a_range_to_the_other_takes_several_frames():
    joint = EXPRESSIVE.joint("left_wrist")
    free, ends = np.broadcast_to(rotations.IDENTITY, (2, 9, EXPRESSIVE_JOINTS, 4)).copy()
    ends[:4, joint], ends[4:, joint] = rotated("left_wrist", up=60)[0], rotated("left_wrist", up=-60)[0]
    ends[6, joint] = rotated("left_wrist", up=60)[0]
    slowed = without_jumps(free, ends)
    steps = np.rad2deg(rotations.angle_between(slowed[1:], slowed[:-1]))[:, joint]
    np.testing.assert_allclose(steps, [0, 0, 0, 80, 40, 80, 80, 0], atol=1e-6)
    np.testing.assert_array_equal(np.delete(slowed, joint, axis=1), np.delete(ends, joint, axis=1))


def test_what_turns_fast_itself_may_do_so_clamped():
    joint = EXPRESSIVE.joint("left_wrist")
    free = np.broadcast_to(rotations.IDENTITY, (2, EXPRESSIVE_JOINTS, 4)).copy()
    free[:, joint] = np.concatenate([rotated("left_wrist", up=60), rotated("left_wrist", up=-60)])
    np.testing.assert_array_equal(without_jumps(free, free), free)

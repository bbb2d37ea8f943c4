"""Bones keep their directions; twists are those of a body, held where they do not show, and of a real capture."""

import numpy as np
import numpy.typing as npt
import pytest
from fixtures.motions import swaying

from ha2g_jax.motion import rotations, solver
from ha2g_jax.motion.armature import Animation, export_axes, ha2g_armature, world
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers.body import mean_heading
from ha2g_jax.motion.readers.bvh import read_bvh
from ha2g_jax.motion.readers.bvh_motion import read_motion, world_motion
from ha2g_jax.motion.readers.joint_maps import choose_map
from ha2g_jax.motion.solver.bounds import joint_angles, limits_of
from ha2g_jax.skeleton import Skeleton, load_skeleton, mirror_directions, positions_to_directions

X, Y, Z = np.eye(3)
FAN = ("index", "middle", "ring", "pinky")


def posed(skeleton: Skeleton, joint_rotations: dict[str, np.ndarray], fps: float = 15) -> Animation:
    """The armature with some joints rotated, (T, 4) each, relative to their parents."""
    armature = ha2g_armature(skeleton)
    frames = max(len(rotation) for rotation in joint_rotations.values())
    local = np.tile(rotations.IDENTITY, (frames, len(armature.joints), 1))
    for joint, rotation in joint_rotations.items():
        local[:, armature.joint(joint)] = rotation
    return Animation(armature, local, np.zeros((frames, 3)), fps, {"skeleton": skeleton.name})


def solved(animation: Animation, skeleton: Skeleton, noise: float = 0.0, **options) -> Animation:
    directions = solver.directions_of(animation, skeleton)
    directions = directions + np.random.default_rng(0).normal(0, noise, directions.shape)
    return solver.animate(Motion.from_directions(skeleton, directions, animation.fps), **options)


def rotation_of(animation: Animation, joint: str) -> np.ndarray:
    return animation.rotations[:, animation.armature.joint(joint)]


def degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.rad2deg(rotations.angle_between(a, b))


def largest_step(joint_rotations: np.ndarray) -> float:
    return float(degrees_between(joint_rotations[1:], joint_rotations[:-1]).max())


def about(axis: np.ndarray, degrees: npt.ArrayLike) -> np.ndarray:
    return rotations.about(axis, np.deg2rad(np.atleast_1d(degrees)))


def arms_down(frames: int, bend: npt.ArrayLike, pronation: npt.ArrayLike = 0.0) -> dict[str, np.ndarray]:
    """Both arms hang, rotated 20 degrees forward; elbows bent and hands pronated by degrees, (T,) or one number."""
    joint_rotations = {}
    for side, sign in (("left", 1), ("right", -1)):
        hang = rotations.multiply(about(X, -20), about(Z, -80 * sign))
        joint_rotations[f"{side}_shoulder"] = np.tile(hang, (frames, 1))
        half = about(X, np.broadcast_to(np.asarray(pronation) / 2, frames))
        joint_rotations[f"{side}_elbow"] = rotations.multiply(about(-Y * sign, np.broadcast_to(bend, frames)), half)
        joint_rotations[f"{side}_wrist"] = half
    return joint_rotations


def test_any_directions_come_back_and_joints_are_where_the_motion_has_them(skeleton):
    directions = np.random.default_rng(1).normal(size=(200, skeleton.num_bones, 3))
    motion = Motion.from_directions(skeleton, directions, 15)
    animation = solver.animate(motion, limits=False)
    found = solver.directions_of(animation, motion.skeleton)
    cosine = np.sum(found * rotations.unit(motion.directions), axis=-1)
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 0.01
    _, positions = world(animation)
    joints = [animation.armature.joint(joint) for joint in skeleton.joints]
    np.testing.assert_allclose(positions[:, joints], motion.positions * export_axes(skeleton), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(animation.rotations, axis=-1), 1, atol=1e-12)
    assert (np.sum(animation.rotations[1:] * animation.rotations[:-1], axis=-1) >= 0).all()


def test_the_t_pose_is_no_rotation(skeleton):
    animation = solved(posed(skeleton, {"spine": rotations.IDENTITY[None]}), skeleton)
    np.testing.assert_allclose(degrees_between(animation.rotations, animation.armature.rest), 0, atol=1e-3)


def test_trunk_head_and_clavicles_turn_as_they_did():
    skeleton = load_skeleton("ted_expressive")
    shrug = about(Z, [10, 25, 0])
    joint_rotations = {
        "spine": rotations.multiply(about(Y, [-30, 0, 50]), about(X, [10, 20, -5])),
        "head": rotations.multiply(about(Y, [40, -20, 5]), about(Z, [10, 0, -15])),
        "left_clavicle": shrug,
        "right_clavicle": rotations.conjugate(shrug),
    }
    animation = solved(posed(skeleton, joint_rotations), skeleton)
    for joint, expected in joint_rotations.items():
        assert degrees_between(rotation_of(animation, joint), expected).max() < 4


def test_an_elbow_is_a_hinge_and_the_upper_arm_turns_for_it(skeleton):
    joint_rotations = arms_down(4, 80.0)
    joint_rotations["left_shoulder"] = rotations.multiply(
        joint_rotations["left_shoulder"], about(X, [-50, -10, 30, 60])
    )
    true = posed(skeleton, joint_rotations)
    animation = solved(true, skeleton)
    for joint in ("left_shoulder", "right_shoulder", "left_elbow", "right_elbow"):
        assert degrees_between(rotation_of(animation, joint), rotation_of(true, joint)).max() < 3


def test_the_forearm_takes_half_of_the_turn_of_the_palm_and_the_wrist_the_rest():
    skeleton = load_skeleton("ted_expressive")
    pronation = np.linspace(-90, 90, 61)
    joint_rotations = arms_down(61, 80.0, pronation)
    joint_rotations["left_wrist"] = rotations.multiply(
        joint_rotations["left_wrist"], about(Z, 50)
    )  # a bent wrist does not change that
    true = posed(skeleton, joint_rotations)
    animation = solved(true, skeleton)
    for side in ("left", "right"):
        assert degrees_between(rotation_of(animation, f"{side}_elbow"), rotation_of(true, f"{side}_elbow")).max() < 6
        hand = [world(one)[0][:, one.armature.joint(f"{side}_wrist")] for one in (animation, true)]
        assert degrees_between(*hand).max() < 0.5


def test_a_hand_without_fingers_is_neither_pronated_nor_supinated():
    skeleton = load_skeleton("ted_gesture")
    animation = solved(posed(skeleton, arms_down(5, 80.0)), skeleton)
    assert degrees_between(rotation_of(animation, "left_wrist"), rotations.IDENTITY).max() < 1e-6
    assert np.abs(np.rad2deg(rotations.twist_angle(rotation_of(animation, "left_elbow"), X))).max() < 1


@pytest.mark.parametrize("straight", [0.0, -6.0])
def test_the_upper_arm_keeps_its_twist_while_the_arm_is_straight_or_bent_back_by_noise(skeleton, straight):
    bend = np.interp(np.arange(60), [0, 10, 22, 38, 50, 60], [70, 70, straight, straight, 70, 70])
    joint_rotations = arms_down(60, bend)
    joint_rotations["left_shoulder"] = rotations.multiply(joint_rotations["left_shoulder"], about(X, 35))
    true = posed(skeleton, joint_rotations)
    animation = solved(true, skeleton, noise=0.01, limits=False)
    for side in ("left", "right"):
        found = rotation_of(animation, f"{side}_shoulder")
        assert degrees_between(found, rotation_of(true, f"{side}_shoulder")).max() < 25
        assert largest_step(found) < 15


def test_an_arm_that_is_always_straight_turns_like_one_that_was_raised():
    skeleton = load_skeleton("ted_gesture")
    raised = np.linspace(0, 80, 40)
    forward = rotations.multiply(about(X, -raised), about(Z, -90))
    true = posed(skeleton, {"left_shoulder": forward, "right_shoulder": about(Z, raised)})
    animation = solved(true, skeleton, noise=0.002)
    assert degrees_between(rotation_of(animation, "left_shoulder"), rotation_of(true, "left_shoulder")).max() < 10
    assert largest_step(rotation_of(animation, "right_shoulder")) < 10


def test_the_turn_of_a_hand_is_held_while_its_fingers_lie_on_one_line():
    skeleton = load_skeleton("ted_expressive")
    true = posed(skeleton, arms_down(45, 80.0, 60.0))
    directions = solver.directions_of(true, skeleton)
    bones = [skeleton.bone(f"left_{finger}_1") for finger in FAN]
    directions[15:30, bones] = directions[15:30, bones[1:2]]
    directions = directions + np.random.default_rng(0).normal(0, 1e-3, directions.shape)
    animation = solver.animate(Motion.from_directions(skeleton, directions, 15), limits=False)
    assert degrees_between(rotation_of(animation, "left_elbow"), rotation_of(true, "left_elbow")).max() < 4
    assert np.abs(np.rad2deg(rotations.twist_angle(rotation_of(animation, "left_wrist"), X)) - 30).max() < 4


def test_a_finger_bends_as_a_hinge_towards_the_palm():
    skeleton = load_skeleton("ted_expressive")
    knuckle = rotations.multiply(about(Z, [-20, -60, -90]), about(Y, [10, 20, 30]))
    joint_rotations = {
        "left_index_1": rotations.multiply(knuckle, about(X, [10, 10, 15])),
        "left_index_2": about(Z, [-60] * 3),
    }
    animation = solved(posed(skeleton, joint_rotations), skeleton, limits=False)
    for joint, expected in joint_rotations.items():
        assert degrees_between(rotation_of(animation, joint), expected).max() < 1


def test_the_mirrored_motion_has_the_mirrored_rotations(skeleton):
    joint_rotations = arms_down(20, np.linspace(30, 90, 20), np.linspace(-40, 60, 20))
    joint_rotations["spine"] = about(Y, np.linspace(-10, 20, 20))
    if skeleton.name == "ted_gesture":
        joint_rotations = {joint: value for joint, value in joint_rotations.items() if not joint.endswith("wrist")}
    joint_rotations["left_shoulder"] = rotations.multiply(joint_rotations["left_shoulder"], about(X, 20))
    directions = solver.directions_of(posed(skeleton, joint_rotations), skeleton)
    one = solver.animate(Motion.from_directions(skeleton, directions, 15))
    other = solver.animate(Motion.from_directions(skeleton, mirror_directions(skeleton, directions), 15))
    for joint in ("left_shoulder", "left_elbow", "left_wrist", "spine"):
        swapped = rotation_of(other, joint.replace("left", "right")) * np.array([1, -1, -1, 1])
        assert degrees_between(rotation_of(one, joint), swapped).max() < 1e-3


def test_the_frame_rate_does_not_change_the_pose():
    skeleton = load_skeleton("ted_expressive")
    slow, fast = (
        solved(posed(skeleton, arms_down(len(t), 60 + 50 * np.sin(2 * t), 60 * np.cos(3 * t)), fps), skeleton)
        for fps, t in ((15, np.arange(45) / 15), (60, np.arange(180) / 60))
    )
    assert degrees_between(slow.rotations, fast.rotations[::4]).max() < 2


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
def test_limits_of_twists_and_hands_leave_every_direction_as_it_is(name):
    """Also of joints that no person bends so far, and frame by frame."""
    motion = swaying(name, 40, size=1.2)
    free, kept = (solver.animate(motion, limits=limits) for limits in (False, True))
    differs = degrees_between(free.rotations, kept.rotations).max(axis=0)
    assert differs.max() > 10
    live = solver.Solver(motion.skeleton, motion.fps)
    for animation in (free, kept, live.animate(motion.directions)):
        np.testing.assert_allclose(solver.directions_of(animation, motion.skeleton), motion.directions, atol=1e-5)
    for side in ("left", "right") if name == "ted_expressive" else ():
        hand = f"{side}_wrist"
        for angle, values in joint_angles(hand, rotation_of(kept, hand)).items():
            low, high = limits_of(hand)[angle]
            is_within = (np.rad2deg(values) > low - 0.1) & (np.rad2deg(values) < high + 0.1)
            assert is_within.mean() > 0.9  # but on the way from one end of a range to the other


# On a real recording.
FPS = 15
CAPTURED = {"shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand", "index_1": "HandIndex1", "pinky_1": "HandPinky1"}


@pytest.fixture(scope="module")
def recording(private_data):
    """The solved animation, the recording's joint rotations in the world in our axes, and the motion.

    The recording's bones point as ours do in its T-pose, with the palms down, so that its rotations need no correction.
    """
    [path] = private_data.glob("zeroeggs_067/*.bvh")
    skeleton = load_skeleton("ted_expressive")
    positions = read_motion(path, skeleton, fps=FPS).positions.astype(np.float64)
    motion = Motion.from_directions(skeleton, positions_to_directions(skeleton, positions), FPS)
    bvh = read_bvh(path)
    places, turned = world_motion(bvh, FPS, range(len(bvh.joints)))
    joints = np.zeros_like(positions)
    for joint, index in choose_map(bvh.joints, skeleton, "auto", path)[1].items():
        if joint in skeleton.joints:
            joints[:, skeleton.joint(joint)] = places[:, index]
    axes = mean_heading(joints, skeleton) @ np.diag(export_axes(skeleton))
    captured = dict(
        zip(bvh.joints, np.moveaxis(rotations.from_matrix(axes.T @ np.stack(turned, axis=1)), 1, 0), strict=True)
    )
    return solver.animate(motion, limits=False), captured, motion


def twist_error(animation: Animation, captured: dict[str, np.ndarray], side: str, joint: str) -> np.ndarray:
    """Degrees (T,) by which a bone is turned about its length against the captured one.

    The rotation from one to the other, both from the same T-pose in the world, split into swing and twist.
    """
    ours = world(animation)[0][:, animation.armature.joint(f"{side}_{joint}")]
    theirs = captured[f"{side.capitalize()}{CAPTURED[joint]}"]
    difference = rotations.multiply(rotations.conjugate(theirs), ours)
    return np.rad2deg(np.abs(rotations.twist_angle(difference, X)))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("joint", "degrees"), [("shoulder", 5), ("elbow", 12), ("wrist", 2), ("index_1", 3), ("pinky_1", 3)]
)
def test_bones_are_turned_as_they_were(recording, side, joint, degrees):
    animation, captured, _ = recording
    assert np.median(twist_error(animation, captured, side, joint)) < degrees


def test_the_head_turns_as_it_did(recording):
    animation, captured, _ = recording
    ours = world(animation)[0][:, animation.armature.joint("head")]
    difference = rotations.multiply(rotations.conjugate(captured["Head"]), ours)
    # The recording's head is at rest in some pose of its own.
    assert np.median(degrees_between(difference, difference[:1])) < 4


@pytest.mark.parametrize("limits", [False, True])
def test_quaternions_do_not_flip_where_the_capture_does_not(recording, limits):
    _, captured, motion = recording
    animation = solver.animate(motion, limits=limits)
    assert (np.sum(animation.rotations[1:] * animation.rotations[:-1], axis=-1) >= 0).all()
    steps = degrees_between(animation.rotations[1:], animation.rotations[:-1])
    wild = {animation.armature.joints[joint] for joint in np.flatnonzero(steps.max(axis=0) > 90)}
    assert wild <= {"right_shoulder", "left_wrist", "right_wrist"}  # these jump in the recording itself
    for joint in wild:
        side, _, part = joint.partition("_")
        theirs = captured[f"{side.capitalize()}{CAPTURED[part]}"]
        jumps = degrees_between(theirs[1:], theirs[:-1]) > 80
        near = jumps | np.roll(jumps, 1) | np.roll(jumps, -1)
        assert near[steps[:, animation.armature.joint(joint)] > 90].all()


def test_limits_bind_seldom_on_a_real_recording(recording):
    free, _, motion = recording
    kept = solver.animate(motion)
    moved = degrees_between(free.rotations, kept.rotations) > 0.5
    assert 0 < moved.mean() < 0.03  # joints, those below a clamped hand included

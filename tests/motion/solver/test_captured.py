"""On a real recording: directions come back, and twists are those that the motion capture had."""

import numpy as np
import pytest

from ha2g_jax.motion import rotations, solver
from ha2g_jax.motion.armature import Animation, export_axes, world
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers.body import mean_heading
from ha2g_jax.motion.readers.bvh import read_bvh
from ha2g_jax.motion.readers.bvh_motion import read_motion, world_motion
from ha2g_jax.motion.readers.joint_maps import choose_map
from ha2g_jax.skeleton import load_skeleton, positions_to_directions

FPS = 15
X = np.array([1.0, 0.0, 0.0])
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
    assert np.rad2deg(np.median(rotations.angle_between(difference, difference[:1]))) < 4


@pytest.mark.parametrize("limits", [False, True])
def test_quaternions_do_not_flip_where_the_capture_does_not(recording, limits):
    _, captured, motion = recording
    animation = solver.animate(motion, limits=limits)
    assert (np.sum(animation.rotations[1:] * animation.rotations[:-1], axis=-1) >= 0).all()
    steps = np.rad2deg(rotations.angle_between(animation.rotations[1:], animation.rotations[:-1]))
    wild = {animation.armature.joints[joint] for joint in np.flatnonzero(steps.max(axis=0) > 90)}
    assert wild <= {"right_shoulder", "left_wrist", "right_wrist"}  # these jump in the recording itself
    for joint in wild:
        side, _, part = joint.partition("_")
        theirs = captured[f"{side.capitalize()}{CAPTURED[part]}"]
        jumps = np.rad2deg(rotations.angle_between(theirs[1:], theirs[:-1])) > 80
        near = jumps | np.roll(jumps, 1) | np.roll(jumps, -1)
        assert near[steps[:, animation.armature.joint(joint)] > 90].all()


def test_limits_bind_seldom_on_a_real_recording(recording):
    free, _, motion = recording
    kept = solver.animate(motion)
    moved = np.rad2deg(rotations.angle_between(free.rotations, kept.rotations)) > 0.5
    assert 0 < moved.mean() < 0.02

"""Each control does what it says, by as much as it is asked, and leaves the rest alone."""

import numpy as np
import pytest

from ha2g_jax.motion import control
from ha2g_jax.motion.control import Controls, effects
from ha2g_jax.motion.control.parts import arm_parts, bones_of
from ha2g_jax.motion.smoothing import slow_mean
from ha2g_jax.skeleton import Skeleton, directions_to_positions, load_skeleton, mirror_directions

FPS = 15
SIDES = ("left", "right")
_LIMB = ("elbow", "wrist")


def wrists(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    """(T, 2, 3) metres from the shoulder to the wrist of both arms."""
    positions = directions_to_positions(skeleton, directions)
    return np.stack(
        [
            positions[:, skeleton.joint(f"{side}_wrist")] - positions[:, skeleton.joint(f"{side}_shoulder")]
            for side in SIDES
        ],
        axis=1,
    )


def speed(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).mean() * FPS)


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(first - second, axis=-1) / 2, 0, 1)))


def arms_of(skeleton: Skeleton) -> np.ndarray:
    is_arm = np.zeros(skeleton.num_bones, bool)
    is_arm[bones_of(arm_parts(skeleton))] = True
    return is_arm


def assert_unit(directions: np.ndarray):
    assert directions.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-5)


def assert_same_away_from(span: slice, changed: np.ndarray, motion: np.ndarray):
    eased = round(effects.EASE * FPS)
    np.testing.assert_array_equal(changed[: span.start - eased], motion[: span.start - eased])
    np.testing.assert_array_equal(changed[span.stop + eased :], motion[span.stop + eased :])


@pytest.mark.parametrize(("amount", "low", "high"), [(0, 0, 0.2), (0.5, 0.45, 0.55), (1.5, 1.35, 1.55), (2, 1.6, 2.1)])
def test_energy_scales_the_speed(skeleton, gestures, amount, low, high):
    motion = gestures(skeleton)
    livelier = effects.energy(skeleton, motion, FPS, amount)
    assert_unit(livelier)
    for places in (wrists, directions_to_positions):
        assert low < speed(places(skeleton, livelier)) / speed(places(skeleton, motion)) < high


@pytest.mark.parametrize("amount", [0.5, 1.5])
def test_energy_leaves_posture_and_timing_alone(skeleton, gestures, amount):
    motion = gestures(skeleton)
    livelier = effects.energy(skeleton, motion, FPS, amount)
    posture = degrees(slow_mean(livelier, FPS, 4), slow_mean(motion, FPS, 4)).mean(axis=0)
    shown = [skeleton.bone(name) for name in ("neck", "nose", *(f"{side}_{part}" for side in SIDES for part in _LIMB))]
    assert posture[shown].max() < 5
    assert posture.max() < 15  # of finger bones, which sum up what the bones above them do
    before, after = (wrists(skeleton, poses).reshape(len(poses), -1) for poses in (motion, livelier))
    for column in range(before.shape[1]):
        assert np.corrcoef(before[:, column], after[:, column])[0, 1] > 0.9


def test_more_energy_leaves_the_shape_of_hands_alone(gestures):
    skeleton = load_skeleton("ted_expressive")
    motion = gestures(skeleton)
    livelier = effects.energy(skeleton, motion, FPS, 2)
    for side in SIDES:
        *_, hand = ([*part.bones] for part in arm_parts(skeleton, side) if part.kind == "hand")
        fingers = [*hand, *(bone for part in arm_parts(skeleton, side) if part.kind == "finger" for bone in part.bones)]
        before, after = (poses[:, fingers] @ poses[:, fingers].transpose(0, 2, 1) for poses in (motion, livelier))
        np.testing.assert_allclose(after, before, atol=1e-4)
        assert degrees(livelier[:, fingers], motion[:, fingers]).mean() > 3  # it is the hand that turned


@pytest.mark.parametrize("change", [lambda s, d: effects.energy(s, d, FPS, 2), lambda s, d: effects.extent(s, d, 2)])
def test_no_elbow_is_overstretched_or_folded(skeleton, gestures, change):
    motion = gestures(skeleton)
    larger = change(skeleton, motion)
    for side in SIDES:
        upper, fore = (skeleton.bone(f"{side}_{joint}") for joint in ("elbow", "wrist"))
        before, after = (degrees(poses[:, upper], poses[:, fore]) for poses in (motion, larger))
        assert np.all(after < np.maximum(before, 145) + 0.1)
        assert np.all(after > np.minimum(before, 8) - 0.1)
        assert np.abs(after - before).max() > 5


@pytest.mark.parametrize(("amount", "low", "high"), [(0, 0, 1e-6), (0.5, 0.4, 0.62), (1.5, 1.2, 1.5), (2, 1.4, 2)])
def test_extent_scales_the_way_of_the_wrists_from_rest(skeleton, gestures, amount, low, high):
    motion = gestures(skeleton)
    resting = wrists(skeleton, control.rest_pose(skeleton)[None])
    before, after = (
        np.linalg.norm(wrists(skeleton, poses) - resting, axis=-1).mean()
        for poses in (motion, effects.extent(skeleton, motion, amount))
    )
    assert low <= after / before <= high


@pytest.mark.parametrize("amount", [0.5, 1.5])
def test_extent_leaves_trunk_and_head_and_the_hand_on_its_wrist_alone(skeleton, gestures, amount):
    motion = gestures(skeleton)
    changed = effects.extent(skeleton, motion, amount)
    assert_unit(changed)
    np.testing.assert_array_equal(changed[:, ~arms_of(skeleton)], motion[:, ~arms_of(skeleton)])
    if amount > 1:
        for side in SIDES:
            bones = bones_of(arm_parts(skeleton, side))[1:]  # the forearm and all that hangs on it
            before, after = (poses[:, bones] @ poses[:, bones].transpose(0, 2, 1) for poses in (motion, changed))
            np.testing.assert_allclose(after, before, atol=1e-4)


def test_more_extent_does_not_hide_the_face(skeleton, gestures):
    motion = gestures(skeleton)
    before, after = (wrists(skeleton, poses)[..., 1] for poses in (motion, effects.extent(skeleton, motion, 2)))
    assert np.all(after > np.minimum(before, 0) - 1e-3)
    assert (before - after).max() > 0.05


@pytest.mark.parametrize("side", SIDES)
def test_handedness_rests_the_other_arm_alone(skeleton, gestures, side):
    motion = gestures(skeleton)
    (other,) = set(SIDES) - {side}
    one_handed = effects.handedness(skeleton, motion, side)
    resting = bones_of(arm_parts(skeleton, other))
    expected = np.broadcast_to(control.rest_pose(skeleton)[resting], one_handed[:, resting].shape)
    np.testing.assert_array_equal(one_handed[:, resting], expected)
    rest = [bone for bone in range(skeleton.num_bones) if bone not in resting]
    np.testing.assert_array_equal(one_handed[:, rest], motion[:, rest])
    assert speed(wrists(skeleton, motion)[:, SIDES.index(other)]) > 0.1


def test_a_pinned_pose_is_held_and_the_rest_is_left_alone(skeleton, gestures):
    motion, pose = gestures(skeleton), gestures(skeleton, seed=5)[40]
    held = effects.pin(skeleton, motion, FPS, [control.Pin(4, 6, pose)])
    assert_unit(held)
    np.testing.assert_array_equal(held[60:91], np.broadcast_to(pose, held[60:91].shape))
    assert_same_away_from(slice(60, 91), held, motion)
    # On the way no bone turns faster than it has to: its own speed and the way to the pose, at most 1.875 times.
    way = max(degrees(motion[rows], pose).max() for rows in (slice(50, 60), slice(91, 101)))
    steps, own = degrees(held[51:101], held[50:100]).max(), degrees(motion[51:101], motion[50:100]).max()
    assert steps < own + 1.875 * way / (effects.EASE * FPS)


def test_a_pin_of_no_length_is_passed_through(skeleton, gestures):
    motion, pose = gestures(skeleton, fps=60), gestures(skeleton, seed=5)[40]
    passed = effects.pin(skeleton, motion, 60, [control.Pin(4.003, 4.003, pose)])
    np.testing.assert_array_equal(passed[240], pose)
    assert degrees(passed[[238, 242]], pose).max() > 0
    np.testing.assert_array_equal(passed[:210], motion[:210])
    np.testing.assert_array_equal(passed[271:], motion[271:])


def test_pins_near_each_other_are_both_held(skeleton, gestures):
    motion, first, second = gestures(skeleton), gestures(skeleton, seed=5)[40], gestures(skeleton, seed=6)[40]
    held = effects.pin(skeleton, motion, FPS, [control.Pin(5.2, 6, second), control.Pin(4, 5, first)])
    np.testing.assert_array_equal(held[60:76], np.broadcast_to(first, held[60:76].shape))
    np.testing.assert_array_equal(held[78:91], np.broadcast_to(second, held[78:91].shape))


def test_a_muted_span_rests_the_arms_and_leaves_the_rest_alone(skeleton, gestures):
    motion = gestures(skeleton)
    muted = effects.mute(skeleton, motion, FPS, [control.Span(4, 6)])
    arms = arms_of(skeleton)
    expected = np.broadcast_to(control.rest_pose(skeleton)[arms], muted[60:91, arms].shape)
    np.testing.assert_array_equal(muted[60:91, arms], expected)
    np.testing.assert_array_equal(muted[:, ~arms], motion[:, ~arms])
    assert_same_away_from(slice(60, 91), muted, motion)
    assert speed(wrists(skeleton, motion)[60:91]) > 0.1


def test_the_rest_pose_is_symmetric_with_the_hands_low(skeleton):
    pose = control.rest_pose(skeleton)
    assert_unit(pose)
    np.testing.assert_allclose(mirror_directions(skeleton, pose), pose, atol=1e-6)
    height = wrists(skeleton, pose[None])[0, :, 1]  # below the shoulders
    assert np.all((height > 0.35) & (height < 0.6))


def one_by_one(skeleton, motion: np.ndarray, controls: Controls) -> np.ndarray:
    """A stream's controls do to each frame what those of a whole motion do, as far as a frame can know."""
    running = effects.RunningControls(skeleton, FPS, controls)
    return np.concatenate([running.apply(motion[frame : frame + 1], controls) for frame in range(len(motion))])


def test_neutral_running_controls_change_no_byte(skeleton, gestures):
    motion = gestures(skeleton, 2)
    assert one_by_one(skeleton, motion, Controls()).tobytes() == motion.tobytes()


@pytest.mark.parametrize(
    "controls",
    [
        Controls(extent=1.4),
        Controls(extent=0.4),
        Controls(handedness="left"),
        Controls(mirror=True),
        Controls(extent=0.7, handedness="right", mirror=True),
    ],
)
def test_controls_of_a_frame_are_those_of_the_motion(skeleton, gestures, controls):
    motion = gestures(skeleton, 3)
    expected = control.apply(skeleton, motion, FPS, controls)
    np.testing.assert_allclose(one_by_one(skeleton, motion, controls), expected, atol=1e-5)


@pytest.mark.parametrize(("energy", "low", "high"), [(0, 0, 0.25), (0.5, 0.4, 0.65), (1.5, 1.3, 1.6)])
def test_running_energy_scales_the_speed(skeleton, gestures, energy, low, high):
    motion = gestures(skeleton, 10)
    livelier = one_by_one(skeleton, motion, Controls(energy=energy))
    speeds = [np.linalg.norm(np.diff(frames[60:], axis=0), axis=-1).mean() for frames in (livelier, motion)]
    assert low <= speeds[0] / speeds[1] <= high
    np.testing.assert_allclose(np.linalg.norm(livelier, axis=-1), 1, atol=1e-5)


def test_frames_together_are_those_one_by_one(skeleton, gestures):
    motion, controls = gestures(skeleton, 3), Controls(energy=1.4, handedness="left")
    together = effects.RunningControls(skeleton, FPS, controls).apply(motion, controls)
    np.testing.assert_array_equal(together, one_by_one(skeleton, motion, controls))


def test_a_change_is_eased(skeleton, gestures):
    """A motion that stands still moves from one side to the other in steps that begin and end small."""
    still = np.repeat(gestures(skeleton, 1)[:1], 12, axis=0)
    running = effects.RunningControls(skeleton, FPS)
    running.apply(still[:2], Controls())
    moved = running.apply(still, Controls(mirror=True))
    np.testing.assert_allclose(moved[8:], mirror_directions(skeleton, still[8:]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), 1, atol=1e-5)
    way = np.linalg.norm(np.diff(np.concatenate([still[:1], moved]), axis=0), axis=-1).max(axis=1)
    assert way[0] < way[3] / 3 and way[7] < way[4] / 3

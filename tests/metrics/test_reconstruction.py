"""Distances from the recorded motion, and the release's own way to compute them, value for value."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.metrics import legacy, reconstruction
from ha2g_jax.skeleton import directions_to_positions, load_skeleton, normalize

GESTURE = load_skeleton("ted_gesture")
EXPRESSIVE = load_skeleton("ted_expressive")
FPS = 15
# Of `wave`, by the release's rules written in plain numpy apart from the package: joint error, acceleration error.
GOLDEN = {9: (0.234235471, 0.877703552), 42: (0.236533749, 0.887122986)}


def directions(skeleton, seed: int = 0, frames: int = 34) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 0.2, (frames, skeleton.num_bones, 3))
    return normalize(skeleton.mean_directions + noise)


def joint_mae(skeleton, generated, real) -> float:
    return reconstruction.joint_mae(*positions(skeleton, generated, real))


def acceleration_error(skeleton, generated, real, fps) -> float:
    found, true = positions(skeleton, generated, real)
    return reconstruction.acceleration_error(found, true, fps)


def positions(skeleton, *motions: np.ndarray) -> list[np.ndarray]:
    return [directions_to_positions(skeleton, motion) for motion in motions]


def turned_hand() -> tuple[np.ndarray, np.ndarray]:
    """A motion, and one whose left forearm (0.33 m) points along x instead of y."""
    real = np.tile([0.0, 1, 0], (16, 9, 1))
    generated = real.copy()
    generated[:, GESTURE.bone("left_wrist")] = [1, 0, 0]
    return generated, real


def test_a_turned_forearm_by_hand():
    generated, real = turned_hand()
    assert joint_mae(GESTURE, generated, real) == pytest.approx(2 * 0.33 / 30)  # x and y of one of ten joints
    assert acceleration_error(GESTURE, generated, real, FPS) == 0


def test_acceleration_by_hand():
    generated, real = turned_hand()
    generated[:, GESTURE.bone("left_wrist")] = [0, 1, 0]
    generated[10, GESTURE.bone("left_wrist")] = [1, 0, 0]
    error = acceleration_error(GESTURE, generated, real, FPS)
    # Second differences 1, -2, 1 of x and of y, in 14 frames of 10 joints and 3 coordinates.
    assert error == pytest.approx(2 * 4 * 0.33 * FPS**2 / (14 * 30))
    assert acceleration_error(GESTURE, generated, real, 2 * FPS) == pytest.approx(4 * error)


@pytest.mark.parametrize("skeleton", [GESTURE, EXPRESSIVE], ids=lambda skeleton: skeleton.name)
def test_only_the_directions_matter_not_the_lengths_of_their_vectors(skeleton):
    generated, real = directions(skeleton), directions(skeleton, 1)
    expected = joint_mae(skeleton, generated, real)
    assert joint_mae(skeleton, 0.3 * generated, 7 * real) == pytest.approx(expected)
    assert joint_mae(skeleton, real, real) == 0
    assert 0 < expected < 0.2


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([[1, 2, 0], [2, 0, 1]]), st.sampled_from([1, -1]))
def test_exchanging_the_axes_changes_nothing(seed, axes, sign):
    generated, real = directions(GESTURE, seed), directions(GESTURE, seed + 1)
    for metric in (joint_mae, functools.partial(acceleration_error, fps=FPS)):
        turned = metric(GESTURE, sign * generated[..., axes], sign * real[..., axes])
        assert turned == pytest.approx(metric(GESTURE, generated, real))


def test_too_short_is_undefined_and_standing_still_is_not():
    real = directions(GESTURE)
    assert np.isnan(joint_mae(GESTURE, real[:0], real[:0]))
    for frames in (0, 2):
        assert np.isnan(acceleration_error(GESTURE, real[:frames], real[:frames], FPS))
    still = np.tile(real[:1], (34, 1, 1))
    assert acceleration_error(GESTURE, still, still, FPS) == 0


def wave(phase: float, samples: int, bones: int) -> np.ndarray:
    """Vectors with the mean added whose length is not 1, written so that they can be made anywhere."""
    index = np.arange(samples * 34 * bones * 3, dtype=np.float64).reshape(samples, 34, bones, 3)
    return np.sin(0.37 * index + phase) + 0.1


def test_the_legacy_errors_are_those_of_the_rules_written_out():
    parents_children = [(0, 1, 0.26), (1, 2, 0.18), (2, 3, 0.14), (1, 4, 0.22), (4, 5, 0.36), (5, 6, 0.33)]
    parents_children += [(1, 7, 0.22), (7, 8, 0.36), (8, 9, 0.33)]
    positions = np.zeros((2, 3, 34, 10, 3))
    for side, phase in enumerate((0.0, 1.0)):
        for bone, (parent, child, length) in enumerate(parents_children):
            positions[side, :, :, child] = positions[side, :, :, parent] + length * wave(phase, 3, 42)[:, :, bone]
    joint_errors, accelerations = [], []
    for generated, real in zip(*positions, strict=True):
        joint_errors += [np.mean(np.abs(real[t] - generated[t])) for t in range(4, 34)]
        for t in range(1, 33):
            second = [x[t + 1] - 2 * x[t] + x[t - 1] for x in (real, generated)]
            accelerations.append(np.mean(np.abs(second[0] - second[1])))
    errors = legacy.legacy_errors(wave(0.0, 3, 42), wave(1.0, 3, 42))
    assert errors == pytest.approx((np.mean(joint_errors), np.mean(accelerations)), rel=1e-6)
    # Of 42 bones only the first 9 are looked at.
    assert errors != legacy.legacy_errors(wave(0.0, 3, 9), wave(1.0, 3, 9))
    nine = [wave(phase, 3, 42)[:, :, :9] for phase in (0.0, 1.0)]
    assert legacy.legacy_errors(nine[0], nine[1]) == errors


@pytest.mark.parametrize("bones", [9, 42])
def test_the_legacy_errors_of_a_stored_case(bones):
    errors = legacy.legacy_errors(wave(0.0, 3, bones), wave(1.0, 3, bones))
    np.testing.assert_allclose(errors, GOLDEN[bones], rtol=1e-6)


REAL = np.random.default_rng(0).normal(size=(12, 3, 3))


def off(*moves: tuple[int, int, tuple[float, float, float]]) -> np.ndarray:
    generated = REAL.copy()
    for frame, joint, move in moves:
        generated[frame, joint] += move
    return generated


@pytest.mark.parametrize("shape", [(1, 3, 3), (12, 1, 3), (12, 3, 1), (11, 3, 3)])
def test_motions_of_different_shapes_are_not_compared(shape):
    for metric in (
        reconstruction.joint_mae,
        functools.partial(reconstruction.acceleration_error, fps=FPS),
        reconstruction.pck,
    ):
        with pytest.raises(ValueError, match=r"of the shapes .*; expected the same \(T, joints, 3\)"):
            metric(np.zeros(shape), REAL)


def test_keypoints_are_found_within_delta():
    wrong = off((5, 0, (0.2, 0, 0)), (6, 1, (0, 0.2, 0)), (7, 2, (0, 0, 0.05)), (1, 0, (9, 9, 9)))
    assert reconstruction.pck(wrong, REAL) == pytest.approx(1 - 3 / 36)  # 12 frames of 3 joints


def test_the_error_of_a_keypoint_is_summed_over_coordinates():
    diagonal = off((5, 0, (0.05, 0.05, 0.05)))  # 0.15
    assert reconstruction.pck(diagonal, REAL) == pytest.approx(35 / 36)
    assert reconstruction.pck(diagonal, REAL, delta=0.2) == 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_moving_both_bodies_alike_changes_no_keypoint_and_perfect_is_1(seed):
    rng = np.random.default_rng(seed)
    shift, other = rng.normal(size=3), REAL + rng.normal(0, 0.05, REAL.shape)
    assert reconstruction.pck(REAL, REAL) == 1
    assert reconstruction.pck(other + shift, REAL + shift) == pytest.approx(reconstruction.pck(other, REAL))


def test_keypoints_without_frames_are_undefined_and_a_still_body_is_scored():
    assert np.isnan(reconstruction.pck(REAL[:0], REAL[:0]))
    assert reconstruction.pck(np.zeros_like(REAL), np.zeros_like(REAL)) == 1
    assert reconstruction.pck(np.zeros_like(REAL), REAL + 10) == 0

"""Estimation of the twist of a bone, its rotation about its own length, from weighted observations over time."""

import numpy as np

from ha2g_jax.motion import rotations

# Seconds squared. An observation of weight w is averaged over sqrt(_STIFFNESS / w) seconds: 6 ms for weight 1, more
# than a second for 2e-5.
_STIFFNESS = 4e-5
_NOTHING = 1e-12  # weight of a frame without an observation


def transport(above: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Transport a bone along its path without twist relative to its parent (parallel transport).

    Unlike the shortest rotations from the rest direction, these rotations have no direction at which they jump.

    Args:
        above: (T, 4) rotations of the parent.
        axis: (3,) unit vector of the bone at rest.
        along: (T, 3) unit vectors of the bone over time.

    Returns:
        (T, 4) rotations that take `axis` to `along`, each continued from the frame before by the shortest rotation.
    """
    path = rotations.rotate(rotations.conjugate(above), along)
    steps = np.concatenate([rotations.between(axis, path[:1]), rotations.between(path[:-1], path[1:])])
    shift = 1
    while shift < len(steps):  # the product of all steps up to each, by doubling
        steps[shift:] = rotations.unit(rotations.multiply(steps[shift:], steps[:-shift]))
        shift *= 2
    return swing(rotations.multiply(above, steps), axis, along)


def swing(frames: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Rotate frames further by the shortest rotation that aligns a bone with given directions.

    Args:
        frames: (T, 4) rotations of the bone.
        axis: (3,) unit vector of the bone at rest.
        along: (T, 3) unit vectors of the bone over time.

    Returns:
        (T, 4) rotations that take `axis` to `along`.
    """
    return rotations.multiply(rotations.between(rotations.rotate(frames, axis), along), frames)


def observe(frames: np.ndarray, axis: np.ndarray, mark: np.ndarray, seen: np.ndarray, weight) -> np.ndarray:
    """Estimate the twist of a bone from the observed direction of a mark on its side.

    Args:
        frames: (T, 4) rotations of the bone without the twist.
        axis: (3,) unit vector of the bone at rest.
        mark: (3,) unit vector at right angles to the bone at rest.
        seen: (T, 3) observed directions of the mark; only the component at right angles to the bone counts, whatever
            its length.
        weight: (T,) weights or one number; 1 for a twist that is clearly visible.

    Returns:
        (T,) complex numbers whose angle is the twist in radians and whose absolute value is the weight.
    """
    local = rotations.rotate(rotations.conjugate(frames), seen)
    across = local @ mark + 1j * (local @ np.cross(axis, mark))
    return weight * across / np.maximum(np.abs(across), 1e-9)


def apply_twist(frames: np.ndarray, axis: np.ndarray, observations: np.ndarray, fps: float) -> np.ndarray:
    """Rotate a bone by the smooth twist that fits its observations.

    Args:
        frames: (T, 4) rotations of the bone without the twist.
        axis: (3,) unit vector of the bone at rest.
        observations: (T,) complex numbers, the sum of results of `observe`.
        fps: frames per second.

    Returns:
        (T, 4) rotations of the bone.
    """
    return rotations.multiply(frames, rotations.about(axis, smooth_angle(observations, fps)))


def smooth_angle(observations: np.ndarray, fps: float) -> np.ndarray:
    """Fit angles over time that minimise the integral of w (angle - seen)^2 + stiffness (rate of the angle)^2.

    Args:
        observations: (T,) complex numbers w exp(i seen).
        fps: frames per second.

    Returns:
        (T,) angles in radians, continuous over time.
    """
    if len(observations) == 1:
        return np.angle(observations)
    weight = np.maximum(np.abs(observations), _NOTHING)
    stiffness = _STIFFNESS * fps**2
    bands = np.zeros((2, len(weight)))
    bands[0, 1:] = -stiffness
    bands[1] = weight
    bands[1, 1:] += stiffness
    bands[1, :-1] += stiffness
    from scipy.linalg import solveh_banded  # its import takes a quarter of a second

    # A point of the plane is fitted first: it needs no unwrapping, but lags where the angle changes fast.
    point = solveh_banded(bands, np.stack([np.real(observations), np.imag(observations)], axis=-1))
    near = np.unwrap(np.arctan2(point[:, 1], point[:, 0]))
    seen = near + np.angle(observations * np.exp(-1j * near))
    return solveh_banded(bands, weight * seen)

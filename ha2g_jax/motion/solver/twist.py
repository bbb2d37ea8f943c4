"""How a bone is turned about its own length: as seen where that is seen well, held from its neighbours elsewhere."""

import numpy as np
from scipy.linalg import solveh_banded

from ha2g_jax.motion import rotations

# Seconds squared. Its root over that of a weight is the time over which a twist seen with that weight is averaged:
# 6 ms for weight 1, more than a second for 2e-5.
_STIFFNESS = 4e-5
_NOTHING = 1e-12  # weight of a frame in which nothing is seen


def carry(above: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Rotations that take a bone along its path and, seen from its parent, never turn it about itself.

    Unlike the shortest way from one rest direction, this way has no direction at which it jumps.

    Args:
        above: (T, 4) rotations of the parent.
        axis: (3,) unit vector, the bone at rest.
        along: (T, 3) unit vectors.

    Returns:
        (T, 4) rotations that take `axis` to `along`, each the shortest way on from the one before.
    """
    path = rotations.rotate(rotations.conjugate(above), along)
    turns = np.concatenate([rotations.between(axis, path[:1]), rotations.between(path[:-1], path[1:])])
    shift = 1
    while shift < len(turns):  # the product of all turns up to each, by doubling
        turns[shift:] = rotations.unit(rotations.multiply(turns[shift:], turns[:-shift]))
        shift *= 2
    return swing(rotations.multiply(above, turns), axis, along)


def swing(frames: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    """The frames (T, 4), each turned on by the shortest way that brings `axis` (3,) at rest to `along` (T, 3)."""
    return rotations.multiply(rotations.between(rotations.rotate(frames, axis), along), frames)


def sight(frames: np.ndarray, axis: np.ndarray, mark: np.ndarray, seen: np.ndarray, weight) -> np.ndarray:
    """What a mark on the side of a bone says about its twist.

    Args:
        frames: (T, 4) the bone as it is without the twist.
        axis: (3,) unit vector, the bone at rest.
        mark: (3,) unit vector at right angles to it.
        seen: (T, 3) where the mark is seen; the part at right angles to the bone counts, whatever its length.
        weight: (T,) or a number, 1 for what is seen well.

    Returns:
        (T,) complex: the angle is the twist, the length the weight.
    """
    local = rotations.rotate(rotations.conjugate(frames), seen)
    across = local @ mark + 1j * (local @ np.cross(axis, mark))
    return weight * across / np.maximum(np.abs(across), 1e-9)


def follow(frames: np.ndarray, axis: np.ndarray, sights: np.ndarray, fps: float) -> np.ndarray:
    """The frames (T, 4), turned about the bone by the twist that fits the sum of its sights (T,) smoothly."""
    return rotations.multiply(frames, rotations.about(axis, smooth_angle(sights, fps)))


def smooth_angle(sights: np.ndarray, fps: float) -> np.ndarray:
    """Angles over time that minimise the integral of w (angle - seen)^2 + stiffness (rate of the angle)^2.

    Args:
        sights: (T,) complex, w exp(i seen).
        fps: frames per second.

    Returns:
        (T,) radians, whole turns counted the shortest way.
    """
    if len(sights) == 1:
        return np.angle(sights)
    weight = np.maximum(np.abs(sights), _NOTHING)
    stiffness = _STIFFNESS * fps**2
    bands = np.zeros((2, len(weight)))
    bands[0, 1:] = -stiffness
    bands[1] = weight
    bands[1, 1:] += stiffness
    bands[1, :-1] += stiffness
    # Fitted as a point of the plane, the angle needs no count of turns, but comes short where it moves fast.
    point = solveh_banded(bands, np.stack([np.real(sights), np.imag(sights)], axis=-1))
    near = np.unwrap(np.arctan2(point[:, 1], point[:, 0]))
    seen = near + np.angle(sights * np.exp(-1j * near))
    return solveh_banded(bands, weight * seen)

"""Estimation of the twist of a bone, its rotation about its own length, from weighted observations over time.

Only two functions make a frame depend on other frames, `transport` and `smooth_angle`. `Twists` applies them to all
frames of a motion. `FrameByFrame` applies them to frames as they arrive: each frame is then like the last frame of a
motion that ends with it, and does not change any more.
"""

from typing import NamedTuple

import numpy as np

from ha2g_jax.motion import rotations

# Seconds squared. An observation of weight w is averaged over sqrt(_STIFFNESS / w) seconds: 6 ms for weight 1, more
# than a second for 2e-5.
_STIFFNESS = 4e-5
_NOTHING = 1e-12  # weight of a frame without an observation


class Twists:
    """Estimates that depend on other frames, which are all known, under the name of the joint of each bone."""

    def __init__(self, fps: float) -> None:
        self.fps = fps

    def transport(self, joint: str, above: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Return the (T, 4) rotations of the function `transport`."""
        return transport(above, axis, along)

    def smooth(self, joint: str, observations: np.ndarray) -> np.ndarray:
        """Return (T,) angles in radians for (T,) observations, see `smooth_angle`."""
        return smooth_angle(observations, self.fps)


class FrameByFrame(Twists):
    """Twists of frames that arrive in order, in any number at a time; a frame does not depend on later ones."""

    def __init__(self, fps: float) -> None:
        super().__init__(fps)
        self._ends: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._known: dict[str, Known] = {}

    def transport(self, joint: str, above: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
        frames = transport(above, axis, along, self._ends.get(joint))
        self._ends[joint] = above[-1], frames[-1]
        return frames

    def smooth(self, joint: str, observations: np.ndarray) -> np.ndarray:
        angles = []
        for observation in observations:
            self._known[joint] = continue_angle(complex(observation), self.fps, self._known.get(joint))
            angles.append(self._known[joint].angle)
        return np.array(angles)


def transport(
    above: np.ndarray, axis: np.ndarray, along: np.ndarray, before: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """Transport a bone along its path without twist relative to its parent (parallel transport).

    Unlike the shortest rotations from the rest direction, these rotations have no direction at which they jump. They
    are (T, 4), take `axis` (3,) at rest to `along` (T, 3), and start from the rotations `before` of the parent `above`
    and of the bone, by default at rest.
    """
    path = rotations.rotate(rotations.conjugate(above), along)
    start = rotations.IDENTITY if before is None else rotations.multiply(rotations.conjugate(before[0]), before[1])
    first = rotations.between(rotations.rotate(start, axis), path[:1])
    steps = np.concatenate([rotations.multiply(first, start), rotations.between(path[:-1], path[1:])])
    shift = 1
    while shift < len(steps):  # the product of all steps up to each, by doubling
        steps[shift:] = rotations.unit(rotations.multiply(steps[shift:], steps[:-shift]))
        shift *= 2
    return swing(rotations.multiply(above, steps), axis, along)


def swing(frames: np.ndarray, axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Rotate frames (T, 4) further by the shortest rotation that takes the `axis` (3,) of a bone to `along` (T, 3)."""
    return rotations.multiply(rotations.between(rotations.rotate(frames, axis), along), frames)


def observe(frames: np.ndarray, axis: np.ndarray, mark: np.ndarray, seen: np.ndarray, weight) -> np.ndarray:
    """Estimate the twist of a bone from the observed directions `seen` (T, 3) of a mark on its side.

    The rotations `frames` (T, 4) are without the twist; the axis and the mark (3,) are unit vectors at right angles.
    Only the component of `seen` across the bone counts, and a weight of 1 is for a twist that is clearly visible. The
    result (T,) is complex, with the twist in radians as its angle and the weight as its absolute value.
    """
    local = rotations.rotate(rotations.conjugate(frames), seen)
    across = local @ mark + 1j * (local @ rotations.cross(axis, mark))
    return weight * across / np.maximum(np.abs(across), 1e-9)


def apply_twist(frames: np.ndarray, axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotate a bone with rotations (T, 4) about its own `axis` (3,) by angles (T,) in radians."""
    return rotations.multiply(frames, rotations.about(axis, angles))


def smooth_angle(observations: np.ndarray, fps: float) -> np.ndarray:
    """Fit angles (T,) that minimise the integral of w (angle - seen)^2 + stiffness (rate of the angle)^2.

    Observations (T,) are w exp(i seen), sums of results of `observe`; angles are in radians, continuous over time.
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


class Known(NamedTuple):
    """What the observations up to a frame say of an angle in radians.

    They have the weight of one observation in this frame. `point` is their weighted mean, a complex number, and `near`
    its angle, continuous over time.
    """

    weight: float
    point: complex
    near: float
    angle: float


def continue_angle(observation: complex, fps: float, before: Known | None) -> Known:
    """Fit the angle of one further frame, the last angle of `smooth_angle` with the observations up to it.

    This is the elimination of the banded system of `smooth_angle`, frame by frame: a Kalman filter of a random walk.
    """
    weight, direction = max(abs(observation), _NOTHING), float(np.angle(observation))
    if before is None:
        return Known(weight, observation / weight, direction, direction)
    stiffness = _STIFFNESS * fps**2
    held = before.weight * stiffness / (before.weight + stiffness)
    total = held + weight
    point = (held * before.point + observation) / total
    near = before.near + _wrapped(float(np.angle(point)) - before.near)
    seen = near + _wrapped(direction - near)
    return Known(total, point, near, (held * before.angle + weight * seen) / total)


def _wrapped(angle: float) -> float:
    return (angle + np.pi) % (2 * np.pi) - np.pi

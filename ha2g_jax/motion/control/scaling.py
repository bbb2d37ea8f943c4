"""How far a motion is from a pose, made less or more: 0 is the pose, 1 the motion, 1.5 lies beyond it."""

import numpy as np

from ha2g_jax.motion.control.parts import FOREARM, HAND, HEAD, TRUNK, UPPER_ARM, Part, rest_pose
from ha2g_jax.motion.control.turns import Turns, away_from, poses_of, power
from ha2g_jax.motion.rotations import conjugate, multiply, rotate
from ha2g_jax.motion.smoothing import slow_mean
from ha2g_jax.skeleton import Skeleton

# Beyond the motion (a share above 1) a turn is held before these angles from the mean pose, in radians, unless the
# motion itself is farther; an elbow before it is straight or folded, a wrist before it is bent too far.
_FARTHEST = {TRUNK: 0.5, HEAD: 0.9, UPPER_ARM: 2.4, HAND: 1.9}
ELBOW_LIMITS = np.deg2rad(8), np.deg2rad(145)
_WRIST_LIMITS = -np.deg2rad(70), np.deg2rad(70)
_LEAST_ROOM = 1e-3


def scale_about(
    reference: np.ndarray, directions: np.ndarray, share: np.ndarray | float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Poses at a share of their way from a reference pose.

    Args:
        reference: (bones, 3) unit vectors.
        directions: (T, bones, 3) unit vectors.
        share: of each frame (T,) or of all, from 0 to 1.
        chosen: the parts that are moved; with a part, those it hangs on.

    Returns:
        (T, bones, 3) float32 unit vectors: the input itself where the share is 1 and in parts that are not chosen.
    """
    shares = np.broadcast_to(np.asarray(share, np.float64), (len(directions),))
    rows = np.flatnonzero(shares != 1)
    result = np.array(directions, np.float32)
    if len(rows):
        turns = away_from(reference, result[rows], chosen)
        scaled = {bones: power(turn, shares[rows]) for bones, turn in turns.items()}
        for bone, vectors in poses_of(reference, scaled, chosen).items():
            result[rows, bone] = vectors
    return result


def scale_about_mean(
    skeleton: Skeleton, directions: np.ndarray, fps: float, share: float, seconds: float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Poses at a share of their way from the slow mean pose.

    A share above 1 does not change the shape of a hand, and adds less where a joint would turn too far.

    Args:
        skeleton: of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        share: at least 0.
        seconds: what is slower is the mean.
        chosen: the parts that are moved; with a part, those it hangs on.

    Returns:
        (T, bones, 3) float32 unit vectors: the input itself in parts that are not chosen.
    """
    reference = rest_pose(skeleton).astype(np.float64)
    turns = away_from(reference, directions, chosen)
    means = {bones: slow_mean(turn, fps, seconds) for bones, turn in turns.items()}
    shares = _shares(reference, turns, means, share, chosen)
    scaled = {
        bones: multiply(mean, power(multiply(conjugate(mean), turns[bones]), shares[bones]))
        for bones, mean in means.items()
    }
    result = np.array(directions, np.float32)
    for bone, vectors in poses_of(reference, scaled, chosen).items():
        result[:, bone] = vectors
    return result


def held(share: float, rise: np.ndarray, room: np.ndarray) -> np.ndarray:
    """A share above 1 that adds less than there is room for: 1 + (s - 1) tanh(z) / z, z = (s - 1) rise / room.

    Args:
        share: what is asked for; up to 1 it is given.
        rise: (T,) what the motion adds to the reference, of either sign.
        room: (T,) what may be added to the motion in the direction of `rise`.

    Returns:
        (T,) shares between 1 and the one asked for.
    """
    if share <= 1:
        return np.full(len(rise), share)
    z = np.maximum((share - 1) * np.abs(rise) / np.maximum(room, _LEAST_ROOM), 1e-6)
    return 1 + (share - 1) * np.tanh(z) / z


def _shares(reference: np.ndarray, turns: Turns, means: Turns, share: float, chosen: tuple[Part, ...]) -> Turns:
    """The share (T,) of each turn."""
    shares = {bones: np.full(len(turn), min(share, 1.0)) for bones, turn in turns.items()}
    for part in chosen:
        if part.kind not in (TRUNK, HEAD, UPPER_ARM, FOREARM, HAND):
            continue
        turn, mean = turns[part.bones], means[part.bones]
        farthest = _FARTHEST.get(part.kind, np.pi)
        angle = 2 * np.arccos(np.clip(np.abs(np.sum(turn * mean, axis=-1)), 0, 1))
        shares[part.bones] = held(share, angle, farthest - angle)
        if part.kind in (FOREARM, HAND):
            limits = ELBOW_LIMITS if part.kind == FOREARM else _WRIST_LIMITS
            along = reference[list(part.bones)].mean(axis=0)
            bend, usual = (_angle(reference[part.parent], rotate(q, along)) for q in (turn, mean))
            room = np.where(bend > usual, limits[1] - bend, bend - limits[0])
            shares[part.bones] = np.minimum(shares[part.bones], held(share, bend - usual, room))
    return shares


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Radians between vectors (..., 3) of any positive length."""
    return np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), np.sum(first * second, axis=-1))

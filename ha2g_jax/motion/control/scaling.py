"""Scaling of a motion about a pose, and of the reach of its arms.

Directions are (T, bones, 3) unit vectors; the parts to move include those that they are attached to, and other parts
stay.
"""

import numpy as np

from ha2g_jax.motion.control.parts import (
    FOREARM,
    HAND,
    HEAD,
    SIDES,
    TRUNK,
    UPPER_ARM,
    Part,
    Rotations,
    apply_rotations,
    arm_parts,
    bones_of,
    power,
    rest_pose,
    rotations_from,
)
from ha2g_jax.motion.rotations import between, conjugate, multiply, perpendicular, rotate, unit
from ha2g_jax.motion.smoothing import slow_mean
from ha2g_jax.skeleton import Skeleton

# A scale above 1 keeps rotations within these angles from the mean pose, in radians, unless the motion itself exceeds
# them; elbows and wrists stay within the limits of their bend.
_FARTHEST = {TRUNK: 0.5, HEAD: 0.9, UPPER_ARM: 2.4, HAND: 1.9}
ELBOW_LIMITS = np.deg2rad(8), np.deg2rad(145)
_WRIST_LIMITS = -np.deg2rad(70), np.deg2rad(70)
_LEAST_HEADROOM = 1e-3


def scale_about(
    reference: np.ndarray, directions: np.ndarray, scale: np.ndarray | float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Scale the rotations of a motion from a reference pose (bones, 3) by factors from 0 to 1, one or one a frame (T,).

    Where the scale is 1 the result is the input itself.
    """
    scales = np.broadcast_to(np.asarray(scale, np.float64), (len(directions),))
    rows = np.flatnonzero(scales != 1)
    result = np.array(directions, np.float32)
    if len(rows):
        rotations = rotations_from(reference, result[rows], chosen)
        scaled = {bones: power(rotation, scales[rows]) for bones, rotation in rotations.items()}
        for bone, vectors in apply_rotations(reference, scaled, chosen).items():
            result[rows, bone] = vectors
    return result


def scale_about_mean(
    skeleton: Skeleton, directions: np.ndarray, fps: float, scale: float, seconds: float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Scale the rotations of a motion from its slow mean pose, the mean over a window of some seconds.

    A scale above 1 does not change the shape of a hand, and adds less near the limits of a joint.
    """
    reference = rest_pose(skeleton).astype(np.float64)
    rotations = rotations_from(reference, directions, chosen)
    means = {bones: slow_mean(rotation, fps, seconds) for bones, rotation in rotations.items()}
    return _scaled(reference, directions, rotations, means, scale, chosen)


def scale_about_posture(
    skeleton: Skeleton, posture: np.ndarray, directions: np.ndarray, scale: float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Scale the rotations of a motion from a pose (bones, 3) that it moves about, see `scale_about_mean`."""
    reference = rest_pose(skeleton).astype(np.float64)
    both = rotations_from(reference, np.concatenate([posture[None], directions]), chosen)
    rotations = {bones: rotation[1:] for bones, rotation in both.items()}
    means = {}
    for bones, rotation in both.items():  # of the two quaternions of a rotation, the nearer one
        is_near = np.sum(rotation[:1] * rotation[1:], axis=-1, keepdims=True) >= 0
        means[bones] = np.where(is_near, rotation[:1], -rotation[:1])
    return _scaled(reference, directions, rotations, means, scale, chosen)


def _scaled(
    reference: np.ndarray,
    directions: np.ndarray,
    rotations: Rotations,
    means: Rotations,
    scale: float,
    chosen: tuple[Part, ...],
) -> np.ndarray:
    """Return a motion (T, bones, 3) with its rotations scaled from their means."""
    scales = _scales(reference, rotations, means, scale, chosen)
    scaled = {
        bones: multiply(mean, power(multiply(conjugate(mean), rotations[bones]), scales[bones]))
        for bones, mean in means.items()
    }
    result = np.array(directions, np.float32)
    for bone, vectors in apply_rotations(reference, scaled, chosen).items():
        result[:, bone] = vectors
    return result


def limit_scale(scale: float, rise: np.ndarray, headroom: np.ndarray) -> np.ndarray:
    """Limit a scale s above 1 so that it adds less than the headroom.

    The result is 1 + (s - 1) tanh(z) / z with z = (s - 1) rise / headroom.

    Args:
        rise: (T,) difference between the motion and the reference, of either sign.
        headroom: (T,) most that may be added to the motion in the direction of `rise`.
    """
    if scale <= 1:
        return np.full(len(rise), scale)
    z = np.maximum((scale - 1) * np.abs(rise) / np.maximum(headroom, _LEAST_HEADROOM), 1e-6)
    return 1 + (scale - 1) * np.tanh(z) / z


def _scales(
    reference: np.ndarray, rotations: Rotations, means: Rotations, scale: float, chosen: tuple[Part, ...]
) -> Rotations:
    """Return the limited scale (T,) of each rotation."""
    scales = {bones: np.full(len(rotation), min(scale, 1.0)) for bones, rotation in rotations.items()}
    for part in chosen:
        if part.kind not in (TRUNK, HEAD, UPPER_ARM, FOREARM, HAND):
            continue
        rotation, mean = rotations[part.bones], means[part.bones]
        farthest = _FARTHEST.get(part.kind, np.pi)
        angle = 2 * np.arccos(np.clip(np.abs(np.sum(rotation * mean, axis=-1)), 0, 1))
        scales[part.bones] = limit_scale(scale, angle, farthest - angle)
        if part.kind in (FOREARM, HAND):
            limits = ELBOW_LIMITS if part.kind == FOREARM else _WRIST_LIMITS
            along = reference[list(part.bones)].mean(axis=0)
            bend, usual = (_angle(reference[part.parent], rotate(q, along)) for q in (rotation, mean))
            headroom = np.where(bend > usual, limits[1] - bend, bend - limits[0])
            scales[part.bones] = np.minimum(scales[part.bones], limit_scale(scale, bend - usual, headroom))
    return scales


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles in radians between vectors (..., 3) of any positive length."""
    return np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), np.sum(first * second, axis=-1))


def reach_farther(skeleton: Skeleton, directions: np.ndarray, amount: float) -> np.ndarray:
    """Move each wrist to `amount` times, at least 1, its distance from its rest position relative to the shoulder.

    A wrist is not raised above its shoulder, where the hand would hide the face, unless the motion raises it. It moves
    less where the arm would be straight or folded. The elbow stays on its side of the arm, and the hand keeps its pose
    relative to the forearm. Only the arms change.
    """
    result = np.array(directions, np.float32)
    resting = rest_pose(skeleton).astype(np.float64)
    for side in SIDES:
        upper, fore = (skeleton.bone(f"{side}_{joint}") for joint in ("elbow", "wrist"))
        hand = [bone for bone in bones_of(arm_parts(skeleton, side)) if bone not in (upper, fore)]
        lengths = skeleton.lengths[[upper, fore]].astype(np.float64)
        old = unit(result[:, [upper, fore]])
        wrist, rest = lengths @ old, lengths @ resting[[upper, fore]]
        target = _within_reach(wrist, _below_the_face(wrist, rest + amount * (wrist - rest)), lengths)
        swing = between(wrist, target)
        new = _bend(rotate(swing, old[:, 0]), target, lengths)
        rotation = multiply(between(rotate(swing, old[:, 1]), new[:, 1]), swing)
        result[:, [upper, fore]] = new
        result[:, hand] = rotate(rotation[:, None], result[:, hand].astype(np.float64))
    return result


def _below_the_face(wrist: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Limit targets (T, 3) to rise by less than the height of the shoulder above the wrist; y points down."""
    rise, headroom = wrist[:, 1] - target[:, 1], np.maximum(wrist[:, 1], 1e-4)
    limited = np.minimum(rise, headroom * np.tanh(rise / headroom))
    return np.column_stack([target[:, 0], wrist[:, 1] - limited, target[:, 2]])


def _within_reach(wrist: np.ndarray, target: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Limit targets (T, 3) to distances at which the elbow is neither straight nor folded."""
    farthest, nearest = (np.sqrt(lengths @ lengths + 2 * lengths.prod() * np.cos(bend)) for bend in ELBOW_LIMITS)
    old, new = (np.linalg.norm(vectors, axis=-1) for vectors in (wrist, target))
    headroom = np.maximum(np.where(new > old, farthest - old, old - nearest), 1e-4)
    limited = old + headroom * np.tanh((new - old) / headroom)
    return target * (limited / np.maximum(new, 1e-9))[:, None]


def _bend(upper: np.ndarray, target: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the upper arm and forearm (T, 2, 3) that reach `target` with the elbow on the side of `upper`."""
    distance = np.linalg.norm(target, axis=-1, keepdims=True)
    along = target / distance
    across = upper - np.sum(upper * along, axis=-1, keepdims=True) * along
    is_clear = np.linalg.norm(across, axis=-1, keepdims=True) > 1e-6
    across = np.where(is_clear, unit(across), perpendicular(along))
    first, second = lengths
    cosine = np.clip((first**2 + distance**2 - second**2) / (2 * first * distance), -1, 1)
    bent = cosine * along + np.sqrt(1 - cosine**2) * across
    return np.stack([bent, unit(target - first * bent)], axis=1)

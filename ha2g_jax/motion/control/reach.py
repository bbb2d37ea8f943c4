"""Enlargement of gestures: the wrists are moved away from their rest position, and the arms follow."""

import numpy as np

from ha2g_jax.motion.control.parts import SIDES, arm_parts, bones_of, rest_pose
from ha2g_jax.motion.control.scaling import ELBOW_LIMITS
from ha2g_jax.motion.rotations import between, multiply, perpendicular, rotate, unit
from ha2g_jax.skeleton import Skeleton


def reach_farther(skeleton: Skeleton, directions: np.ndarray, amount: float) -> np.ndarray:
    """Move each wrist to `amount` times its distance from its rest position relative to the shoulder.

    A wrist is not raised above its shoulder, where the hand would hide the face, unless the motion raises it. It moves
    less where the arm would be straight or folded. The elbow stays on its side of the arm, and the hand keeps its pose
    relative to the forearm.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        amount: factor of the distance, at least 1.

    Returns:
        (T, bones, 3) float32 unit vectors; only those of the arms change.
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

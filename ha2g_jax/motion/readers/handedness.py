"""Detection of motion whose left and right are mirrored, as in a file with left-handed axes.

A mirror image has the bones and the speeds of the motion, but no human body: where left and up point to the person's
back, toes and knees point backwards, and fingers bend towards the back of the hand.
"""

import numpy as np

from ha2g_jax.skeleton import Skeleton

_MIN_EVIDENCE = 0.15  # mean of what feet and hands say, each from -1 to 1, from which a verdict is given
_FINGERS = ("index", "middle", "ring", "pinky")


def is_mirrored(positions: np.ndarray, skeleton: Skeleton, feet: np.ndarray | None = None) -> bool:
    """Return whether a motion is clearly the mirror image of a person's.

    Args:
        positions: (T, joints, 3) in any unit and any axes, with the names of the skeleton.
        skeleton: skeleton of the joints.
        feet: (T, 4, 3) left ankle, left ball of the foot, right ankle and right ball in the same axes, if known.
    """
    signs = [_bend(positions, skeleton, side) for side in ("left", "right") if "left_index_1" in skeleton.joints]
    if feet is not None:
        signs += [_toes(positions, skeleton, feet)] * 2  # feet are seen more clearly than hands
    return bool(signs) and float(np.mean(signs)) < -_MIN_EVIDENCE


def _toes(positions: np.ndarray, skeleton: Skeleton, feet: np.ndarray) -> float:
    """Return the mean cosine between the feet and the front of the person, both level."""
    spine, neck, left, right = (
        positions[:, skeleton.joint(name)] for name in ("spine", "neck", "left_shoulder", "right_shoulder")
    )
    up = (neck - spine).mean(axis=0)
    up = up / np.linalg.norm(up)
    ahead = np.cross(left - right, up)
    toes = (feet[:, 1] - feet[:, 0]) + (feet[:, 3] - feet[:, 2])
    toes = toes - (toes @ up)[:, None] * up
    lengths = np.linalg.norm(toes, axis=-1) * np.linalg.norm(ahead, axis=-1)
    return float(np.mean(np.sum(toes * ahead, axis=-1) / np.maximum(lengths, 1e-12)))


def _bend(positions: np.ndarray, skeleton: Skeleton, side: str) -> float:
    """Return how far the fingers of a hand bend to the palm, from -1 (to its back) to 1; 0 for straight fingers."""

    def at(name: str) -> np.ndarray:
        return positions[:, skeleton.joint(f"{side}_{name}")]

    along = at("middle_1") - at("wrist")
    palm = np.cross(at("index_1") - at("pinky_1"), along) * (1 if side == "right" else -1)
    palm = _unit(palm)
    bends = []
    for finger in _FINGERS:
        first, second = at(f"{finger}_2") - at(f"{finger}_1"), at(f"{finger}_3") - at(f"{finger}_2")
        # The second bone is bent against the first, which flat hands do not show.
        bends.append(np.sum((_unit(second) - _unit(first)) * palm, axis=-1))
    return float(np.clip(2 * np.median(bends), -1, 1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)

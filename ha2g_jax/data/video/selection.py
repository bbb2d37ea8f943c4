"""The three conditions under which a shot is of interest (HA2G, Appendix A): seen, not still, long enough."""

import numpy as np

from ha2g_jax.skeleton import Skeleton

UNSEEN = "keypoints unseen"
STILL = "still"
TOO_SHORT = "too short"


def too_short(num_frames: int, fps: float, min_seconds: float) -> str | None:
    """`TOO_SHORT` unless the shot is longer than `min_seconds` (condition 3)."""
    return None if num_frames / fps > min_seconds else TOO_SHORT


def unseen(confidence: np.ndarray, min_confidence: float, min_visible: float) -> str | None:
    """`UNSEEN` unless all keypoints are seen at once in more than the share `min_visible` of the frames (condition 1).

    Args:
        confidence: (T, joints) in [0, 1], 0 where a keypoint was not found.
        min_confidence: from which a keypoint counts as seen.
        min_visible: share of the frames.
    """
    return None if len(confidence) and seen(confidence, min_confidence).mean() > min_visible else UNSEEN


def still(positions: np.ndarray, skeleton: Skeleton, min_motion: float) -> str | None:
    """`STILL` if both wrists hardly move (condition 2).

    The measure is that of the TED data's windows: the variance of a wrist's position, summed over x, y and z.

    Args:
        positions: (T, joints, 3) in metres, finite.
        skeleton: of the positions.
        min_motion: variance in square metres from which a wrist counts as moving.
    """
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]].astype(np.float64)
    return STILL if (wrists.var(axis=0).sum(axis=-1) < min_motion).all() else None


def seen(confidence: np.ndarray, min_confidence: float) -> np.ndarray:
    """(T,) whether all keypoints of (T, keypoints) confidences are seen; a confidence of 0 never counts."""
    return np.all((confidence >= min_confidence) & (confidence > 0), axis=1)


def hand_joints(skeleton: Skeleton) -> list[int]:
    """The joints of both hands: wrists and fingers."""
    fingers = ("thumb", "index", "middle", "ring", "pinky")
    return [number for number, name in enumerate(skeleton.joints) if any(part in name for part in ("wrist", *fingers))]

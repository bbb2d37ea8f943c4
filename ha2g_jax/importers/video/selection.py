"""The three conditions that a shot must fulfil (HA2G, Appendix A): seen, not still, long enough."""

import numpy as np

from ha2g_jax.skeleton import Skeleton

UNSEEN = "keypoints unseen"
STILL = "still"
TOO_SHORT = "too short"


def too_short(num_frames: int, fps: float, min_seconds: float) -> str | None:
    """Return `TOO_SHORT` unless the shot is longer than the minimum (condition 3), else None.

    Args:
        num_frames: number of images of the shot.
        fps: images per second.
        min_seconds: minimum length in seconds.
    """
    return None if num_frames / fps > min_seconds else TOO_SHORT


def unseen(confidence: np.ndarray, min_confidence: float, min_visible: float) -> str | None:
    """Return `UNSEEN` unless all keypoints are seen at once in enough images (condition 1), else None.

    Args:
        confidence: (T, joints) in [0, 1], 0 where a keypoint was not found.
        min_confidence: minimum confidence of a keypoint that counts as seen.
        min_visible: fraction of the images that must be exceeded.
    """
    return None if len(confidence) and seen(confidence, min_confidence).mean() > min_visible else UNSEEN


def still(positions: np.ndarray, skeleton: Skeleton, min_motion: float) -> str | None:
    """Return `STILL` if both wrists hardly move (condition 2), else None.

    The measure is that of the windows of the TED data: the variance of a wrist's position, summed over x, y and z.

    Args:
        positions: (T, joints, 3) in metres, finite.
        skeleton: skeleton of the positions.
        min_motion: minimum variance of a moving wrist in square metres.
    """
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]].astype(np.float64)
    return STILL if (wrists.var(axis=0).sum(axis=-1) < min_motion).all() else None


def seen(confidence: np.ndarray, min_confidence: float) -> np.ndarray:
    """Determine in which images all keypoints are seen; a confidence of 0 never counts as seen.

    Args:
        confidence: (T, keypoints) in [0, 1].
        min_confidence: minimum confidence of a keypoint that counts as seen.

    Returns:
        (T,) bool.
    """
    return np.all((confidence >= min_confidence) & (confidence > 0), axis=1)


def hand_joints(skeleton: Skeleton) -> list[int]:
    """Return the indices of the joints of both hands: wrists and fingers."""
    fingers = ("thumb", "index", "middle", "ring", "pinky")
    return [number for number, name in enumerate(skeleton.joints) if any(part in name for part in ("wrist", *fingers))]

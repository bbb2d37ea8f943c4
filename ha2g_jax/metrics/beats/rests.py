"""BEAT alignment, the score of the BEAT family of data sets: the rests of every joint against the onsets of the voice.

BEAT (Liu et al., ECCV 2022) and EMAGE (2024). It asks only whether an onset has a rest near it, with a kernel of 0.3 s,
so that a motion with many rests scores high by chance: read it beside the real motion and mismatched speech.
"""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.metrics.beats.times import kernel, nearest
from ha2g_jax.skeleton import Skeleton

SIGMA = 0.3  # seconds, width of the kernel; 0.5 in the experiments of SHOW
THRESHOLD = 0.3  # in units of a joint's mean speed, above which a minimum counts; 0.1 in GENEA 2025
ORDER = 7  # frames on either side at 30 fps that a minimum lies below

JOINTS = {
    "ted_expressive": (
        *("spine", "neck", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist"),
        *("right_wrist", "nose", "right_eye", "left_eye", "right_ear", "left_ear"),
    ),
    "ted_gesture": ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"),
}

_STILL = 1e-5  # units a second below which a joint does not move: the rounding of float32 positions


def upper_body(skeleton: Skeleton) -> list[int]:
    """Return the joints to score: the 13 of TED-Expressive that are not of a hand, the arms of TED-Gesture.

    The root of direction vectors, TED-Expressive's spine, never moves and is left out by `beat_align`: 12 of 13 count.
    """
    return [skeleton.joint(name) for name in JOINTS[skeleton.name]]


def order(fps: float) -> int:
    """Return the frames on either side that a minimum lies below: 7 at 30 fps, 3 at 15, at least 1."""
    return max(1, int(ORDER * fps / 30))


def mean_speeds(clips: Sequence[np.ndarray], fps: float, *, first_frame: int = 4) -> np.ndarray:
    """Compute the mean speed (joints,) of each joint over clips (T, joints, 3), in units of the positions a second.

    Clips with fewer than 2 scored frames are left out.
    """
    speeds = [joint_speeds(clip[first_frame:], fps) for clip in clips if len(clip) >= first_frame + 2]
    return np.concatenate(speeds).mean(axis=0) if speeds else np.zeros(clips[0].shape[1])


def joint_speeds(positions: np.ndarray, fps: float) -> np.ndarray:
    """Compute speeds (T, joints) of positions (T, joints, 3), T >= 2, by central differences, one-sided at the ends."""
    return np.linalg.norm(np.gradient(np.asarray(positions, np.float64), axis=0), axis=-1) * fps


def rests(speeds: np.ndarray, num_frames: int, threshold: float = THRESHOLD) -> np.ndarray:
    """Return the frames (n,) at which a speed (T,) above `threshold` is strictly below `num_frames` on either side.

    At the ends fewer neighbours are compared; the first and the last frame are no rests.
    """
    frames = np.arange(len(speeds))
    is_rest = speeds > threshold
    for shift in range(1, num_frames + 1):
        is_rest &= speeds < speeds[np.maximum(frames - shift, 0)]
        is_rest &= speeds < speeds[np.minimum(frames + shift, len(speeds) - 1)]
    return np.flatnonzero(is_rest)


def beat_align(
    positions: np.ndarray,
    onsets: np.ndarray,
    speeds: np.ndarray,
    fps: float,
    *,
    sigma: float = SIGMA,
    threshold: float = THRESHOLD,
    first_frame: int = 4,
) -> float:
    """Compute the mean over joints and onsets of exp(-d^2 / (2 sigma^2)), with d to the nearest rest of the joint.

    Speeds, minima and times are all of the scored frames, so that no index is off by the frames that are not scored.

    Args:
        positions: (T, joints, 3) of the joints to score, such as those of `upper_body`.
        onsets: (n,) times in seconds; those from the first scored frame to the end of the motion count.
        speeds: (joints,) from `mean_speeds` of the data set; a joint that never moves there is left out.
        fps: frames per second.
        sigma: width of the kernel in seconds.
        threshold: speed relative to the mean above which a minimum is a rest.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        A number in [0, 1], 0 for motion without a rest and for a joint without one; NaN where no onset counts or fewer
        than 2 frames are scored.
    """
    onsets = np.sort(np.asarray(onsets, np.float64))
    scored = onsets[(onsets >= first_frame / fps) & (onsets < len(positions) / fps)]
    if not len(scored) or len(positions) < first_frame + 2:
        return np.nan
    moving = np.flatnonzero(speeds > _STILL)
    relative = joint_speeds(positions[first_frame:, moving], fps) / speeds[moving]
    scores = []
    for joint in range(len(moving)):
        times = (first_frame + rests(relative[:, joint], order(fps), threshold)) / fps
        scores.append(np.mean(kernel(nearest(scored, times), sigma)))
    return float(np.mean(scores)) if scores else 0.0

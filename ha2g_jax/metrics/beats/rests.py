"""BEAT alignment, the score of the BEAT data sets: how near the onsets of the voice are to rests of every joint.

BEAT (Liu et al., ECCV 2022) and EMAGE (Liu et al., CVPR 2024). It asks only whether an onset has a rest near it, with a
kernel of 0.3 s, so that a motion with many rests scores high by chance: compare it with the scores of the real motion
and of mismatched speech.

The protocol BEAT2 scores all joints of SMPL-X at 30 frames per second, without translation. Published numbers use the
SMPL-X body model, onsets of librosa, and an auto-encoder of their own; BC is often multiplied by 10.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from ha2g_jax.metrics.beats.times import kernel, nearest
from ha2g_jax.metrics.kinematics import STILL, l1_diversity
from ha2g_jax.metrics.metric import BEAT2, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, mean_by_recording
from ha2g_jax.skeleton import Skeleton

SIGMA = 0.3  # seconds, width of the kernel; 0.5 in the experiments of SHOW
THRESHOLD = 0.3  # in units of a joint's mean speed, above which a minimum counts; 0.1 in GENEA 2025
ORDER = 7  # frames on either side, at 30 fps, whose speed must be above that of a minimum

JOINTS = {
    "ted_expressive": (
        *("spine", "neck", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist"),
        *("right_wrist", "nose", "right_eye", "left_eye", "right_ear", "left_ear"),
    ),
    "ted_gesture": ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"),
}

FPS = 30.0
EDGE = 60  # frames at both ends of a sequence in which beats are not scored

UPPER_BODY = (
    *("spine1", "spine2", "spine3", "neck", "left_collar", "right_collar", "head"),
    *("left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
)
"""The 13 joints whose rests are compared with the onsets."""


def upper_body(skeleton: Skeleton) -> list[int]:
    """Return the joints to score: the 13 of TED-Expressive that do not belong to a hand, the arms of TED-Gesture.

    The root of direction vectors, TED-Expressive's spine, never moves and is left out by `beat_align`: 12 of 13 count.
    """
    return [skeleton.joint(name) for name in JOINTS[skeleton.name]]


def order(fps: float) -> int:
    """Return the number of frames on either side that a minimum is below: 7 at 30 fps, 3 at 15, at least 1."""
    return max(1, int(ORDER * fps / 30))


def mean_speeds(clips: Sequence[np.ndarray], fps: float) -> np.ndarray:
    """Compute the mean speed (joints,) of each joint over clips (T, joints, 3), in units of the positions a second."""
    speeds = [joint_speeds(clip, fps) for clip in clips if len(clip) >= 2]
    return np.concatenate(speeds).mean(axis=0) if speeds else np.zeros(clips[0].shape[1])


def joint_speeds(positions: np.ndarray, fps: float) -> np.ndarray:
    """Compute speeds (T, joints) of positions (T, joints, 3), T >= 2, by central differences, one-sided at the ends."""
    return np.linalg.norm(np.gradient(np.asarray(positions, np.float64), axis=0), axis=-1) * fps


def rests(speeds: np.ndarray, num_frames: int, threshold: float = THRESHOLD) -> np.ndarray:
    """Return the frames (n,) at which a speed (T,) above `threshold` is strictly below `num_frames` on either side.

    At the ends fewer neighbours are compared; the first and the last frame are never rests.
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
    first_frame: int = SEED_FRAMES,
) -> float:
    """Compute the mean over joints and onsets of exp(-d^2 / (2 sigma^2)), with d to the nearest rest of the joint.

    Speeds, minima and times refer to the scored frames, so that no index is off by the frames that are not scored.

    Args:
        positions: (T, joints, 3) of the joints to score, such as those of `upper_body`.
        onsets: (n,) times in seconds; those from the first scored frame to the end of the motion count.
        speeds: (joints,) from `mean_speeds` of the data set; a joint that never moves there is left out.
        threshold: speed relative to the mean above which a minimum is a rest.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        A number in [0, 1]; a joint without a rest counts as 0. NaN where no onset counts or fewer than 2 frames are
        scored.
    """
    onsets = np.sort(np.asarray(onsets, np.float64))
    scored = onsets[(onsets >= first_frame / fps) & (onsets < len(positions) / fps)]
    if not len(scored) or len(positions) < first_frame + 2:
        return np.nan
    moving = np.flatnonzero(speeds > STILL)
    relative = joint_speeds(positions[first_frame:, moving], fps) / speeds[moving]
    scores = []
    for joint in range(len(moving)):
        times = (first_frame + rests(relative[:, joint], order(fps), threshold)) / fps
        scores.append(np.mean(kernel(nearest(scored, times), sigma)))
    return float(np.mean(scores)) if scores else 0.0


@dataclasses.dataclass(frozen=True)
class Beat2Row:
    """The motions of one row; the first axis is the sequences.

    Attributes:
        joints: (T, 55, 3) positions of the joints of SMPL-X in metres, the person at the origin.
        onsets: times of the onsets of the sound in seconds, None without sound.
        speeds: (13,) mean speeds of the joints of `UPPER_BODY` over the reference, in metres per second.
        upper: indices of these joints among the 55.
        members: (n,) index of the recording of each sequence.
    """

    joints: list[np.ndarray]
    onsets: list[np.ndarray | None]
    speeds: np.ndarray
    upper: list[int]
    members: np.ndarray
    num_recordings: int


def beat_consistency(joints: np.ndarray, onsets: np.ndarray, speeds: np.ndarray) -> float:
    """Compute the BC of EMAGE: `beat_align` of `UPPER_BODY` (T, 13, 3) without the first and the last 2 seconds."""
    return beat_align(joints[: len(joints) - EDGE], onsets, speeds, FPS, first_frame=EDGE)


def _by_frames(values: list[float], row: Beat2Row, lengths: list[int]) -> Statistic:
    return mean_by_recording(values, row.members, row.num_recordings, np.array(lengths, float))


def _diversity(row: Beat2Row) -> Statistic:
    values = [l1_diversity(joints) for joints in row.joints]
    return _by_frames(values, row, [len(joints) for joints in row.joints])


def _consistency(row: Beat2Row) -> Statistic | None:
    if all(onsets is None for onsets in row.onsets):
        return None
    values = [
        np.nan if onsets is None else beat_consistency(joints[:, row.upper], onsets, row.speeds)
        for joints, onsets in zip(row.joints, row.onsets, strict=True)
    ]
    return _by_frames(values, row, [max(len(joints) - 2 * EDGE, 0) for joints in row.joints])


def _metric(name: str, title: str, digits: int, measure: Callable[[Beat2Row], Statistic | None]) -> Metric:
    return Metric(f"beat2_{name}", title, "", "higher", BEAT2, digits, measure, "beat2")


BEAT2_METRICS = (_metric("bc", "BC", 4, _consistency), _metric("l1div", "L1div", 3, _diversity))

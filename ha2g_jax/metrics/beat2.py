"""Scores as the papers on BEAT2 define them: of all joints of SMPL-X at 30 frames per second, without translation.

EMAGE (Liu et al., CVPR 2024) and BEAT (Liu et al., ECCV 2022), from their definitions. Their published numbers are of
the SMPL-X body model, of onsets of librosa, and of an auto-encoder of their own; BC is often printed times 10.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.kinematics import l1_diversity
from ha2g_jax.metrics.metric import BEAT2, Metric, Statistic
from ha2g_jax.metrics.row import mean_by_recording

FPS = 30.0
EDGE = 60  # frames at both ends of a sequence in which beats are not scored

UPPER_BODY = (
    *("spine1", "spine2", "spine3", "neck", "left_collar", "right_collar", "head"),
    *("left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
)
"""The 13 joints whose rests are compared with the onsets."""


@dataclasses.dataclass(frozen=True)
class Beat2Row:
    """The motions of one row; the first axis is the sequences.

    Attributes:
        joints: (T, 55, 3) metres of the joints of SMPL-X, the person at the origin.
        onsets: seconds of the onsets of the sound, None without sound.
        speeds: (13,) mean speeds of the joints of `UPPER_BODY` over the reference, in metres per second.
        upper: indices of these joints among the 55.
        members: (n,) index of the recording of each sequence.
        num_recordings: number of recordings.
    """

    joints: list[np.ndarray]
    onsets: list[np.ndarray | None]
    speeds: np.ndarray
    upper: list[int]
    members: np.ndarray
    num_recordings: int


def beat_consistency(joints: np.ndarray, onsets: np.ndarray, speeds: np.ndarray) -> float:
    """Compute BC of a sequence: the mean over 13 joints and over onsets of exp(-d^2 / (2 0.3^2)) to the nearest rest.

    A rest is a minimum of the speed below 7 frames on either side, above 0.3 of the joint's mean speed. The first and
    the last 2 seconds are not scored.

    Args:
        joints: (T, 13, 3) metres of the joints of `UPPER_BODY`.
        onsets: (n,) seconds.
        speeds: (13,) mean speeds over the data set.

    Returns:
        A number in [0, 1]; NaN where no onset or no frame is scored.
    """
    return rests.beat_align(joints[: len(joints) - EDGE], onsets, speeds, FPS, first_frame=EDGE)


def _by_frames(values: list[float], row: Beat2Row, lengths: list[int]) -> Statistic:
    return mean_by_recording(values, row.members, row.num_recordings, np.array(lengths, float))


def _diversity(row: Beat2Row) -> Statistic:
    values = [l1_diversity(joints, first_frame=0) for joints in row.joints]
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

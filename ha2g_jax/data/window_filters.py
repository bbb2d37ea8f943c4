"""The choice of windows of a clip for training: the filters of the TED data, for data of any origin."""

import collections
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.records import frames_at
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import Skeleton

KEPT = "kept"
TOO_FEW_WORDS = "too_few_words"
MEAN_POSE = "pose"
SPINE_ANGLE = "spine angle"
MOTION = "motion"
REASONS = (TOO_FEW_WORDS, MEAN_POSE, SPINE_ANGLE, MOTION)

_UPRIGHT = np.array([0.0, -1.0, 0.0])  # y points down


class WindowFilters(NamedTuple):
    """Conditions that a window must fulfil; None switches a filter off.

    Attributes:
        min_words: minimum number of words that overlap the window.
        min_pose_distance: minimum of the mean |pose - mean pose| over frames, joints and axes, in metres; below it the
            pose estimator has fallen back on its mean pose.
        max_spine_angle: maximum angle between the spine and upright in any frame, in degrees.
        max_mean_spine_angle: maximum of the mean over the frames of that angle, in degrees.
        min_wrist_variance: minimum variance of a wrist's position, in square metres; a window fails if both wrists are
            below it.
        num_frames: length of a window, in frames at 15 fps.
        stride: time between the starts of two windows, in frames at 15 fps.
    """

    min_words: int | None = 2
    min_pose_distance: float | None = 0.02
    max_spine_angle: float | None = 30.0
    max_mean_spine_angle: float | None = 20.0
    min_wrist_variance: float | None = 0.0014
    num_frames: int = 42
    stride: int = 10


# 42 frames = round(34 * 1.25): the first 34 frames of each window that passes are the training sample.
TED = WindowFilters()
# In motion capture, a person who leans or stands in the mean pose is not a tracking error.
MOCAP = WindowFilters(min_pose_distance=None, max_spine_angle=None, max_mean_spine_angle=None, num_frames=34)


class WindowChoice(NamedTuple):
    """The windows of one clip.

    Attributes:
        starts: first frame of each window that is kept.
        verdicts: verdict on every window in order, `KEPT` or one of `REASONS`.
    """

    starts: tuple[int, ...]
    verdicts: tuple[str, ...]

    @property
    def filtered(self) -> collections.Counter[str]:
        """Number of dropped windows by reason, without reasons that dropped none."""
        return collections.Counter(verdict for verdict in self.verdicts if verdict != KEPT)


def choose_windows(
    positions: np.ndarray,
    words: Sequence[Word],
    skeleton: Skeleton,
    *,
    start_time: float = 0.0,
    fps: float = 15,
    filters: WindowFilters = TED,
) -> WindowChoice:
    """Apply the filters to the windows of a clip; the verdict on a window is the first filter that it fails.

    The filters in order: too few words, then as in the TED data (HA2G, Appendix A) pose, spine angle and motion.

    Args:
        positions: (T, joints, 3) in metres, y down, finite; not recentred.
        words: in the clock of `start_time`. Without any, `min_words` drops every window: importers that have no
            transcript switch it off.
        skeleton: gives the joints and, for the distance from it, the mean pose.
        start_time: time of the first frame in the clock of the words, in seconds.
        fps: frames per second of `positions`.
        filters: the filters, and the length and stride of windows at 15 fps; at other rates they take as much time.

    Returns:
        The windows; none if the clip is shorter than a window.
    """
    length, stride = (frames_at(frames, fps) for frames in (filters.num_frames, filters.stride))
    filters = filters._replace(num_frames=length, stride=stride)
    starts = np.arange(0, len(positions) - length + 1, stride)
    verdicts = np.full(len(starts), KEPT, object)
    if len(starts):
        # From the last filter to the first, so that the verdict is the first filter that a window fails.
        for reason, is_failed in (
            (MOTION, _too_still(positions, starts, skeleton, filters)),
            (SPINE_ANGLE, _too_tilted(positions, starts, skeleton, filters)),
            (MEAN_POSE, _too_near_mean_pose(positions, starts, skeleton, filters)),
            (TOO_FEW_WORDS, _too_few_words(words, starts, start_time, fps, filters)),
        ):
            verdicts[is_failed] = reason
    return WindowChoice(tuple(starts[verdicts == KEPT].tolist()), tuple(verdicts.tolist()))


def _too_few_words(
    words: Sequence[Word], starts: np.ndarray, start_time: float, fps: float, filters: WindowFilters
) -> np.ndarray:
    if filters.min_words is None:
        return np.zeros(len(starts), bool)
    window_starts, window_ends = start_time + starts / fps, start_time + (starts + filters.num_frames) / fps
    word_starts, word_ends = np.array([word.start for word in words]), np.array([word.end for word in words])
    inside = (word_starts < window_ends[:, None]) & (word_ends > window_starts[:, None])
    return inside.sum(axis=1) < filters.min_words


def _too_near_mean_pose(
    positions: np.ndarray, starts: np.ndarray, skeleton: Skeleton, filters: WindowFilters
) -> np.ndarray:
    if filters.min_pose_distance is None:
        return np.zeros(len(starts), bool)
    distances = np.abs(positions - skeleton.mean_pose).mean(axis=(1, 2))
    return _windows(distances, starts, filters).mean(axis=1) < filters.min_pose_distance


def _too_tilted(positions: np.ndarray, starts: np.ndarray, skeleton: Skeleton, filters: WindowFilters) -> np.ndarray:
    spine = positions[:, skeleton.joint("neck")] - positions[:, skeleton.joint("spine")]
    length = np.maximum(np.linalg.norm(spine, axis=1), np.finfo(np.float32).tiny)
    angles = np.rad2deg(np.arccos(np.clip(spine @ _UPRIGHT / length, -1, 1)))
    in_window = _windows(angles, starts, filters)
    is_failed = np.zeros(len(starts), bool)
    if filters.max_spine_angle is not None:
        is_failed |= in_window.max(axis=1) > filters.max_spine_angle
    if filters.max_mean_spine_angle is not None:
        is_failed |= in_window.mean(axis=1) > filters.max_mean_spine_angle
    return is_failed


def _too_still(positions: np.ndarray, starts: np.ndarray, skeleton: Skeleton, filters: WindowFilters) -> np.ndarray:
    if filters.min_wrist_variance is None:
        return np.zeros(len(starts), bool)
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]].astype(np.float64)
    variances = _windows(wrists, starts, filters).var(axis=1).sum(axis=-1)  # (windows, wrists)
    return (variances < filters.min_wrist_variance).all(axis=1)


def _windows(values: np.ndarray, starts: np.ndarray, filters: WindowFilters) -> np.ndarray:
    """Cut values (T, ...) into windows (windows, num_frames, ...)."""
    return values[starts[:, None] + np.arange(filters.num_frames)]

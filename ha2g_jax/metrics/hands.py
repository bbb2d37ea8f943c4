"""Where and how the hands and the head move: speed, use of one or both hands, spread, distance, repetition.

Neither high nor low values are better: compare each with that of a person for the same speech. The metrics were
calibrated on recordings of two people; a hand counts as moving if its speed is above `MOVING`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.metrics.kinematics import jerk
from ha2g_jax.metrics.metric import HANDS, RECORDING_HANDS, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, mean_over_clips
from ha2g_jax.skeleton import Skeleton

MOVING = 0.15  # m/s
SEGMENT = 2.0  # length in seconds of a segment that is compared with the others


class UpperBody(NamedTuple):
    """Hands, trunk and head of a motion in metres; x points to the person's left, y down and z backward.

    Attributes:
        wrists: (T, 2, 3) positions of the left and the right wrist.
        shoulders: (T, 2, 3) positions of the shoulders.
        trunk: (T, 3) vector from the spine to the neck.
        head: (T, 3) vector from the neck to the nose.
        fps: frames per second.
    """

    wrists: np.ndarray
    shoulders: np.ndarray
    trunk: np.ndarray
    head: np.ndarray
    fps: float

    @property
    def speeds(self) -> np.ndarray:
        """Speeds (T - 1, 2) of the wrists in m/s."""
        return np.linalg.norm(np.diff(self.wrists, axis=0), axis=-1) * self.fps

    def cut(self, start: int, end: int) -> "UpperBody":
        """Return the frames from `start` to `end`."""
        wrists, shoulders, trunk, head, fps = self
        return UpperBody(wrists[start:end], shoulders[start:end], trunk[start:end], head[start:end], fps)


def upper_body(skeleton: Skeleton, positions: np.ndarray, fps: float) -> UpperBody:
    """Take hands, trunk and head from joint positions (T, joints, 3) of a skeleton."""
    positions = np.asarray(positions, np.float64) * (skeleton.left, 1, skeleton.left)
    at = {name: positions[:, skeleton.joint(name)] for name in ("spine", "neck", "nose")}
    wrists, shoulders = (
        positions[:, [skeleton.joint(f"{side}_{joint}") for side in ("left", "right")]]
        for joint in ("wrist", "shoulder")
    )
    return UpperBody(wrists, shoulders, at["neck"] - at["spine"], at["nose"] - at["neck"], fps)


def slower_wrist(body: UpperBody) -> float:
    """Return the mean speed in m/s of the slower wrist."""
    return float(body.speeds.mean(axis=0).min())


def both_moving(body: UpperBody) -> float:
    """Return the fraction of frames in which both hands move."""
    return float((body.speeds > MOVING).all(axis=1).mean())


def one_moving(body: UpperBody) -> float:
    """Return the fraction of frames in which exactly one hand moves."""
    return float(((body.speeds > MOVING).sum(axis=1) == 1).mean())


def lateral_spread(body: UpperBody) -> float:
    """Return the standard deviation in cm of the lateral position of a wrist, the mean over the wrists."""
    return float(100 * body.wrists[..., 0].std(axis=0).mean())


def hand_distances(body: UpperBody) -> np.ndarray:
    """Return the distances (T,) in cm of the wrists from each other."""
    return 100 * np.linalg.norm(body.wrists[:, 0] - body.wrists[:, 1], axis=-1)


def nearest_segment(body: UpperBody) -> float:
    """Return the distance in cm from a segment of 2 s to the most similar other one, the mean over the segments.

    The segments do not overlap; the distance of two is the mean over frames and wrists. It falls with the length of the
    motion: compare motions of equal length. NaN with fewer than two segments.
    """
    length = round(SEGMENT * body.fps)
    count = len(body.wrists) // length
    if count < 2:
        return np.nan
    segments = body.wrists[: count * length].reshape(count, length * 2, 3)
    nearest = []
    for index, segment in enumerate(segments):
        distances = np.linalg.norm(segments - segment, axis=-1).mean(axis=-1)
        nearest.append(np.delete(distances, index).min())
    return float(100 * np.mean(nearest))


def head_deviation(body: UpperBody) -> float:
    """Return the standard deviation in degrees of the direction from neck to nose around its mean."""
    return spread_of_directions(body.head)


def spread_of_directions(vectors: np.ndarray) -> float:
    """Return the root mean square angle in degrees between vectors (T, 3) and their mean direction."""
    units = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
    mean = units.mean(axis=0) / max(np.linalg.norm(units.mean(axis=0)), 1e-9)
    angles = 2 * np.arcsin(np.clip(np.linalg.norm(units - mean, axis=-1) / 2, 0, 1))
    return float(np.degrees(np.sqrt(np.mean(np.square(angles)))))


_MEASURES: tuple[tuple[str, str, str, int, Callable[[UpperBody], float]], ...] = (
    ("slower_wrist", "slower wrist", "m/s", 2, slower_wrist),
    ("both_moving", "both hands moving", "", 2, both_moving),
    ("one_moving", "one hand moving", "", 2, one_moving),
    ("lateral_spread", "lateral sd of wrist", "cm", 1, lateral_spread),
    ("hand_distance", "distance of hands", "cm", 0, lambda body: float(hand_distances(body).mean())),
    ("hand_distance_sd", "sd of the distance", "cm", 1, lambda body: float(hand_distances(body).std())),
    ("nearest_segment", "nearest segment", "cm", 1, nearest_segment),
    ("head_deviation", "head sd", "degrees", 1, head_deviation),
    ("wrist_jerk", "jerk of wrists", "m/s³", 0, lambda body: jerk(body.wrists, body.fps)),
)


def row_bodies(row: Row) -> list[UpperBody]:
    """Return the upper body of each motion of a row, without the seed pose."""
    reference = row.reference
    return [upper_body(reference.skeleton, places[SEED_FRAMES:], reference.fps) for places in row.positions]


def _over_clips(function: Callable[[UpperBody], float]) -> Callable[[Row], Statistic]:
    """Return a measure: the mean over the motions, weighted by frames."""
    return lambda row: mean_over_clips(row, [function(body) for body in row.once(row_bodies)], row.num_scored)


def _of_recording(function: Callable[[UpperBody], float]) -> Callable[[Any], float]:
    """Return a measure of the only motion of a `strokes.RecordingRow`."""
    return lambda row: function(row.body)


HAND_METRICS = tuple(
    Metric(name, title, unit, "none", HANDS, digits, _over_clips(function))
    for name, title, unit, digits, function in _MEASURES
)
RECORDING_HAND_METRICS = tuple(
    Metric(f"recording_{name}", title, unit, "none", RECORDING_HANDS, digits, _of_recording(function), "recording")
    for name, title, unit, digits, function in _MEASURES
)

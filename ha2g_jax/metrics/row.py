"""The input of a metric: the motions of one row of a table with their latents, and the reference of all rows."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ha2g_jax.metrics.metric import Statistic
from ha2g_jax.skeleton import Skeleton, directions_to_positions

SEED_FRAMES = 4  # M of the paper: poses given to the models, so not scored

Value = TypeVar("Value")

FGD_CUT, FGD_SEEDED_CUT = "fgd", "fgd_seeded"


@dataclasses.dataclass(frozen=True, eq=False)
class _Remembers:
    """Base of classes that cache what is computed from them."""

    _found: dict[Callable, Any] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def once(self, function: Callable[[Any], Value]) -> Value:
        """Return function(self), computed only at the first call; the function is at the top level of a module."""
        if function not in self._found:
            self._found[function] = function(self)
        return self._found[function]

    def forget(self) -> None:
        """Drop the cached results, to free memory."""
        self._found.clear()


@dataclasses.dataclass(frozen=True, eq=False)
class Reference(_Remembers):
    """What all rows of a table have in common; the first axis is the clips.

    Attributes:
        directions: true motion (T, bones, 3) of each clip, unit vectors.
        onsets: times of the onsets of the sound of each clip in seconds, None without sound.
        borders: first frames of the windows that the true motion was joined from, mostly none.
        audio: samples of each clip at 16 kHz, None where unknown; the legacy rules need them.
        recordings: (n,) name of the recording that each clip was cut from.
        members: (n,) index of each clip's recording among the sorted recordings.
        training: clips (T, bones, 3) for reference statistics, such as the usual change of an angle.
        encode: function from windows (n, window, bones, 3) to latents (n, d), None without a pose auto-encoder.
        window: number of frames of such a window.
    """

    skeleton: Skeleton
    fps: float
    directions: list[np.ndarray]
    onsets: list[np.ndarray | None]
    borders: list[np.ndarray]
    audio: list[np.ndarray | None]
    recordings: np.ndarray
    members: np.ndarray
    training: Sequence[np.ndarray]
    encode: Callable[[np.ndarray], np.ndarray] | None = None
    window: int = 34
    seed: int = 0

    @property
    def num_recordings(self) -> int:
        """Number of recordings that the clips were cut from."""
        return int(self.members.max()) + 1

    @property
    def truth(self) -> "Row":
        """The row of ground truth."""
        return self.once(_true_row)


@dataclasses.dataclass(frozen=True, eq=False)
class Row(_Remembers):
    """The motions of one row; the first axis is the motions, of which a clip may have several.

    Attributes:
        directions: (T, bones, 3) of each motion, as long as its clip.
        numbers: (n,) index of the clip of each motion.
        onsets: times in seconds of the onsets that each motion is scored with, None without sound.
        borders: first frames of the windows that each motion was joined from.
        has_counterpart: whether the motion should be like the true motion of the clip, whose onsets are then those of
            the reference.
    """

    reference: Reference
    directions: list[np.ndarray]
    numbers: np.ndarray
    onsets: list[np.ndarray | None]
    borders: list[np.ndarray]
    has_counterpart: bool = True

    @property
    def members(self) -> np.ndarray:
        """(n,) index of the recording of each motion."""
        return self.reference.members[self.numbers]

    @property
    def num_scored(self) -> np.ndarray:
        """(n,) number of frames after the seed pose."""
        return np.array([len(directions) - SEED_FRAMES for directions in self.directions], float)

    @property
    def positions(self) -> list[np.ndarray]:
        """Joint positions (T, joints, 3) of each motion, in metres."""
        return self.once(_positions)

    @property
    def true_positions(self) -> list[np.ndarray]:
        """Joint positions of the true motion of each motion's clip."""
        return [self.reference.truth.positions[number] for number in self.numbers]


def mean_over_clips(row: Row, values: Sequence[float] | np.ndarray, weights: np.ndarray | None = None) -> Statistic:
    """Return the weighted mean of the values of a row's motions that are not NaN, for any draw of recordings."""
    return mean_by_recording(values, row.members, row.reference.num_recordings, weights)


def mean_by_recording(
    values: Sequence[float] | np.ndarray, members: np.ndarray, num_recordings: int, weights: np.ndarray | None = None
) -> Statistic:
    """Return the mean of values (n,) that are not NaN, for any draw of the recordings (n,) that they belong to."""
    values = np.asarray(values, np.float64)
    weights = np.where(np.isnan(values), 0.0, 1.0 if weights is None else weights)
    sums = np.bincount(members, weights * np.where(np.isnan(values), 0, values), num_recordings)
    totals = np.bincount(members, weights, num_recordings)
    return ratio_of_sums(sums, totals)


def ratio_of_sums(sums: np.ndarray, totals: np.ndarray) -> Statistic:
    """Return the ratio of two sums over recordings, (recordings,) each, for any draw; NaN where the second is 0."""

    def statistic(counts: np.ndarray) -> float:
        total = counts @ totals
        return float(counts @ sums / total) if total > 0 else np.nan

    return statistic


def ratio(first: Statistic, second: Statistic) -> Statistic:
    """Return one score divided by another of the same draw; NaN where the second is 0."""

    def statistic(counts: np.ndarray) -> float:
        divisor = second(counts)
        return first(counts) / divisor if divisor else np.nan

    return statistic


def _true_row(reference: Reference) -> Row:
    numbers = np.arange(len(reference.directions))
    return Row(reference, reference.directions, numbers, reference.onsets, reference.borders)


def _positions(row: Row) -> list[np.ndarray]:
    skeleton = row.reference.skeleton
    return [directions_to_positions(skeleton, np.asarray(clip, np.float64)) for clip in row.directions]


class Cut(NamedTuple):
    """Windows without overlap from `first_frame` on: `FGD_CUT` without the seed pose, `FGD_SEEDED_CUT` with it."""

    name: str
    first_frame: int
    window: int

    def starts(self, num_frames: int) -> range:
        """Return the first frames of the windows of a clip of `num_frames`."""
        return range(self.first_frame, num_frames - self.window + 1, self.window)


class Latents(NamedTuple):
    """Latents (n, d) of the windows of a row, with the index (n,) of the recording of each window and of its speech, a
    position in a clip, and with the cut that defines where windows begin.
    """

    latents: np.ndarray
    members: np.ndarray
    inputs: np.ndarray
    cut: Cut


def choose_cut(lengths: Sequence[int], window: int) -> Cut | None:
    """Choose how clips of some lengths are cut into windows; None if none is as long as a window.

    Windows leave out the seed pose unless most clips that are as long as a window would then have no window.
    """
    windows = sum(length >= window for length in lengths)
    unseeded = sum(length >= window + SEED_FRAMES for length in lengths)
    if not windows:
        return None
    return Cut(FGD_CUT, SEED_FRAMES, window) if 2 * unseeded >= windows else Cut(FGD_SEEDED_CUT, 0, window)


def reference_cut(reference: Reference) -> Cut | None:
    """Choose how the clips of a table are cut."""
    return choose_cut([len(directions) for directions in reference.directions], reference.window)


def cut_windows(row: Row, cut: Cut) -> np.ndarray | None:
    """Return the windows (n, window, bones, 3) float32 of all clips of a row; None where no clip is as long as one."""
    windows = [
        directions[start : start + cut.window] for directions in row.directions for start in cut.starts(len(directions))
    ]
    return np.stack(windows).astype(np.float32) if windows else None


def places(row: Row, cut: Cut) -> list[tuple[int, int]]:
    """Return clip and first frame of each window of a row."""
    return [
        (int(number), start)
        for directions, number in zip(row.directions, row.numbers, strict=True)
        for start in cut.starts(len(directions))
    ]


def row_latents(row: Row) -> Latents | None:
    """Encode the windows of a row; None without an auto-encoder or a window."""
    reference = row.reference
    if row is not reference.truth and row.directions is reference.directions:  # the speech is mismatched
        return reference.truth.once(row_latents)
    cut = reference.once(reference_cut)
    if reference.encode is None or cut is None:
        return None
    windows, found = cut_windows(row, cut), places(row, cut)
    if windows is None:
        return None
    _, inputs = np.unique(found, axis=0, return_inverse=True)
    members = reference.members[[number for number, _ in found]]
    return Latents(reference.encode(windows), members, inputs, cut)

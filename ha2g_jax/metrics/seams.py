"""Visibility of the borders between the windows that a long motion was joined from.

The jump at a border is the greatest change of the directions over the frames that the border touches. It is compared
with the same measure of stretches inside the windows, which hold the same motion without a border.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.metric import MOVEMENT, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, ratio_of_sums

WIDTH = 6  # frames that a border touches: 4 blended ones, and 2 more that a second difference spans


class SeamScore(NamedTuple):
    """Jumps at borders compared with those inside windows; NaN without a border that has insides.

    Attributes:
        velocity, acceleration: mean jump at borders / mean jump inside; 1 where no border shows.
        velocity_p, acceleration_p: probability of jumps at least as large if borders were like any other frame.
    """

    velocity: float
    acceleration: float
    velocity_p: float
    acceleration_p: float
    borders: int


def seam_score(
    directions: Sequence[np.ndarray],
    borders: Sequence[np.ndarray],
    fps: float,
    *,
    width: int = WIDTH,
    first_frame: int = SEED_FRAMES,
    draws: int = 1000,
    seed: int = 0,
) -> SeamScore:
    """Compare velocity and acceleration jumps at window borders with those inside windows, by a permutation test.

    A border at frame b touches the stretch [b, b + width). Its insides are the nearest stretches before and after it,
    without gap or overlap, up to the middle of the windows and as many on either side, so that a motion that grows
    calmer does not look like a seam. A draw of the test takes for each border either its jump or that of one of its
    insides, all equally likely, and p = (1 + draws whose sum is at least that of the borders) / (1 + draws). The test
    is exact if a border is like the stretches around it. Overlapping stretches would be more numerous but dependent,
    which would make the p-values too small.

    Args:
        directions: unit direction vectors (T, bones, 3) of each clip.
        borders: first frames of the windows of each clip, except the first; frames outside the clip are ignored.
        width: number of frames that a border touches.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        Ratios of the jumps of velocity and of acceleration, and their p-values.
    """
    groups = [
        group
        for clip, frames in zip(directions, borders, strict=True)
        for group in border_groups(stretch_jumps(clip, fps, width, first_frame), np.asarray(frames, int), width)
    ]
    if not groups:
        return SeamScore(np.nan, np.nan, np.nan, np.nan, 0)
    rng = np.random.default_rng(seed)
    observed = np.sum([group[0] for group in groups], axis=0)
    expected = np.sum([group[1:].mean(axis=0) for group in groups], axis=0)
    drawn = sum(group[rng.integers(len(group), size=draws)] for group in groups)
    # A draw may be the borders themselves, summed in another order: equal except for rounding.
    p = (1 + np.sum(drawn >= observed * (1 - 1e-12), axis=0)) / (1 + draws)
    still = np.where(observed > 0, np.inf, 1)
    ratio = np.where(expected > 0, observed / np.where(expected > 0, expected, 1), still)
    return SeamScore(float(ratio[0]), float(ratio[1]), float(p[0]), float(p[1]), len(groups))


def stretch_jumps(directions: np.ndarray, fps: float, width: int = WIDTH, first_frame: int = SEED_FRAMES) -> np.ndarray:
    """Compute the greatest velocity and acceleration of each stretch of `width` frames of directions (T, bones, 3).

    Velocity at t is the mean over bones of |d(t) - d(t-1)| fps, acceleration that of |d(t) - 2 d(t-1) + d(t-2)| fps^2.
    Row t of the result (T, 2) is the stretch [t, t + width), NaN if it uses a frame before `first_frame` or reaches
    past the end.
    """
    directions = np.asarray(directions, np.float64)
    rates = np.full((len(directions), 2), np.nan)
    for column, order in enumerate((1, 2)):
        if len(directions) > first_frame + order:
            steps = np.diff(directions[first_frame:], n=order, axis=0)
            rates[first_frame + order :, column] = np.linalg.norm(steps, axis=-1).mean(axis=1) * fps**order
    if len(rates) < width:
        return np.full_like(rates, np.nan)
    rows = np.lib.stride_tricks.sliding_window_view(rates, width, axis=0).max(axis=-1)
    return np.concatenate([rows, np.full((width - 1, 2), np.nan)])


def border_groups(jumps: np.ndarray, borders: np.ndarray, width: int = WIDTH) -> list[np.ndarray]:
    """Return the jump at each border of a clip, then those of the insides, as many before the border as after it.

    The jumps (T, 2) are those of `stretch_jumps`, the borders (k,) first frames of windows. There is an array (1 +
    insides, 2) for each border that is defined and has insides on both sides.
    """
    defined = np.flatnonzero(np.logical_not(np.isnan(jumps).any(axis=1)))
    if not len(defined):
        return []
    start, end = int(defined[0]), int(defined[-1]) + width
    inner = np.sort(borders[(borders > start) & (borders < end)]).tolist()
    groups = []
    for index, border in enumerate(inner):
        # A window between two borders is divided between both, so that no stretch is in two groups.
        before = border - start if index == 0 else (border - inner[index - 1] - width) // 2
        after = end - border - width if index == len(inner) - 1 else (inner[index + 1] - border - width) // 2
        count = min(before, after) // width
        if count > 0:
            places = [step for step in range(-count, count + 1) if step]
            groups.append(jumps[[border, *(border + step * width for step in places)]])
    return groups


def _sums(row: Row) -> np.ndarray:
    """Return sums (2, 2, recordings) of the jumps at borders and inside, of velocity and of acceleration."""
    sums = np.zeros((2, 2, row.reference.num_recordings))
    for directions, borders, member in zip(row.directions, row.borders, row.members, strict=True):
        if len(borders):
            jumps = stretch_jumps(directions, row.reference.fps)
            for group in border_groups(jumps, borders):
                sums[0, :, member] += group[0]
                sums[1, :, member] += group[1:].mean(axis=0)
    return sums


def _test(row: Row) -> SeamScore:
    return seam_score(row.directions, row.borders, row.reference.fps, seed=row.reference.seed)


def _ratio(kind: int) -> Callable[[Row], Statistic | None]:
    def measure(row: Row) -> Statistic | None:
        borders, insides = row.once(_sums)
        return ratio_of_sums(borders[kind], insides[kind]) if borders.any() or insides.any() else None

    return measure


def _p(name: str) -> Callable[[Row], float | None]:
    def measure(row: Row) -> float | None:
        found = row.once(_test)
        return getattr(found, name) if found.borders else None

    return measure


SEAM_VELOCITY = Metric("seam_velocity", "seam velocity", "", "lower", MOVEMENT, 2, _ratio(0), is_paired=True)
SEAM_VELOCITY_P = Metric("seam_velocity_p", "seam velocity p", "", "none", MOVEMENT, 3, _p("velocity_p"))
SEAM_ACCELERATION = Metric("seam_acceleration", "seam acc.", "", "lower", MOVEMENT, 2, _ratio(1))
SEAM_ACCELERATION_P = Metric("seam_acceleration_p", "seam acc. p", "", "none", MOVEMENT, 3, _p("acceleration_p"))

"""Can it be seen where one window of a long motion ends and the next begins?

The jump at a border is the greatest change of the directions over the frames that the border touches. It is compared
with the same measure of stretches inside the windows, which hold the same motion without a border.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

WIDTH = 6  # frames that a border touches: 4 blended ones, and 2 more for a second difference to leave them


class SeamScore(NamedTuple):
    """Jumps at borders beside those inside windows; NaN without a border that has insides.

    Attributes:
        velocity, acceleration: mean jump at borders / mean jump inside; 1 where no border shows.
        velocity_p, acceleration_p: probability of jumps at borders at least as great if borders were like any frame.
        borders: number of borders that were compared.
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
    first_frame: int = 4,
    draws: int = 1000,
    seed: int = 0,
) -> SeamScore:
    """Velocity and acceleration jumps at window borders against those inside windows, with a permutation test.

    A border at frame b touches the stretch [b, b + width). Its insides are the nearest stretches before and after it,
    without gap or overlap, up to the middle of its windows and as many on either side: a motion that grows calmer does
    not look like a seam. A draw of the test takes of each border one of its jump and those of its insides, all equally
    likely, and p = (1 + draws whose sum is at least that of the borders) / (1 + draws). It is exact where a border is
    like the stretches around it. Stretches that overlap would be more, but alike, and make the test too sure of itself.

    Args:
        directions: clips of (T, bones, 3) unit direction vectors.
        borders: of each clip, the first frames of its windows but the first; frames outside of the clip are no borders.
        fps: frames per second.
        width: frames that a border touches.
        first_frame: frames before it were given to the model and are not scored.
        draws: of the test.
        seed: of the draws.

    Returns:
        Ratios of the jumps, in units a second and a second squared, and their p-values.
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
    # A draw may be the borders themselves, summed in another way: equal but for rounding.
    p = (1 + np.sum(drawn >= observed * (1 - 1e-12), axis=0)) / (1 + draws)
    still = np.where(observed > 0, np.inf, 1)
    ratio = np.where(expected > 0, observed / np.where(expected > 0, expected, 1), still)
    return SeamScore(float(ratio[0]), float(ratio[1]), float(p[0]), float(p[1]), len(groups))


def stretch_jumps(directions: np.ndarray, fps: float, width: int = WIDTH, first_frame: int = 4) -> np.ndarray:
    """Greatest velocity and acceleration of each stretch of `width` frames.

    Velocity at t is the mean over bones of |d(t) - d(t-1)| fps, acceleration that of |d(t) - 2 d(t-1) + d(t-2)| fps^2.

    Args:
        directions: (T, bones, 3).
        fps: frames per second.
        width: frames.
        first_frame: stretches that look at a frame before it are undefined.

    Returns:
        (T, 2), row t the stretch [t, t + width); NaN where it is undefined or reaches past the end.
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
    """Of each border of a clip its jump, then those of its insides, as many before it as after it.

    Args:
        jumps: (T, 2) from `stretch_jumps`.
        borders: (k,) frames.
        width: of the stretches.

    Returns:
        An array (1 + insides, 2) for each border that is defined and has insides on both sides.
    """
    defined = np.flatnonzero(np.logical_not(np.isnan(jumps).any(axis=1)))
    if not len(defined):
        return []
    start, end = int(defined[0]), int(defined[-1]) + width
    inner = np.sort(borders[(borders > start) & (borders < end)]).tolist()
    groups = []
    for index, border in enumerate(inner):
        # A window between two borders is shared out to both, so that no stretch is in two groups.
        before = border - start if index == 0 else (border - inner[index - 1] - width) // 2
        after = end - border - width if index == len(inner) - 1 else (inner[index + 1] - border - width) // 2
        count = min(before, after) // width
        if count > 0:
            places = [step for step in range(-count, count + 1) if step]
            groups.append(jumps[[border, *(border + step * width for step in places)]])
    return groups

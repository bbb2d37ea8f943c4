"""Do the hands stop when the voice strikes? Motion beats, and how they meet strokes or onsets.

Two questions, one detector. Where the strokes that the speech causes are known (the Talk corpus), beats are matched
with them one to one. Where only the sound is known (a recording), onsets of the sound stand in and a Gaussian kernel
scores the distance, both ways; dense random beats are near some onset by chance, so such a score means something only
as the gain over the same motion with mismatched speech.
"""

from typing import NamedTuple

import numpy as np

from ha2g_jax.skeleton import Skeleton, directions_to_positions

TOLERANCE = 0.1  # seconds between a stroke and the motion beat that it is matched with
SIGMA = 0.1  # seconds, width of the kernel between onsets and motion beats
RISE = 0.1  # m/s that the speed of the wrist rises on both sides of a motion beat
SEED_SECONDS = 4 / 15  # given to the model, so never scored


def wrist_speeds(skeleton: Skeleton, directions: np.ndarray, fps: float) -> np.ndarray:
    """Speeds of the left and the right wrist in m/s, (T - 1, 2); entry t lies at time (t + 1/2) / fps."""
    positions = directions_to_positions(skeleton, directions.astype(np.float64))
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]
    return np.linalg.norm(np.diff(wrists, axis=0), axis=-1) * fps


def motion_beats(skeleton: Skeleton, directions: np.ndarray, fps: float, rise: float = RISE) -> np.ndarray:
    """Times in seconds, (n,), at which the hands come to a stop.

    A motion beat is a strict local minimum of the faster wrist's speed, from which the speed rises by at least `rise`
    to the nearest local maximum on both sides; a parabola through the minimum and its neighbours places it between
    frames. Motion that stands still has none.

    Args:
        skeleton: with joints `left_wrist` and `right_wrist`.
        directions: (T, bones, 3) direction vectors.
        fps: frames per second of the motion.
        rise: m/s.
    """
    if len(directions) < 4:
        return np.zeros(0)
    speed = wrist_speeds(skeleton, directions, fps).max(axis=1)
    return (deep_minima(speed, rise) + 0.5) / fps


def deep_minima(curve: np.ndarray, rise: float) -> np.ndarray:
    """Positions, between samples, of strict local minima of `curve` (T,) that rise by `rise` on both sides."""
    lowest = 1 + np.flatnonzero((curve[1:-1] < curve[:-2]) & (curve[1:-1] < curve[2:]))
    steps = np.diff(curve)
    positions = []
    for index in lowest:
        before = steps[:index][::-1] >= 0  # where walking back meets the top
        after = steps[index:] <= 0
        left = curve[index - (np.argmax(before) if before.any() else index)]
        right = curve[index + (np.argmax(after) if after.any() else len(after))]
        if min(left, right) - curve[index] >= rise:
            below, middle, above = curve[index - 1 : index + 2]
            positions.append(index + 0.5 * (below - above) / (below - 2 * middle + above))
    return np.array(positions)


def matched_pairs(first: np.ndarray, second: np.ndarray, tolerance: float = TOLERANCE) -> int:
    """The most one-to-one pairs of two sorted lists of times that lie within `tolerance` of each other."""
    pairs = i = j = 0
    while i < len(first) and j < len(second):
        if abs(first[i] - second[j]) <= tolerance:
            pairs, i, j = pairs + 1, i + 1, j + 1
        elif first[i] < second[j]:
            i += 1
        else:
            j += 1
    return pairs

"""Motion beats of the hands, where the strokes that the speech causes are known, as in the Talk corpus.

A motion beat is the end of a downward stroke of a hand. Beats are matched with the known strokes one to one. Dense
random beats are near some stroke by chance, so a score means something only beside that of the same motion with
mismatched speech.
"""

from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.times import deep_minima
from ha2g_jax.skeleton import Skeleton, directions_to_positions

TOLERANCE = 0.1  # seconds between a stroke and the motion beat that it is matched with
RISE = 0.1  # m/s by which a downward stroke is faster than what is around it
HIT_DELAY = 0.13  # seconds from the fastest moment of a stroke to its end, half a stroke


class Matches(NamedTuple):
    """Counts of one clip, from which recall, precision and F1 of any set of clips follow.

    Attributes:
        strokes: number of true strokes of the kind that is scored.
        met: number of strokes that a motion beat meets, one to one.
        beats: number of motion beats.
        known: number of motion beats that meet a true movement of any kind, one to one.
    """

    strokes: int
    met: int
    beats: int
    known: int


def wrists(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    """Return the positions (T, 2, 3) in metres of the left and right wrist, from direction vectors (T, bones, 3)."""
    positions = directions_to_positions(skeleton, directions.astype(np.float64))
    return positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]


def stroke_beats(positions: np.ndarray, fps: float, rise: float = RISE) -> np.ndarray:
    """Return the times in seconds, (n,), at which a downward stroke of a hand ends.

    The speed v(t + 1/2) = max over wrists of (y(t + 1) - y(t)) fps is downward, y pointing down. A stroke is a strict
    local maximum of v that stands out by at least `rise` from the nearest local minimum on both sides; a parabola
    through the maximum and its neighbours places it between frames, and it ends half a stroke later. Motion that
    stands still has none, and raising the hand, which prepares a stroke, is none.

    Chosen on the Talk corpus, where every stroke is known: the teacher with other noise finds 0.97 of the strokes, and
    0.31 with mismatched speech. Other simple definitions find fewer or do not separate: 0.73 (0.44) the minima of the
    wrists' speed, as a hand also stands still before it strikes; 0.97 (0.50) the maxima of the speed
    in any direction. From 0.05 to 0.3 m/s the order is the same; the rise is small so that small strokes count.

    Args:
        positions: (T, 2, 3) positions of the wrists in metres, y down.
        fps: frames per second of the motion.
        rise: least rise of the speed in m/s.
    """
    if len(positions) < 4:
        return np.zeros(0)
    down = np.diff(positions[..., 1], axis=0).max(axis=1) * fps
    return (deep_minima(-down, rise) + 0.5) / fps + HIT_DELAY


def match(strokes: np.ndarray, causes: np.ndarray, beats: np.ndarray, tolerance: float = TOLERANCE) -> Matches:
    """Count the strokes and motion beats of one clip that meet.

    Args:
        strokes: (n,) ascending times in seconds of the strokes to be found.
        causes: (m,) ascending times in seconds of all true movements that may cause a beat, strokes among them.
        beats: (k,) ascending times in seconds of the motion beats.
        tolerance: greatest distance of a pair in seconds.
    """
    met, known = (matched_pairs(times, beats, tolerance) for times in (strokes, causes))
    return Matches(len(strokes), met, len(beats), known)


def matched_pairs(first: np.ndarray, second: np.ndarray, tolerance: float = TOLERANCE) -> int:
    """Return the greatest number of one-to-one pairs, at most `tolerance` apart, of two ascending lists of times."""
    pairs = i = j = 0
    while i < len(first) and j < len(second):
        if abs(first[i] - second[j]) <= tolerance:
            pairs, i, j = pairs + 1, i + 1, j + 1
        elif first[i] < second[j]:
            i += 1
        else:
            j += 1
    return pairs


def recall(counts: np.ndarray) -> float:
    """Return the ratio of the strokes that a motion beat meets, over rows of `Matches` (n, 4); 0 without strokes."""
    strokes, met, _, _ = np.sum(counts, axis=0)
    return float(met / strokes) if strokes else 0.0


def precision(counts: np.ndarray) -> float:
    """Return the ratio of the motion beats with a true cause, over rows of `Matches` (n, 4); 0 without motion beats."""
    _, _, beats, known = np.sum(counts, axis=0)
    return float(known / beats) if beats else 0.0


def f1(counts: np.ndarray) -> float:
    """Return the harmonic mean of recall and precision over rows of `Matches` (n, 4); 0 for still motion."""
    r, q = recall(counts), precision(counts)
    return 2 * r * q / (r + q) if r + q else 0.0


def strict_f1(counts: np.ndarray) -> float:
    """Return the F1 that counts a motion beat with another cause as wrong, over rows of `Matches` (n, 4)."""
    strokes, met, beats, _ = np.sum(counts, axis=0)
    return float(2 * met / (strokes + beats)) if strokes + beats else 0.0

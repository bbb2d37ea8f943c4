"""Do the hands strike when the voice does? Motion beats, and how they meet strokes or onsets.

Two questions, one detector. Where the strokes that the speech causes are known (the Talk corpus), motion beats are
matched with them one to one. Where only the sound is known (a recording), its onsets stand in and a Gaussian kernel
scores the distances, both ways. Dense random beats are near some stroke or onset by chance, so either score means
something only beside that of the same motion with mismatched speech.
"""

from typing import NamedTuple

import numpy as np

from ha2g_jax.features.librosa_once import librosa
from ha2g_jax.skeleton import Skeleton, directions_to_positions

TOLERANCE = 0.1  # seconds between a stroke and the motion beat that it is matched with
SIGMA = 0.1  # seconds, width of the kernel between onsets and motion beats
RISE = 0.1  # m/s by which a downward stroke is faster than what is around it
HIT_DELAY = 0.13  # seconds from the fastest moment of a stroke to its end, half a stroke
ONSET_RATE = 16000  # samples per second of the sound that onsets are found in


class Matches(NamedTuple):
    """Counts of one clip, from which recall, precision and F1 of any set of clips follow.

    Attributes:
        strokes: true strokes of the kind that is scored.
        met: those that a motion beat meets, one to one.
        beats: motion beats.
        known: those that meet a true movement of any kind, one to one.
    """

    strokes: int
    met: int
    beats: int
    known: int


class Kernels(NamedTuple):
    """Sums of the kernel over one stretch of time, from which the alignment of any set of stretches follows.

    Attributes:
        onsets, beats: how many there are.
        heard: sum over onsets of the kernel to the nearest motion beat.
        meant: sum over motion beats of the kernel to the nearest onset.
    """

    onsets: int
    beats: int
    heard: float
    meant: float


class Minima(NamedTuple):
    """Local minima of a curve.

    Attributes:
        sample: (n,) index of the lowest sample, of the first where two are equal.
        offset: (n,) from there to the lowest point of the parabola through it and its neighbours, -0.5 to 0.5 samples.
        rise: (n,) from the lowest sample to the nearest local maximum, on the side where that is less.
    """

    sample: np.ndarray
    offset: np.ndarray
    rise: np.ndarray


def wrists(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    """Positions (T, 2, 3) in metres of the left and the right wrist, from direction vectors (T, bones, 3)."""
    positions = directions_to_positions(skeleton, directions.astype(np.float64))
    return positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]


def motion_beats(positions: np.ndarray, fps: float, rise: float = RISE) -> np.ndarray:
    """Times in seconds, (n,), at which a downward stroke of a hand hits.

    The speed v(t + 1/2) = max over wrists of (y(t + 1) - y(t)) fps is downward, y pointing down. A stroke is a strict
    local maximum of v that stands out by at least `rise` from the nearest local minimum on both sides; a parabola
    through the maximum and its neighbours places it between frames, and it hits half a stroke later. Motion that
    stands still has none, and raising the hand, which prepares a stroke, is none.

    Chosen on the Talk corpus, where every stroke is known: the teacher that performs again with other noise finds 0.97
    of its strokes, and 0.31 with mismatched speech. Other simple definitions find fewer or cannot tell: 0.73 (0.44) the
    minima of the wrists' speed, as a hand also stands still before it strikes; 0.97 (0.50) the maxima of the speed
    in any direction. From 0.05 to 0.3 m/s the order is the same; the rise is small so that small strokes count.

    Args:
        positions: (T, 2, 3) wrists in metres.
        fps: frames per second of the motion.
        rise: m/s.
    """
    if len(positions) < 4:
        return np.zeros(0)
    down = np.diff(positions[..., 1], axis=0).max(axis=1) * fps
    return (deep_minima(-down, rise) + 0.5) / fps + HIT_DELAY


def deep_minima(curve: np.ndarray, rise: float) -> np.ndarray:
    """Positions, between samples, of strict local minima of `curve` (T,) that rise by `rise` on both sides."""
    found = minima(curve)
    return (found.sample + found.offset)[found.rise >= rise]


def minima(curve: np.ndarray, *, is_first: np.ndarray | None = None, equal: bool = False) -> Minima:
    """Strict local minima of one curve, or of many that lie end to end.

    Args:
        curve: (T,) samples.
        is_first: (T,) marks the first sample of each curve; no minimum is there, at a last sample, or across.
        equal: find two equal lowest samples too, as a minimum halfway.
    """
    is_joint = np.zeros(max(len(curve) - 1, 0), bool) if is_first is None else is_first[1:]
    steps = np.diff(curve)
    falls, rises, stays = (np.zeros(len(curve), bool) for _ in range(3))  # towards a sample, and away from it
    falls[1:], rises[:-1], stays[:-1] = (sign & ~is_joint for sign in (steps < 0, steps > 0, steps == 0))
    is_lowest = falls & rises
    if equal:
        is_lowest[:-1] |= falls[:-1] & stays[:-1] & rises[1:]
    index = np.flatnonzero(is_lowest)
    samples = np.arange(len(curve))
    left = np.maximum.accumulate(np.where(falls, 0, samples))[index]
    right = np.minimum.accumulate(np.where(rises, len(curve), samples)[::-1])[::-1][index + stays[index]]
    before, after = curve[index - 1] - curve[index], curve[index + 1] - curve[index]
    return Minima(
        index, 0.5 * (before - after) / (before + after), np.minimum(curve[left], curve[right]) - curve[index]
    )


def nearest(
    times: np.ndarray, others: np.ndarray, owners: np.ndarray | None = None, other_owners: np.ndarray | None = None
) -> np.ndarray:
    """Seconds (n,) from each time to the nearest of the others, infinite where there is none.

    Args:
        times, others: (n,) and (m,) ascending seconds.
        owners, other_owners: (n,) and (m,) ascending clips that the times belong to; only times of the same clip meet.
            Times then ascend within a clip. All belong to one clip by default.
    """
    if not len(others):
        return np.full(len(times), np.inf)
    if owners is None or other_owners is None:
        owners, other_owners = np.zeros(len(times), int), np.zeros(len(others), int)
    low = min(times.min(initial=0), others.min())
    span = max(times.max(initial=0), others.max()) - low + 1
    after = np.searchsorted(other_owners * span + (others - low), owners * span + (times - low))
    distances = np.full(len(times), np.inf)
    # The rounding of the long axis may pick a neighbour that is a hair farther; distances are taken on the times.
    for neighbour in (np.maximum(after - 1, 0), np.minimum(after, len(others) - 1)):
        candidates = np.where(other_owners[neighbour] == owners, np.abs(others[neighbour] - times), np.inf)
        np.minimum(distances, candidates, out=distances)
    return distances


def kernel(distances: np.ndarray, sigma: float = SIGMA) -> np.ndarray:
    """exp(-d^2 / (2 sigma^2)) of distances in seconds (HA2G, Eq. 11); 0 at infinity."""
    return np.exp(-np.square(distances) / (2 * sigma**2))


def match(strokes: np.ndarray, causes: np.ndarray, beats: np.ndarray, tolerance: float = TOLERANCE) -> Matches:
    """Counts of one clip.

    Args:
        strokes: (n,) ascending times of the strokes to be found.
        causes: (m,) ascending times of all true movements that a motion beat may answer to, the strokes among them.
        beats: (k,) ascending times of the motion beats.
        tolerance: seconds.
    """
    met, known = (matched_pairs(times, beats, tolerance) for times in (strokes, causes))
    return Matches(len(strokes), met, len(beats), known)


def matched_pairs(first: np.ndarray, second: np.ndarray, tolerance: float = TOLERANCE) -> int:
    """The most one-to-one pairs of two ascending lists of times that lie within `tolerance` of each other."""
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
    """Share of the strokes that a motion beat meets, over rows of `Matches` (n, 4); 0 without strokes."""
    strokes, met, _, _ = np.sum(counts, axis=0)
    return float(met / strokes) if strokes else 0.0


def precision(counts: np.ndarray) -> float:
    """Share of the motion beats with a true cause, over rows of `Matches` (n, 4); 0 without motion beats."""
    _, _, beats, known = np.sum(counts, axis=0)
    return float(known / beats) if beats else 0.0


def f1(counts: np.ndarray) -> float:
    """Harmonic mean of recall and precision over rows of `Matches` (n, 4); 0 for motion that stands still."""
    r, q = recall(counts), precision(counts)
    return 2 * r * q / (r + q) if r + q else 0.0


def strict_f1(counts: np.ndarray) -> float:
    """F1 that takes a motion beat with another cause for wrong, over rows of `Matches` (n, 4)."""
    strokes, met, beats, _ = np.sum(counts, axis=0)
    return float(2 * met / (strokes + beats)) if strokes + beats else 0.0


def onsets(audio: np.ndarray) -> np.ndarray:
    """Times in seconds, (n,), of the onsets of samples at 16 kHz: librosa's detector with its defaults."""
    return librosa().onset.onset_detect(y=audio, sr=ONSET_RATE, units="time")


def kernels(
    onset_times: np.ndarray, beats: np.ndarray, start: float = -np.inf, end: float = np.inf, sigma: float = SIGMA
) -> Kernels:
    """The kernel exp(-d^2 / (2 sigma^2)) of the distance d to the nearest on the other side, summed from start to end.

    Args:
        onset_times, beats: (n,) and (m,) seconds; the nearest may lie outside of start and end.
        start, end: seconds.
        sigma: seconds.
    """
    onset_times, beats = np.sort(onset_times), np.sort(beats)
    counts, sums = [], []
    for times, others in ((onset_times, beats), (beats, onset_times)):
        is_inside = (times >= start) & (times < end)
        counts.append(int(is_inside.sum()))
        sums.append(float(kernel(nearest(times, others), sigma)[is_inside].sum()))
    return Kernels(*counts, *sums)


def alignment(sums: np.ndarray) -> float:
    """Beat alignment F = 2 R Q / (R + Q) over rows of `Kernels` (n, 4).

    R is the mean kernel of the onsets and Q that of the motion beats. Onsets without motion beats score 0.
    """
    num_onsets, num_beats, heard, meant = np.sum(sums, axis=0)
    if not heard or not meant:
        return 0.0
    r, q = heard / num_onsets, meant / num_beats
    return float(2 * r * q / (r + q))

"""Motion beats of the hands, the ends of downward strokes, compared with known strokes or onsets of a recording.

Where the strokes that speech causes are known, as in the Talk corpus, beats are matched with them one to one. In a
recording neither strokes nor true motion are known: its onsets are compared with the beats, in both directions, by a
Gaussian kernel of the distances. Dense random beats are near something by chance, so a score is meaningful only next to
that of the same motion with mismatched speech, or with the sound rotated in time.
"""

import itertools
import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.metrics.beats.alignment import harmonic_mean
from ha2g_jax.metrics.beats.times import (
    audio_onsets,
    cut_pauses,
    deep_minima,
    kernel,
    nearest,
    speech_spans,
)
from ha2g_jax.metrics.hands import UpperBody
from ha2g_jax.metrics.metric import RECORDING, Direction, Metric, Score
from ha2g_jax.metrics.uncertainty import Estimate, jackknife
from ha2g_jax.skeleton import Skeleton, directions_to_positions

TOLERANCE = 0.1  # seconds between a stroke and the motion beat that it is matched with
RISE = 0.1  # m/s by which a downward stroke is faster than the motion around it
HIT_DELAY = 0.13  # seconds from the fastest moment of a stroke to its end, half a stroke

SEGMENT = 5.0  # seconds of a segment of the recording, for the standard error
SHIFT = 2.0  # seconds between the shifts that make the chance level; the first is twice that


class Matches(NamedTuple):
    """Counts of one clip: true strokes, those matched one to one, motion beats, and beats that match any movement."""

    strokes: int
    met: int
    beats: int
    known: int


def wrist_positions(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    """Return the positions (T, 2, 3) in metres of the left and right wrist, from direction vectors (T, bones, 3)."""
    positions = directions_to_positions(skeleton, directions.astype(np.float64))
    return positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]]


def stroke_beats(positions: np.ndarray, fps: float) -> np.ndarray:
    """Return the times in seconds, (n,), at which a downward stroke of a hand ends.

    The speed v(t + 1/2) = max over wrists of (y(t + 1) - y(t)) fps is downward, y pointing down. A stroke is a strict
    local maximum of v that stands out by at least `RISE` from the nearest local minimum on both sides; a parabola
    through the maximum and its neighbours places it between frames, and it ends half a stroke later. Motion that
    stands still has none, and raising the hand, which prepares a stroke, does not count.

    Chosen on the Talk corpus, where every stroke is known: the teacher with other noise finds 0.97 of the strokes, and
    0.31 with mismatched speech. Other simple definitions find fewer or do not separate: 0.73 (0.44) the minima of the
    wrists' speed, as a hand also stands still before it strikes; 0.97 (0.50) the maxima of the speed
    in any direction. From 0.05 to 0.3 m/s the order is the same; `RISE` is small so that small strokes count.

    Args:
        positions: (T, 2, 3) positions of the wrists in metres, y down.
    """
    if len(positions) < 4:
        return np.zeros(0)
    down = np.diff(positions[..., 1], axis=0).max(axis=1) * fps
    return (deep_minima(-down, RISE) + 0.5) / fps + HIT_DELAY


def match(strokes: np.ndarray, causes: np.ndarray, beats: np.ndarray, tolerance: float = TOLERANCE) -> Matches:
    """Count the strokes and motion beats of one clip that match, at most `tolerance` seconds apart.

    All times ascend, in seconds; the causes are all true movements that may cause a beat, strokes among them.
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
    """Return the fraction of the strokes that a motion beat matches, over rows of `Matches` (n, 4); 0 without any."""
    strokes, met, _, _ = np.sum(counts, axis=0)
    return float(met / strokes) if strokes else 0.0


def precision(counts: np.ndarray) -> float:
    """Return the fraction of the motion beats with a true cause, over rows of `Matches` (n, 4); 0 without any."""
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


class Kernels(NamedTuple):
    """Sums of the kernel over one stretch of time, from which the alignment of any set of stretches is computed:
    numbers of onsets and of motion beats, and the kernel's sums from each onset to the nearest beat and vice versa.
    """

    onsets: int
    beats: int
    onset_sum: float
    beat_sum: float


def kernels(onset_times: np.ndarray, beats: np.ndarray, start: float = -np.inf, end: float = np.inf) -> Kernels:
    """Sum the kernel exp(-d^2 / (2 sigma^2)) of the distance d to the nearest on the other side, from start to end.

    The times (n,) and (m,) and the bounds are in seconds; the nearest may lie outside of start and end.
    """
    onset_times, beats = np.sort(onset_times), np.sort(beats)
    counts, sums = [], []
    for times, others in ((onset_times, beats), (beats, onset_times)):
        is_inside = (times >= start) & (times < end)
        counts.append(int(is_inside.sum()))
        sums.append(float(kernel(nearest(times, others))[is_inside].sum()))
    return Kernels(*counts, *sums)


def kernel_f(sums: np.ndarray) -> float:
    """Return the beat alignment F = 2 R Q / (R + Q) over rows of `Kernels` (n, 4).

    R is the mean kernel of the onsets and Q that of the motion beats. Onsets without motion beats score 0.
    """
    num_onsets, num_beats, onset_sum, beat_sum = np.sum(sums, axis=0)
    return float(harmonic_mean(onset_sum / max(num_onsets, 1), beat_sum / max(num_beats, 1)))


class RecordingRow(NamedTuple):
    """Sums for one motion and one recording.

    Attributes:
        sums: (segments, 1 + shifts, 4) `Kernels` of each segment, with the sound and with each shift of it; no segments
            without an onset.
        speech_sums: the same where the pauses are cut out of sound and motion before the sound is shifted.
        perfect_sums: `speech_sums` of strokes that are moved to the nearest onset.
        seconds: length of the compared part.
        body: hands, trunk and head of the motion.
    """

    sums: np.ndarray
    speech_sums: np.ndarray
    perfect_sums: np.ndarray
    num_onsets: int
    num_beats: int
    seconds: float
    body: UpperBody


def recording_row(audio: np.ndarray, body: UpperBody, first_frame: int) -> RecordingRow:
    """Compare the strokes of the hands with the onsets of a recording (samples,) at 16 kHz and of its shifts.

    The mismatched sound is the recording itself, rotated in time by 4, 6, 8, ... seconds: the rhythm is the same, the
    onsets are elsewhere. Motion that merely rests in the pauses has a gain over this; with the pauses cut out it has
    none. The gain of the same strokes, moved to the nearest onsets, is about the most that so many strokes can have.
    Scoring starts at `first_frame`.
    """
    start, end = first_frame / body.fps, min(len(audio) / SAMPLE_RATE, len(body.wrists) / body.fps)
    audio = audio[: math.ceil(end * SAMPLE_RATE)]
    times = (audio_onsets(audio, end), stroke_beats(body.wrists, body.fps))
    onsets, moves = (x[(x >= start) & (x < end)] - start for x in times)
    spans = np.clip(speech_spans(audio) - start, 0, end - start)
    speech, spoken = cut_pauses(onsets, spans), cut_pauses(moves, spans)
    length = float(np.sum(spans[:, 1] - spans[:, 0]))
    return RecordingRow(
        _shifted_sums(onsets, moves, end - start),
        _shifted_sums(speech, spoken, length),
        _shifted_sums(speech, moved_to_onsets(spoken, speech), length),
        len(onsets),
        len(moves),
        end - start,
        body.cut(first_frame, round(end * body.fps)),
    )


def moved_to_onsets(strokes: np.ndarray, onsets: np.ndarray) -> np.ndarray:
    """Return the onsets (k,) that are nearest to the strokes (m,), each once, all in seconds: perfect timing."""
    if not len(onsets):
        return onsets
    after = np.minimum(np.searchsorted(onsets, strokes), len(onsets) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(strokes - onsets[before]) <= np.abs(onsets[after] - strokes)
    return onsets[np.unique(np.where(is_before, before, after))]


def _shifted_sums(onsets: np.ndarray, moves: np.ndarray, length: float) -> np.ndarray:
    """Return the sums (segments, 1 + shifts, 4) of times in seconds from 0 to a length; no segments without onsets."""
    shifts = np.arange(2 * SHIFT, length - 2 * SHIFT, SHIFT)
    sounds = [onsets, *(np.sort((onsets + shift) % length) for shift in shifts)]
    edges = np.linspace(0, length, max(1, round(length / SEGMENT)) + 1)
    sums = np.array([[kernels(x, moves, *edge) for x in sounds] for edge in itertools.pairwise(edges)])
    return sums if len(onsets) else sums[:0]


def _own(sums: np.ndarray) -> float:
    return kernel_f(sums[:, 0])


def _mismatched(sums: np.ndarray) -> float:
    if sums.shape[1] < 2:
        return float("nan")
    return float(np.mean([kernel_f(sums[:, shift]) for shift in range(1, sums.shape[1])]))


def _gain(sums: np.ndarray) -> float:
    return _own(sums) - _mismatched(sums)


def _by_segment(
    statistic: Callable[[np.ndarray], float], sums: Literal["sums", "speech_sums", "perfect_sums"] = "sums"
) -> Callable[[RecordingRow], Estimate]:
    """Return a measure whose standard error is estimated over segments of 5 seconds."""

    def measure(row: RecordingRow) -> Estimate:
        values: np.ndarray = getattr(row, sums)
        return jackknife(values, statistic, np.arange(len(values)))

    return measure


def _metric(
    name: str, title: str, direction: Direction, digits: int, measure: Callable[[RecordingRow], Score], unit: str = ""
) -> Metric:
    return Metric(f"recording_{name}", title, unit, direction, RECORDING, digits, measure, "recording")


RECORDING_METRICS = (
    _metric("gain", "gain", "higher", 3, _by_segment(_gain)),
    _metric("speech_gain", "gain, pauses cut", "higher", 3, _by_segment(_gain, "speech_sums")),
    _metric("perfect_gain", "with perfect timing", "none", 3, _by_segment(_gain, "perfect_sums")),
    _metric("f", "F", "higher", 3, _by_segment(_own)),
    _metric("f_mismatched", "F mismatched", "none", 3, _by_segment(_mismatched)),
    _metric("onsets_per_second", "onsets", "none", 2, lambda row: row.num_onsets / row.seconds, "/s"),
    _metric("strokes_per_second", "strokes", "none", 2, lambda row: row.num_beats / row.seconds, "/s"),
)

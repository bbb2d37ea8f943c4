"""Beat alignment of one motion with one recording, where neither strokes nor true motion are known.

The onsets of the sound are compared with the downward strokes of the hands, in both directions, by a Gaussian kernel of
the distances. The chance level is the same motion with the sound rotated in time.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.alignment import harmonic_mean
from ha2g_jax.metrics.beats.onsets import ONSET_RATE, audio_onsets
from ha2g_jax.metrics.beats.strokes import stroke_beats
from ha2g_jax.metrics.beats.times import SIGMA, kernel, nearest
from ha2g_jax.metrics.jackknife import Estimate, jackknife
from ha2g_jax.metrics.metric import RECORDING, Direction, Metric, Score

SEGMENT = 5.0  # seconds of a segment of the recording, for the standard error
SHIFT = 2.0  # seconds between the shifts that make the chance level; the first is twice that


class Kernels(NamedTuple):
    """Sums of the kernel over one stretch of time, from which the alignment of any set of stretches follows.

    Attributes:
        onsets, beats: numbers of onsets and of motion beats.
        onset_sum: sum over onsets of the kernel to the nearest motion beat.
        beat_sum: sum over motion beats of the kernel to the nearest onset.
    """

    onsets: int
    beats: int
    onset_sum: float
    beat_sum: float


def kernels(
    onset_times: np.ndarray, beats: np.ndarray, start: float = -np.inf, end: float = np.inf, sigma: float = SIGMA
) -> Kernels:
    """Sum the kernel exp(-d^2 / (2 sigma^2)) of the distance d to the nearest on the other side, from start to end.

    Args:
        onset_times, beats: (n,) and (m,) times in seconds; the nearest may lie outside of start and end.
        start, end: bounds in seconds.
        sigma: width of the kernel in seconds.
    """
    onset_times, beats = np.sort(onset_times), np.sort(beats)
    counts, sums = [], []
    for times, others in ((onset_times, beats), (beats, onset_times)):
        is_inside = (times >= start) & (times < end)
        counts.append(int(is_inside.sum()))
        sums.append(float(kernel(nearest(times, others), sigma)[is_inside].sum()))
    return Kernels(*counts, *sums)


def kernel_f(sums: np.ndarray) -> float:
    """Return the beat alignment F = 2 R Q / (R + Q) over rows of `Kernels` (n, 4).

    R is the mean kernel of the onsets and Q that of the motion beats. Onsets without motion beats score 0.
    """
    num_onsets, num_beats, onset_sum, beat_sum = np.sum(sums, axis=0)
    return float(harmonic_mean(onset_sum / max(num_onsets, 1), beat_sum / max(num_beats, 1)))


class RecordingRow(NamedTuple):
    """What is compared in one motion for one recording.

    Attributes:
        sums: (segments, 1 + shifts, 4) rows of `Kernels` of each segment, with the sound and with each shift of it; no
            segment where there is no onset.
        num_onsets, num_beats: numbers of onsets and of motion beats.
        seconds: length of what is scored.
    """

    sums: np.ndarray
    num_onsets: int
    num_beats: int
    seconds: float


def recording_row(audio: np.ndarray, wrists: np.ndarray, fps: float, first_frame: int = 4) -> RecordingRow:
    """Compare the strokes of the hands with the onsets of a recording and of its shifts.

    The mismatched sound is the recording itself, rotated in time by 4, 6, 8, ... seconds: the rhythm is the same, the
    onsets are elsewhere.

    Args:
        audio: (samples,) sound at 16 kHz.
        wrists: (T, 2, 3) positions of the wrists in metres, y down.
        fps: frames per second.
        first_frame: first frame that is scored.
    """
    start, end = first_frame / fps, min(len(audio) / ONSET_RATE, len(wrists) / fps)
    onsets, moves = (x[(x >= start) & (x < end)] for x in (audio_onsets(audio, end), stroke_beats(wrists, fps)))
    length = end - start
    shifts = np.arange(2 * SHIFT, length - 2 * SHIFT, SHIFT)
    sounds = [onsets, *(np.sort((onsets - start + shift) % length + start) for shift in shifts)]
    edges = np.linspace(start, end, max(1, round(length / SEGMENT)) + 1)
    sums = np.array([[kernels(x, moves, *edge) for x in sounds] for edge in itertools.pairwise(edges)])
    return RecordingRow(sums if len(onsets) else sums[:0], len(onsets), len(moves), length)


def _own(sums: np.ndarray) -> float:
    return kernel_f(sums[:, 0])


def _mismatched(sums: np.ndarray) -> float:
    if sums.shape[1] < 2:
        return float("nan")
    return float(np.mean([kernel_f(sums[:, shift]) for shift in range(1, sums.shape[1])]))


def _by_segment(statistic: Callable[[np.ndarray], float]) -> Callable[[RecordingRow], Estimate]:
    """Return a measure whose standard error is by segments of 5 seconds."""
    return lambda row: jackknife(row.sums, statistic, np.arange(len(row.sums)))


def _metric(
    name: str, title: str, direction: Direction, digits: int, measure: Callable[[RecordingRow], Score], unit: str = ""
) -> Metric:
    return Metric(f"recording_{name}", title, unit, direction, RECORDING, digits, measure, "recording")


RECORDING_METRICS = (
    _metric("gain", "gain", "higher", 3, _by_segment(lambda sums: _own(sums) - _mismatched(sums))),
    _metric("f", "F", "higher", 3, _by_segment(_own)),
    _metric("f_mismatched", "F mismatched", "none", 3, _by_segment(_mismatched)),
    _metric("onsets_per_second", "onsets", "none", 2, lambda row: row.num_onsets / row.seconds, "/s"),
    _metric("strokes_per_second", "strokes", "none", 2, lambda row: row.num_beats / row.seconds, "/s"),
)

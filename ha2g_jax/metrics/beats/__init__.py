"""Beats of a motion and onsets of speech: detectors, alignment, chance levels, and the registered beat metrics.

Three definitions of a motion beat have their place: `stop_beats` (minima of the angle change rate, HA2G) for any
motion, `stroke_beats` (downward strokes of the hands) where the strokes that speech causes are known, and the rests of
`rests` (the BEAT data sets). `legacy_bc` has the rules of the public release.
"""

from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.alignment import Alignment, align
from ha2g_jax.metrics.beats.angle_change import (
    CHANGE_FPS,
    angle_change_rate,
    angle_change_rates,
    mean_angle_change,
)
from ha2g_jax.metrics.beats.consistency import beat_consistency, consistency
from ha2g_jax.metrics.beats.legacy import VARIANTS, legacy_bc, legacy_motion_beats
from ha2g_jax.metrics.beats.metrics import BEAT_METRICS, NUM_MISMATCHES, clip_counts
from ha2g_jax.metrics.beats.mismatched import mismatched, partners, with_partners
from ha2g_jax.metrics.beats.onsets import SILENCE_DB, audio_onsets, detect_onsets
from ha2g_jax.metrics.beats.recording import (
    RECORDING_METRICS,
    SEGMENT,
    RecordingRow,
    kernel_f,
    kernels,
    recording_row,
)
from ha2g_jax.metrics.beats.stops import FIRST_FRAME, THRESHOLD, Clip, make_clips, stop_beats
from ha2g_jax.metrics.beats.strokes import (
    TOLERANCE,
    Matches,
    f1,
    match,
    matched_pairs,
    precision,
    recall,
    strict_f1,
    stroke_beats,
    wrists,
)
from ha2g_jax.metrics.beats.summary import THRESHOLDS, Summary, Sweep, summary, sweep
from ha2g_jax.metrics.beats.times import SIGMA, Minima, deep_minima, kernel, minima, nearest

__all__ = [
    "BEAT_METRICS",
    "CHANGE_FPS",
    "FIRST_FRAME",
    "NUM_MISMATCHES",
    "RECORDING_METRICS",
    "SEGMENT",
    "SIGMA",
    "SILENCE_DB",
    "THRESHOLD",
    "THRESHOLDS",
    "TOLERANCE",
    "VARIANTS",
    "Alignment",
    "Clip",
    "Matches",
    "Minima",
    "RecordingRow",
    "Summary",
    "Sweep",
    "align",
    "angle_change_rate",
    "angle_change_rates",
    "audio_onsets",
    "beat_consistency",
    "clip_counts",
    "consistency",
    "deep_minima",
    "detect_onsets",
    "f1",
    "kernel",
    "kernel_f",
    "kernels",
    "legacy_bc",
    "legacy_motion_beats",
    "make_clips",
    "match",
    "matched_pairs",
    "mean_angle_change",
    "minima",
    "mismatched",
    "nearest",
    "partners",
    "precision",
    "recall",
    "recording_row",
    "rests",
    "stop_beats",
    "strict_f1",
    "stroke_beats",
    "summary",
    "sweep",
    "with_partners",
    "wrists",
]

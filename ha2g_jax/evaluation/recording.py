"""Scores of the motion that a model makes for recorded speech, where neither strokes nor true motion are known."""

from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.evaluate import measure
from ha2g_jax.evaluation.generation import model_windows
from ha2g_jax.evaluation.intervals import LEVEL, score_as_json
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.metrics.beats import strokes
from ha2g_jax.synthesis import Model, Style

MIN_SECONDS = 10.0  # of a recording


def score_recording(
    model: Model, audio: np.ndarray, name: str, *, speaker: str | None = None, seed: int = 0
) -> dict[str, Any]:
    """Score the strokes of the hands in the motion that a model makes for a recording.

    Args:
        model: model that makes the motion.
        audio: (samples,) speech at 16 kHz.
        name: name of the recording, for messages.
        speaker: speaker of the model for the style; drawn with `seed` by default.
        seed: seed of the style and the start pose.

    Returns:
        One section of results, as those of `evaluate`, without "rows" that need true motion: the scores are in
        "recording", {"rows": {"model": {metric: {"value", "low", "high", "error"}}}}.

    Raises:
        UserError: the speaker is unknown, or there are less than 10 s of speech.
    """
    if len(audio) < MIN_SECONDS * SAMPLE_RATE:
        raise UserError(f"{name} has {len(audio) / SAMPLE_RATE:.1f} s of sound; expected at least {MIN_SECONDS:g} s")
    motion = model.generate(audio, style=Style(speaker=speaker, variation=0), seed=seed)
    first_frame, skeleton = model_windows(model).seed_frames, model.spec.skeleton
    wrists = strokes.wrist_positions(skeleton, motion.directions)
    row = strokes.recording_row(audio, wrists, motion.fps, first_frame)
    return {
        "methods": ["model"],
        "rows": {},
        "differences": {},
        "counts": {},
        "data": {
            "clips": 1,
            "recordings": 1,
            "seconds": round(row.seconds, 2),
            "windows": None,
            "skeleton": skeleton.name,
            "fps": motion.fps,
        },
        "settings": {"first_frame": first_frame, "seed": seed, "draws": 0, "level": LEVEL},
        "autoencoder": None,
        "flags": [],
        "warnings": [],
        "notes": [],
        "recording": {
            "rows": {"model": {key: score_as_json(score) for key, score in measure(row, "recording").items()}},
            "notes": [
                "the mismatched speech is the recording rotated in time; intervals are 1.96 standard errors by "
                f"segments of {strokes.SEGMENT:g} s",
            ],
        },
    }

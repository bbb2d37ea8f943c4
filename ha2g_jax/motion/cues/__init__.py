"""Gestures on demand: their catalogue, and blending into a motion; `cues.reading` reads cues from files."""

from ha2g_jax.motion.cues.catalogue import NAMES, describe_catalogue, keyframes
from ha2g_jax.motion.cues.cue import Cue, check_cue, check_name, describe, keyframes_of, place
from ha2g_jax.motion.cues.running import MAX_SPEED, MOST, RunningCues, apply

__all__ = [
    "MAX_SPEED",
    "MOST",
    "NAMES",
    "Cue",
    "RunningCues",
    "apply",
    "check_cue",
    "check_name",
    "describe",
    "describe_catalogue",
    "keyframes",
    "keyframes_of",
    "place",
]

"""Control of a finished motion: how much, how large, with which hand, and what it does at a time.

All functions are pure: direction vectors (T, bones, 3) in, others out, with neutral settings the same bytes.
"""

from ha2g_jax.motion.control.controls import NEUTRAL, Controls, apply, check, describe
from ha2g_jax.motion.control.effects import energy, extent, handedness, mirror, mute, pin
from ha2g_jax.motion.control.parts import rest_pose
from ha2g_jax.motion.control.requests import read_mute, read_pin
from ha2g_jax.motion.control.spans import EASE, Pin, Span

__all__ = [
    "EASE",
    "NEUTRAL",
    "Controls",
    "Pin",
    "Span",
    "apply",
    "check",
    "describe",
    "energy",
    "extent",
    "handedness",
    "mirror",
    "mute",
    "pin",
    "read_mute",
    "read_pin",
    "rest_pose",
]

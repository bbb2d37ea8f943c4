"""Pure functions that control direction vectors (T, bones, 3): energy, extent, the hand that gestures, and pins."""

from ha2g_jax.motion.control.controls import NEUTRAL, Controls, Pin, Span, check, describe, read_mute, read_pin
from ha2g_jax.motion.control.effects import apply, change, hold
from ha2g_jax.motion.control.parts import rest_pose

__all__ = [
    "NEUTRAL",
    "Controls",
    "Pin",
    "Span",
    "apply",
    "change",
    "check",
    "describe",
    "hold",
    "read_mute",
    "read_pin",
    "rest_pose",
]

"""Control of a generated motion: its energy, its extent, the hand that gestures, and its poses at given times.

All functions are pure: they take direction vectors (T, bones, 3) and return others. With neutral settings they return
their input.
"""

from ha2g_jax.motion.control.controls import NEUTRAL, Controls, Pin, Span, check, describe, read_mute, read_pin
from ha2g_jax.motion.control.effects import apply
from ha2g_jax.motion.control.parts import rest_pose

__all__ = ["NEUTRAL", "Controls", "Pin", "Span", "apply", "check", "describe", "read_mute", "read_pin", "rest_pose"]

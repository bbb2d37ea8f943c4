"""Parsing of pins and mutes from text."""

import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, reading, shown
from ha2g_jax.motion.control.spans import Pin, Span
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import sample

_EXPECTED = "a motion of `ha2g generate`"


def read_pin(text: str) -> Pin:
    """Parse a pin from START:END:POSE.

    Args:
        text: start and end in seconds; POSE is "rest", MOTION.npz for the first pose of a motion, or
            MOTION.npz@SECONDS for a pose at another time.

    Returns:
        The pin.

    Raises:
        UserError: the text has another form, or there is no such motion.
    """
    start, end, pose = _split(text, 3, "START:END:POSE, such as 2:3.5:wave.npz@1.2 or 2:3.5:rest")
    moments = _seconds(start, text), _seconds(end, text)
    if pose == "rest":
        return Pin(*moments)
    path, moment = pathlib.Path(pose), 0.0
    with reading(pose, _EXPECTED):
        if not path.is_file() and "@" in pose:
            name, _, at = pose.rpartition("@")
            path, moment = pathlib.Path(name), _seconds(at, text)
        exists = path.exists()
    if exists:
        check_regular(path, _EXPECTED)
    motion = Motion.load(path)
    last = (motion.num_frames - 1) / motion.fps
    if not 0 <= moment <= last:
        raise UserError(f"{shown(path)} has no pose at {moment:g} s; expected 0 to {last:.3f}")
    (posed,) = sample(motion.directions, np.array([moment * motion.fps]))
    return Pin(*moments, posed, f"{shown(path.name)}@{moment:g}", motion.meta["skeleton"])


def read_mute(text: str) -> Span:
    """Parse a span from START:END.

    Args:
        text: start and end in seconds.

    Returns:
        The span.

    Raises:
        UserError: the text has another form.
    """
    start, end = _split(text, 2, "START:END in seconds, such as 2:3.5")
    return Span(_seconds(start, text), _seconds(end, text))


def _split(text: str, count: int, expected: str) -> list[str]:
    parts = text.split(":", count - 1)
    if len(parts) != count or not all(parts):
        raise UserError(f"{shown(text)!r} has another form; expected {expected}")
    return parts


def _seconds(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{shown(text)!r} in {shown(whole)!r} is not a time; give seconds") from error

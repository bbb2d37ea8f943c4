"""Spans of time in which a motion holds a pose, and the transitions before and after them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.motion.smoothing import minimum_jerk

EASE = 0.5  # seconds of the transition from the motion to a pose, and of the transition back


class Pin(NamedTuple):
    """A pose that the motion holds from `start` to `end`, or passes through where the two are equal.

    Attributes:
        start: start in seconds.
        end: end in seconds.
        pose: (bones, 3) unit vectors; None for the rest pose.
        name: name of the pose for the record of the controls.
        skeleton: name of the skeleton of the pose, "" where it is not known.
    """

    start: float
    end: float
    pose: np.ndarray | None = None
    name: str = "rest"
    skeleton: str = ""


class Span(NamedTuple):
    """A span of time.

    Attributes:
        start: start in seconds.
        end: end in seconds.
    """

    start: float
    end: float


def motion_weight(span: Pin | Span, others: Sequence[Pin | Span], frames: int, fps: float) -> np.ndarray:
    """Compute the weight of the motion around a span: 0 within the span, 1 at least `EASE` seconds away from it.

    Start and end are rounded to the nearest frames. The weight follows a minimum-jerk curve in the transitions. A
    transition is not longer than the gap to the next span.

    Args:
        span: span in which the pose is held.
        others: other spans of the motion.
        frames: number of frames T.
        fps: frames per second.

    Returns:
        (T,) weights from 0 to 1.
    """
    first, last = (round(moment * fps) for moment in (span.start, span.end))
    gaps_before = [first - round(other.end * fps) for other in others if other.end <= span.start]
    gaps_after = [round(other.start * fps) - last for other in others if other.start >= span.end]
    eases = [max(1.0, min([EASE * fps, *gaps])) for gaps in (gaps_before, gaps_after)]
    frame = np.arange(frames)
    away = np.maximum(np.maximum((first - frame) / eases[0], (frame - last) / eases[1]), 0)
    return minimum_jerk(np.minimum(away, 1))

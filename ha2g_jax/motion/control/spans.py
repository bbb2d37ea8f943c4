"""Spans of time in which a motion is held in a pose, and how it gets there and back."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.motion.smoothing import minimum_jerk

EASE = 0.5  # seconds in which a motion leaves its way for a pose, and in which it returns


class Pin(NamedTuple):
    """A pose that the motion holds; it passes through it where `end` is `start`.

    Attributes:
        start, end: seconds.
        pose: (bones, 3) unit vectors; None for the rest pose.
        name: of the pose, for the record.
        skeleton: name of the pose's skeleton, "" where it is not known.
    """

    start: float
    end: float
    pose: np.ndarray | None = None
    name: str = "rest"
    skeleton: str = ""


class Span(NamedTuple):
    """From `start` to `end`, seconds."""

    start: float
    end: float


def own_share(span: Pin | Span, others: Sequence[Pin | Span], frames: int, fps: float) -> np.ndarray:
    """Share (T,) that the motion keeps of its own: 0 within the span, 1 from `EASE` seconds away on.

    Start and end are taken at the nearest frames. Between them the share is minimum-jerk, so the motion leaves and
    returns without a jolt. Where another span is nearer than that, the gap between them is what the motion has.
    """
    first, last = (round(moment * fps) for moment in (span.start, span.end))
    gaps_before = [first - round(other.end * fps) for other in others if other.end <= span.start]
    gaps_after = [round(other.start * fps) - last for other in others if other.start >= span.end]
    eases = [max(1.0, min([EASE * fps, *gaps])) for gaps in (gaps_before, gaps_after)]
    frame = np.arange(frames)
    away = np.maximum(np.maximum((first - frame) / eases[0], (frame - last) / eases[1]), 0)
    return minimum_jerk(np.minimum(away, 1))

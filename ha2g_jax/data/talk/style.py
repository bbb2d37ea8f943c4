"""The style of a speaker: six numbers that change how, never when or why, the speaker moves."""

from typing import NamedTuple

import numpy as np


class Style(NamedTuple):
    """Six numbers in [-1, 1]; 0 is the middle of the population.

    Attributes:
        mixing: share of the three causes; high is more beats, low is larger word gestures and head movement.
        amplitude: size of all movement.
        handedness: which hand does more, -1 left, 1 right.
        latency: how late the gestures come after the speech.
        elbow: elbow swivel and rest pose, -1 close to the body and low, 1 wide and high.
        curl: finger curl at rest.
    """

    mixing: float = 0.0
    amplitude: float = 0.0
    handedness: float = 0.0
    latency: float = 0.0
    elbow: float = 0.0
    curl: float = 0.0


def sample_style(rng: np.random.Generator) -> Style:
    """A style drawn uniformly from the cube, but two of three people are right-handed and none is two-handed."""
    style = Style(*(float(value) for value in rng.uniform(-1, 1, len(Style._fields))))
    side = 1.0 if rng.random() < 2 / 3 else -1.0
    return style._replace(handedness=side * (0.3 + 0.7 * abs(style.handedness)))

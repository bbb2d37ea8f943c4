"""The style of a speaker of Talk: six numbers that change how the speaker moves, and not when or why."""

from typing import NamedTuple

import numpy as np


class Style(NamedTuple):
    """Six numbers in [-1, 1]; 0 is the middle of the population.

    Attributes:
        mixing: weight of the three causes; high is more beats, low is larger word gestures and head movement.
        amplitude: size of all movement.
        handedness: which hand does more, -1 left, 1 right.
        latency: delay of the gestures after the speech.
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
    """Draw a random style: uniform in [-1, 1], except that two of three speakers are right-handed and none is
    ambidextrous.

    Args:
        rng: generator of the random draws.
    """
    style = Style(*(float(value) for value in rng.uniform(-1, 1, len(Style._fields))))
    side = 1.0 if rng.random() < 2 / 3 else -1.0
    return style._replace(handedness=side * (0.3 + 0.7 * abs(style.handedness)))

"""Images of the speakers of Talk, in which the look of a speaker shows the speaker's style."""

import numpy as np

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk.style import Style

_SKELETON = "ted_expressive"

# The two ends of each scale that a number of the style moves along.
_SHIRTS = ((40, 92, 170), (196, 62, 52))  # amplitude: calm blue to lively red
_HAIR = ((46, 34, 32), (214, 176, 96))  # mixing: dark to fair
_SKINS = ((122, 82, 60), (246, 214, 188))  # curl: dark to light
_BACKGROUNDS = ((206, 228, 212), (238, 214, 206))  # latency: green to rose
_BUILDS = (0.86, 1.16)  # elbow: slim to broad
_HAIR_LENGTHS = (0.0, 1.0)  # handedness: short for the left hand to long for the right


def look(style: Style) -> figure.Look:
    """Return the look of a speaker; each number of the style changes one feature that is large in the image.

    Args:
        style: style of the speaker.
    """
    return figure.Look(
        skin=_colour(_SKINS, style.curl),
        hair=_colour(_HAIR, style.mixing),
        shirt=_colour(_SHIRTS, style.amplitude),
        background=_colour(_BACKGROUNDS, style.latency),
        build=_between(_BUILDS, style.elbow),
        hair_length=_between(_HAIR_LENGTHS, style.handedness),
    )


def portrait(positions: np.ndarray, style: Style, size: int = 224) -> np.ndarray:
    """Draw a speaker in a pose.

    Args:
        positions: (43, 3) joint positions in metres.
        style: style of the speaker.
        size: width and height of the image in pixels.

    Returns:
        (size, size, 3) uint8 image.
    """
    return figure.draw_figure(positions, skeletons.load_skeleton(_SKELETON), look(style), size, size)


def _between(ends: tuple[float, float], value: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * (value + 1) / 2


def _colour(ends: tuple[figure.Colour, figure.Colour], value: float) -> figure.Colour:
    red, green, blue = (round(_between(pair, value)) for pair in zip(*ends, strict=True))
    return red, green, blue

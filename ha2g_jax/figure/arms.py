"""Shapes of the arms."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.shapes import Look, Shape, capsules, shade
from ha2g_jax.figure.trunk import EDGE

_LIT = np.array([-0.008, -0.012, 0.0])  # metres; the light comes from the upper left of the image


class Arm(NamedTuple):
    """Shapes of an arm without the hand, each list from back to front.

    Attributes:
        shoulder: edge of the upper arm, which is drawn behind the trunk.
        edges: edges of both parts, which are drawn before both.
        upper: upper arm.
        lower: forearm with cuff.
    """

    shoulder: list[Shape]
    edges: list[Shape]
    upper: list[Shape]
    lower: list[Shape]


def arm_shapes(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> Arm:
    """Build an arm as round sleeves that pass into each other at the elbow.

    The edges of both sleeves are drawn before both, so that no line crosses the elbow. Each sleeve has its edge a
    second time, away from the elbow, for where it crosses the other one.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        side: "left" or "right".
        look: colours and build of the figure.
        detail: factor of the number of points of a curve.

    Returns:
        The shapes.
    """
    shoulder, elbow, wrist = (points[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist"))

    def upper(part: float) -> np.ndarray:
        return shoulder + part * (elbow - shoulder)

    def lower(part: float) -> np.ndarray:
        return elbow + part * (wrist - elbow)

    top, joint, hem, edge = 0.057 * look.build, 0.0445 * look.build, 0.034 * look.build, EDGE
    dark, light, skin = shade(look.shirt, 0.70), shade(look.shirt, 1.07), shade(look.skin, 0.84)
    # There is no edge between sleeve and trunk, so over the trunk the edge starts below the shoulder.
    rows = [
        (shoulder, elbow, top + edge, joint + edge, dark),
        (upper(0.3), elbow, top - 0.006, joint + edge, dark),
        (elbow, lower(0.92), joint + edge, hem + edge, dark),
        (upper(0.3), upper(0.7), top - 0.003, joint + 0.004 + edge, dark),
        (shoulder, elbow, top, joint, look.shirt),
        (upper(0.3) + _LIT, upper(0.97) + _LIT, 0.4 * top, 0.42 * joint, light),
        (lower(0.92), wrist, 0.027, 0.025, skin),
        (lower(0.35), lower(0.92), joint - 0.006, hem + edge, dark),
        (elbow, lower(0.92), joint, hem, look.shirt),
        (lower(0.03) + _LIT, lower(0.88) + _LIT, 0.42 * joint, 0.42 * hem, light),
        (lower(0.87), lower(0.92), hem + 0.002, hem + 0.002, shade(look.shirt, 0.82)),
    ]
    starts, ends, wide, narrow, colours = zip(*rows, strict=True)
    outlines = capsules(np.stack(starts, axis=1), np.stack(ends, axis=1), np.array(wide), np.array(narrow), detail)
    shapes = [Shape(*shape) for shape in zip(outlines, colours, strict=True)]
    return Arm(shapes[:1], shapes[1:3], shapes[3:6], shapes[6:])

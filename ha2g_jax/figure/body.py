"""Shapes of the trunk, the arms and the hands."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.shapes import Look, Shape, capsules, dot, facing, project, shade, smooth, unit

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_FINGER_RADII = (0.0125, 0.0105, 0.011, 0.0105, 0.009)
_LIT = np.array([-0.008, -0.012, 0.0])  # metres; the light comes from the upper left of the image


def torso_shapes(points: dict[str, np.ndarray], look: Look) -> list[Shape]:
    """Build trunk and collar.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        look: colours and build of the figure.

    Returns:
        Shapes from back to front.
    """
    spine, neck = points["spine"], points["neck"]
    left, right = points["left_shoulder"], points["right_shoulder"]
    up = unit(neck - spine)
    across = unit(left - right)
    build = look.build
    half = [
        neck + 0.055 * up + 0.045 * across,
        neck + 0.030 * up + 0.085 * across,
        left + 0.050 * build * up - 0.035 * across,
        left + 0.012 * up + 0.030 * build * across,
        left - 0.110 * up - 0.005 * across,
        spine + 0.00 * up + 0.170 * build * across,
        spine - 0.16 * up + 0.158 * build * across,
        spine - 0.32 * up + 0.172 * build * across,
        spine - 0.52 * up + 0.190 * build * across,
    ]
    mirrored = [point - 2 * dot(point - spine, across) * across for point in half]
    mirrored[2] = right + 0.050 * build * up + 0.035 * across
    mirrored[3] = right + 0.012 * up - 0.030 * build * across
    mirrored[4] = right - 0.110 * up + 0.005 * across
    outline = smooth(project(np.stack(half + mirrored[::-1], axis=-2)))
    middle = outline.mean(axis=-2, keepdims=True)
    light = middle + np.array([0.965, 0.985]) * (outline - middle)
    collar = [
        neck + 0.05 * up + 0.062 * across,
        neck - 0.055 * up - 0.03 * facing(points),
        neck + 0.05 * up - 0.062 * across,
    ]
    shapes = [Shape(outline, shade(look.shirt, 0.76)), Shape(light, look.shirt)]
    return [*shapes, Shape(project(np.stack(collar, axis=-2)), shade(look.skin, 0.86))]


def arm_shapes(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> list[Shape]:
    """Build the sleeve and the cuff of an arm.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        side: "left" or "right".
        look: colours and build of the figure.
        detail: factor of the number of points of a curve.

    Returns:
        Shapes from back to front.
    """
    shoulder, elbow, wrist = (points[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist"))
    cuff = elbow + 0.92 * (wrist - elbow)
    armpit = shoulder + 0.3 * (elbow - shoulder)
    starts, ends = _pair(shoulder, elbow), _pair(elbow, cuff)
    wide, narrow = look.build * np.array([0.057, 0.044]), look.build * np.array([0.045, 0.034])
    dark, light = shade(look.shirt, 0.70), shade(look.shirt, 1.07)
    # The edge starts below the shoulder, because there is no edge between sleeve and trunk.
    edges = capsules(_pair(armpit, elbow), ends, wide + np.array([-0.003, 0.003]), narrow + 0.003, detail)
    cloth = capsules(starts, ends, wide, narrow, detail)
    bright = capsules(_pair(armpit, elbow) + _LIT, ends + _LIT, 0.4 * wide, 0.45 * narrow, detail)
    skin = _capsule(cuff, wrist, 0.027, 0.025, detail)
    hem = _capsule(elbow + 0.9 * (wrist - elbow), cuff, 0.036, 0.036, detail)
    shapes = [Shape(edges[0], dark), Shape(cloth[0], look.shirt), Shape(bright[0], light)]
    shapes += [Shape(skin, shade(look.skin, 0.84)), Shape(edges[1], dark), Shape(cloth[1], look.shirt)]
    return [*shapes, Shape(bright[1], light), Shape(hem, dark)]


class Part(NamedTuple):
    """Shapes that are drawn together.

    Attributes:
        depth: (T,) distance from the picture plane in metres.
        shapes: shapes from back to front.
    """

    depth: np.ndarray
    shapes: list[Shape]


def hand_parts(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> list[Part]:
    """Build palm and fingers, or a mitten where the skeleton has no fingers.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        side: "left" or "right".
        look: colours of the figure.
        detail: factor of the number of points of a curve of the mitten.

    Returns:
        The palm and each finger as parts of their own.
    """
    wrist, elbow = points[f"{side}_wrist"], points[f"{side}_elbow"]
    edge, lit = shade(look.skin, 0.72), shade(look.skin, 1.04)
    if f"{side}_index_1" not in points:
        tip = wrist + 0.14 * unit(wrist - elbow)
        mitten = [
            Shape(_capsule(wrist, tip, 0.030, 0.026, detail), edge),
            Shape(_capsule(wrist, tip, 0.030 - 0.004, 0.026 - 0.004, detail), lit),
        ]
        return [Part(wrist[:, 2], mitten)]
    chains = np.stack([_finger_chain(points, side, finger) for finger in _FINGERS], axis=1)
    starts, ends = chains[:, :, :-1].reshape(-1, 15, 3), chains[:, :, 1:].reshape(-1, 15, 3)
    radii = np.repeat(np.array(_FINGER_RADII), 3) * np.tile([1.08, 1.0, 0.94], 5)
    tips = np.repeat(np.array(_FINGER_RADII), 3) * np.tile([1.0, 0.94, 0.8], 5)
    # The palm: capsules from the wrist to each knuckle, joined by one outline.
    knuckles = chains[:, :, 0]
    wrists = np.repeat(wrist[:, None], 5, axis=1)
    bones = capsules(wrists, knuckles, np.full(5, 0.024), np.array([0.016, *[0.0145] * 4]))
    slim = capsules(wrists, knuckles, np.full(5, 0.021), np.array([0.013, *[0.0115] * 4]))
    fill = project(np.concatenate([wrist[:, None], knuckles], axis=1))
    palm = [Shape(outline, edge) for outline in bones] + [Shape(outline, look.skin) for outline in (*slim, fill)]
    parts = [Part(np.concatenate([wrist[:, None], knuckles[:, 1:]], axis=1)[..., 2].mean(axis=1), palm)]
    outer = capsules(starts, ends, radii + 0.0028, tips + 0.0028)
    inner = capsules(starts, ends, radii, tips)
    # Each finger is one part, with its edge first, so that there are no seams at its joints.
    for finger in range(5):
        bones = range(3 * finger, 3 * finger + 3)
        shapes = [Shape(outer[bone], edge) for bone in bones] + [Shape(inner[bone], lit) for bone in bones]
        parts.append(Part(chains[:, finger, 1:, 2].mean(axis=1), shapes))
    return parts


def _finger_chain(points: dict[str, np.ndarray], side: str, finger: str) -> np.ndarray:
    """Return the (T, 4, 3) joints of a finger and its tip, which is extrapolated because skeletons have no tips."""
    first, second, third = (points[f"{side}_{finger}_{part}"] for part in (1, 2, 3))
    ahead, last = second - first, third - second
    tip = third + 0.026 * unit(unit(last) + 0.4 * (unit(last) - unit(ahead)))
    return np.stack([first, second, third, tip], axis=1)


def _pair(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Stack two points (T, 3) to (T, 2, 3)."""
    return np.stack([first, second], axis=1)


def _capsule(start: np.ndarray, end: np.ndarray, wide: float, narrow: float, detail: int) -> np.ndarray:
    """Return the outline (T, n, 2) of one capsule between points (T, 3)."""
    return capsules(start[:, None], end[:, None], np.array([wide]), np.array([narrow]), detail)[0]

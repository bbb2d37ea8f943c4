"""Shapes of trunk, legs, arms and hands."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.shapes import (
    Colour,
    Look,
    Part,
    Shape,
    capsules,
    dot,
    enlarged,
    facing,
    hull,
    project,
    shade,
    smooth,
    unit,
)

_CLOTH_EDGE = 0.003  # metres; width of the dark line around a limb and around the trunk

_DOWN = np.array([0.0, 1.0, 0.0])
_BREADTH = 0.215  # metres from the neck to a shoulder of a trunk of average width
_TROUSERS = (62, 66, 78)
# Sections of the trunk: metres above the spine joint, then along the lower trunk, then half the width.
_SECTIONS = ((0.06, 0, 0.12), (0, 0, 0.163), (-0.08, 0, 0.152), (-0.16, 0, 0.146), (-0.16, 0.16, 0.160))
_SECTIONS += ((-0.16, 0.33, 0.178), (-0.16, 0.35, 0.170), (-0.16, 0.355, 0.15))
_THICK = 0.68  # thickness of the trunk, as a fraction of its width
_LIT = np.array([-0.008, -0.012, 0.0])  # metres; the light comes from the upper left of the image

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_HAND_EDGE = 0.0028  # metres
_RADII = np.array((0.0125, 0.0105, 0.011, 0.0105, 0.009))
_BONES = np.repeat(_RADII, 3) * np.tile([1.08, 1.0, 0.94], 5)
_TIPS = np.repeat(_RADII, 3) * np.tile([1.0, 0.94, 0.8], 5)
_OUT = 0.4  # fraction of the first bone of a finger that has no edge within the palm
# Metres from the wrist, and radii.
_MITTEN = (
    *((0.0, 0.026), (0.025, 0.0315), (0.05, 0.0350), (0.075, 0.0355)),
    *((0.1, 0.033), (0.125, 0.0285), (0.145, 0.022)),
)


def trunk_shapes(points: dict[str, np.ndarray], look: Look, detail: int) -> list[Shape]:
    """Build shoulders, chest, belly and legs, which overlap in any pose: all edges, and then what they surround."""
    span = np.linalg.norm(points["left_shoulder"] - points["neck"], axis=-1)
    span += np.linalg.norm(points["right_shoulder"] - points["neck"], axis=-1)
    build = look.build * np.clip(span / (2 * _BREADTH), 0.75, 1.15)
    layers = ((_CLOTH_EDGE, 0.76), (0.0, 1.0))
    return [
        Shape(outline, shade(colour, factor))
        for margin, factor in layers
        for outline, colour in _outlines(points, look, build, margin, detail)
    ]


def _outlines(
    points: dict[str, np.ndarray], look: Look, build: np.ndarray, margin: float, detail: int
) -> list[tuple[np.ndarray, Colour]]:
    """Return outlines that are larger by a margin in metres, with their colours, for a build (T,) of the trunk."""
    spine, neck = points["spine"], points["neck"]
    left, right = points["left_shoulder"], points["right_shoulder"]
    up, across = unit(neck - spine), unit(left - right)
    # Below the spine there are no joints: the hips turn with the shoulders, but lean only half as much.
    below = unit(_DOWN - up)
    hips = spine - 0.16 * up + 0.33 * below
    knees = hips + 0.55 * unit(below + _DOWN)
    side = build[:, None] * across

    def around(*discs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        centres, radii = zip(*discs, strict=True)
        return hull(np.stack(centres, axis=1), np.stack(radii, axis=1) + margin, detail)

    yoke = [(neck + 0.005 * up, np.full(len(neck), 0.054))]
    chest, legs, webs = [], [], []
    for sign, name in ((1, "left"), (-1, "right")):
        out, shoulder, elbow = sign * side, points[f"{name}_shoulder"], points[f"{name}_elbow"]
        flank = spine - 0.01 * up + 0.090 * out
        yoke.append((shoulder, np.full(len(neck), 0.056 * look.build)))
        chest += [(shoulder - 0.045 * out, 0.052 * build), (flank, 0.075 * build)]
        legs.append(around((hips + 0.085 * out + 0.02 * below, 0.088 * build), (knees + 0.075 * out, 0.08 * build)))
        # The cloth under the arm. It reaches down as far as the arm is close to the trunk: otherwise there is a narrow
        # gap between them.
        inside = shoulder + 0.55 * (elbow - shoulder)
        gap = np.linalg.norm(project(inside) - project(flank), axis=-1, keepdims=True) - 0.125
        close = np.clip(1 - gap / 0.04, 0, 1)
        sleeve = shoulder + 0.55 * close * (elbow - shoulder)
        webs.append(around((sleeve, 0.044 * build), (flank + 0.12 * (1 - close) * up, 0.07 * build)))
    belly = smooth(_sections(points, up, below, build, margin), detail)
    shirt = [*webs, belly, around(*chest), around(*yoke)]
    return [*((leg, _TROUSERS) for leg in legs), *((cloth, look.shirt) for cloth in shirt)]


def _sections(
    points: dict[str, np.ndarray], up: np.ndarray, below: np.ndarray, build: np.ndarray, margin: float
) -> np.ndarray:
    """Return the corners (T, n, 2) of the outline of elliptic sections of the trunk, two for each section."""
    levels = [points["spine"] + above * up + low * below for above, low, _ in _SECTIONS]
    middles = np.stack(levels, axis=1)
    line = project(middles)
    along = np.gradient(line, axis=1)
    normal = unit(np.stack([along[..., 1], -along[..., 0]], axis=-1))
    across, ahead = unit(points["left_shoulder"] - points["right_shoulder"]), facing(points)
    half = np.hypot(dot(normal, across[:, None, :2]), _THICK * dot(normal, ahead[:, None, :2]))
    half = half * build[:, None, None] * np.array([width for _, _, width in _SECTIONS])[:, None] + margin
    half = half * enlarged(middles[..., 2:])
    return np.concatenate([line + half * normal, (line - half * normal)[:, ::-1]], axis=1)


class Arm(NamedTuple):
    """Shapes of an arm without the hand, each list from back to front.

    `shoulder` is the edge of the upper arm, which is drawn behind the trunk; `edges` are drawn before both parts.
    """

    shoulder: list[Shape]
    edges: list[Shape]
    upper: list[Shape]
    lower: list[Shape]


def arm_shapes(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> Arm:
    """Build an arm as round sleeves that pass into each other at the elbow.

    The edges of both sleeves are drawn before both, so that no line crosses the elbow. Each sleeve has its edge a
    second time, away from the elbow, for where it crosses the other one.
    """
    shoulder, elbow, wrist = (points[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist"))

    def upper(part: float) -> np.ndarray:
        return shoulder + part * (elbow - shoulder)

    def lower(part: float) -> np.ndarray:
        return elbow + part * (wrist - elbow)

    top, joint, hem, edge = 0.057 * look.build, 0.0445 * look.build, 0.034 * look.build, _CLOTH_EDGE
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


def hand_parts(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> list[Part]:
    """Build palm and fingers, or a mitten where the skeleton has no fingers.

    Returns:
        The edge of the hand, which is behind everything else of it, the palm and each finger as parts of their own,
        with their depths in metres as keys.
    """
    wrist = points[f"{side}_wrist"]
    edge, lit = shade(look.skin, 0.72), shade(look.skin, 1.02)
    behind = np.full(len(wrist), np.inf)
    if f"{side}_index_1" not in points:
        along = unit(wrist - points[f"{side}_elbow"])
        centres = np.stack([wrist + far * along for far, _ in _MITTEN], axis=1)
        radii = np.array([radius for _, radius in _MITTEN])
        mitten = Shape(hull(centres, radii, detail), edge), Shape(hull(centres, radii - 0.0035, detail), lit)
        return [Part(behind, list(mitten))]
    chains = np.stack([_finger_chain(points, side, finger) for finger in _FINGERS], axis=1)
    starts, ends = chains[:, :, :-1].reshape(-1, 15, 3), chains[:, :, 1:].reshape(-1, 15, 3)
    # The palm: the hull of the wrist and the four knuckles, and the ball of the thumb.
    discs = np.concatenate([wrist[:, None], chains[:, 1:, 0]], axis=1)
    radii = np.array([0.023, 0.0125, 0.0125, 0.0120, 0.0115])
    ball = np.stack([wrist + 0.2 * (chains[:, 0, 0] - wrist), chains[:, 0, 0]], axis=1)
    ball_radii = np.array([0.020, 0.0145])
    base = [Shape(hull(discs, radii + _HAND_EDGE), edge), Shape(hull(ball, ball_radii + _HAND_EDGE), edge)]
    palm = [Shape(hull(ball, ball_radii), lit), Shape(hull(discs, radii), lit)]
    out = starts.copy()
    out[:, ::3] += _OUT * (ends - starts)[:, ::3]
    whole = capsules(starts[:, ::3], ends[:, ::3], _BONES[::3] + _HAND_EDGE, _TIPS[::3] + _HAND_EDGE)
    outer = capsules(out, ends, _BONES + _HAND_EDGE, _TIPS + _HAND_EDGE)
    inner = capsules(starts, ends, _BONES, _TIPS)
    parts = [
        Part(behind, [*base, *(Shape(outline, edge) for outline in whole)]),
        Part(discs[..., 2].mean(axis=1), palm),
    ]
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

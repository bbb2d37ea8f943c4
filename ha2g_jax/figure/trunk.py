"""Shapes of the trunk, and of the legs where an image reaches that far down."""

import numpy as np

from ha2g_jax.figure.shapes import Colour, Look, Shape, dot, enlarged, facing, hull, project, shade, smooth, unit

EDGE = 0.003  # metres; width of the dark line around a limb and around the trunk

_DOWN = np.array([0.0, 1.0, 0.0])
_BREADTH = 0.215  # metres from the neck to a shoulder of a trunk of average width
_TROUSERS = (62, 66, 78)
# Sections of the trunk: metres above the spine joint, then along the lower trunk, then half the width.
_SECTIONS = ((0.06, 0, 0.12), (0, 0, 0.163), (-0.08, 0, 0.152), (-0.16, 0, 0.146), (-0.16, 0.16, 0.160))
_SECTIONS += ((-0.16, 0.33, 0.178), (-0.16, 0.35, 0.170), (-0.16, 0.355, 0.15))
_THICK = 0.68  # thickness of the trunk, as a fraction of its width


def trunk_shapes(points: dict[str, np.ndarray], look: Look, detail: int) -> list[Shape]:
    """Build shoulders, chest, belly and legs, which overlap in any pose.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        look: colours and build of the figure.
        detail: factor of the number of points of a curve.

    Returns:
        Shapes from back to front: all edges, and then what they surround.
    """
    span = np.linalg.norm(points["left_shoulder"] - points["neck"], axis=-1)
    span += np.linalg.norm(points["right_shoulder"] - points["neck"], axis=-1)
    build = look.build * np.clip(span / (2 * _BREADTH), 0.75, 1.15)
    layers = ((EDGE, 0.76), (0.0, 1.0))
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

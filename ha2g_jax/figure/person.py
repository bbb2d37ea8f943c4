"""Shapes of a person: trunk and legs, arms and hands, neck, face and hair.

The measures in capitals without an underscore are also those of the body in three dimensions, `formats.body_mesh`.
"""

from collections.abc import Sequence
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
    hull_of,
    project,
    shade,
    smooth,
)
from ha2g_jax.skeleton import FINGERS, normalize

_CLOTH_EDGE = 0.003  # metres; width of the dark line around a limb and around the trunk

_DOWN = np.array([0.0, 1.0, 0.0])
_BREADTH = 0.215  # metres from the neck to a shoulder of a trunk of average width
TROUSERS: Colour = (62, 66, 78)
EYES: tuple[Colour, Colour] = (250, 250, 250), (60, 44, 38)  # the white and the iris
# Sections of the trunk: metres above the spine joint, then along the lower trunk, then half the width.
SECTIONS = ((0.06, 0, 0.12), (0, 0, 0.163), (-0.08, 0, 0.152), (-0.16, 0, 0.146), (-0.16, 0.16, 0.160))
SECTIONS += ((-0.16, 0.33, 0.178), (-0.16, 0.35, 0.170), (-0.16, 0.355, 0.15))
THICK = 0.68  # thickness of the trunk, as a fraction of its width
_LIT = np.array([-0.008, -0.012, 0.0])  # metres; the light comes from the upper left of the image

SLEEVE = (0.057, 0.0445, 0.034)  # metres; radii at shoulder, elbow and hem
CUFF = 0.92  # fraction of the forearm that the sleeve covers
WRIST = (0.027, 0.025)  # metres; radii of the forearm below the sleeve
_HAND_EDGE = 0.0028  # metres
FINGER_RADII = np.array((0.0125, 0.0105, 0.011, 0.0105, 0.009))
FINGER_TIP = 0.026  # metres from the last joint of a finger
_BONES = np.repeat(FINGER_RADII, 3) * np.tile([1.08, 1.0, 0.94], 5)
_TIPS = np.repeat(FINGER_RADII, 3) * np.tile([1.0, 0.94, 0.8], 5)
_OUT = 0.4  # fraction of the first bone of a finger that has no edge within the palm
# Metres from the wrist, and radii.
MITTEN = (
    *((0.0, 0.026), (0.025, 0.0315), (0.05, 0.0350), (0.075, 0.0355)),
    *((0.1, 0.033), (0.125, 0.0285), (0.145, 0.022)),
)

HEAD_SIZE = 1.16  # factor of a head that is 0.23 m high
# Metres on a head of size 1, as across, tall; the positions below are from its centre to its left, up and ahead.
FACE = (0.086, 0.116)
THROAT = (0.061, 0.055)  # metres; radii at the collar and below the chin
EAR = (0.086, -0.012, -0.01), (0.017, 0.027)  # place and half axes
EYE_WHITE = (0.033, -0.004, 0.080), (0.0150, 0.0088)
IRIS = (0.033, -0.004, 0.083), (0.0078, 0.0084)
LID = ((0.016, -0.004), (0.024, 0.005), (0.036, 0.0075), (0.049, 0.001), (0.036, 0.001))
BROW = ((0.017, 0.022), (0.034, 0.029), (0.053, 0.020), (0.034, 0.0235))
NOSE = ((0.0, 0.0, 0.088), (0.011, -0.034, 0.104), (0.0, -0.040, 0.106), (-0.011, -0.034, 0.104))
LIPS = ((-0.026, -0.061, 0.078), (0.0, -0.068, 0.088), (0.026, -0.061, 0.078), (0.0, -0.076, 0.086))
# Where the hair on the back of the head begins, on one side from the top to the nape.
_HAIRLINE = ((0.04, 0.115, -0.06), (0.08, 0.08, -0.07), (0.095, 0.01, -0.085))
_HAIRLINE += ((0.08, -0.06, -0.075), (0.035, -0.1, -0.055))
_MOST_TURNED = 0.4  # sine of the angle between the hair over the forehead and the camera
_FRONT = ((-0.060, 0.030, 0.082), (0.060, 0.030, 0.082), (-0.058, -0.020, 0.080), (0.058, -0.020, 0.080))
_FRONT += ((0.0, 0.060, 0.085), (0.0, -0.040, 0.098), (-0.03, -0.075, 0.075), (0.03, -0.075, 0.075), (0.0, -0.1, 0.07))


def trunk_shapes(points: dict[str, np.ndarray], look: Look, detail: int) -> list[Shape]:
    """Build shoulders, chest, belly and legs, which overlap in any pose: all edges, and then the areas within them."""
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
    up, across = normalize(neck - spine), normalize(left - right)
    # Below the spine there are no joints: the hips turn with the shoulders, but lean only half as much.
    below = normalize(_DOWN - up)
    hips = spine - 0.16 * up + 0.33 * below
    knees = hips + 0.55 * normalize(below + _DOWN)
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
    return [*((leg, TROUSERS) for leg in legs), *((cloth, look.shirt) for cloth in shirt)]


def _sections(
    points: dict[str, np.ndarray], up: np.ndarray, below: np.ndarray, build: np.ndarray, margin: float
) -> np.ndarray:
    """Return the corners (T, n, 2) of the outline of elliptic sections of the trunk, two for each section."""
    levels = [points["spine"] + above * up + low * below for above, low, _ in SECTIONS]
    middles = np.stack(levels, axis=1)
    line = project(middles)
    along = np.gradient(line, axis=1)
    normal = normalize(np.stack([along[..., 1], -along[..., 0]], axis=-1))
    across, ahead = normalize(points["left_shoulder"] - points["right_shoulder"]), facing(points)
    half = np.hypot(dot(normal, across[:, None, :2]), THICK * dot(normal, ahead[:, None, :2]))
    half = half * build[:, None, None] * np.array([width for _, _, width in SECTIONS])[:, None] + margin
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
    """Build an arm as round sleeves that merge at the elbow.

    The edges of both sleeves are drawn before both, so that no line crosses the elbow. Each sleeve has its edge a
    second time, away from the elbow, for where it crosses the other one.
    """
    shoulder, elbow, wrist = (points[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist"))

    def upper(part: float) -> np.ndarray:
        return shoulder + part * (elbow - shoulder)

    def lower(part: float) -> np.ndarray:
        return elbow + part * (wrist - elbow)

    top, joint, hem, edge = *(radius * look.build for radius in SLEEVE), _CLOTH_EDGE
    dark, light, skin = shade(look.shirt, 0.70), shade(look.shirt, 1.07), shade(look.skin, 0.84)
    # There is no edge between sleeve and trunk, so over the trunk the edge starts below the shoulder.
    rows = [
        (shoulder, elbow, top + edge, joint + edge, dark),
        (upper(0.3), elbow, top - 0.006, joint + edge, dark),
        (elbow, lower(CUFF), joint + edge, hem + edge, dark),
        (upper(0.3), upper(0.7), top - 0.003, joint + 0.004 + edge, dark),
        (shoulder, elbow, top, joint, look.shirt),
        (upper(0.3) + _LIT, upper(0.97) + _LIT, 0.4 * top, 0.42 * joint, light),
        (lower(CUFF), wrist, *WRIST, skin),
        (lower(0.35), lower(CUFF), joint - 0.006, hem + edge, dark),
        (elbow, lower(CUFF), joint, hem, look.shirt),
        (lower(0.03) + _LIT, lower(0.88) + _LIT, 0.42 * joint, 0.42 * hem, light),
        (lower(0.87), lower(CUFF), hem + 0.002, hem + 0.002, shade(look.shirt, 0.82)),
    ]
    starts, ends, wide, narrow, colours = zip(*rows, strict=True)
    outlines = capsules(np.stack(starts, axis=1), np.stack(ends, axis=1), np.array(wide), np.array(narrow), detail)
    shapes = [Shape(*shape) for shape in zip(outlines, colours, strict=True)]
    return Arm(shapes[:1], shapes[1:3], shapes[3:6], shapes[6:])


def hand_parts(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> list[Part]:
    """Build the edge of the hand, which is behind the rest of it, and the palm and each finger, or a mitten where the
    skeleton has no fingers, as parts with their depths in metres as keys.
    """
    wrist = points[f"{side}_wrist"]
    edge, lit = shade(look.skin, 0.72), shade(look.skin, 1.02)
    behind = np.full(len(wrist), np.inf)
    if f"{side}_index_1" not in points:
        along = normalize(wrist - points[f"{side}_elbow"])
        centres = np.stack([wrist + far * along for far, _ in MITTEN], axis=1)
        radii = np.array([radius for _, radius in MITTEN])
        mitten = Shape(hull(centres, radii, detail), edge), Shape(hull(centres, radii - 0.0035, detail), lit)
        return [Part(behind, list(mitten))]
    chains = np.stack([_finger_chain(points, side, finger) for finger in FINGERS], axis=1)
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
    tip = third + FINGER_TIP * normalize(normalize(last) + 0.4 * (normalize(last) - normalize(ahead)))
    return np.stack([first, second, third, tip], axis=1)


def head_frame(points: dict[str, np.ndarray]) -> np.ndarray:
    """Compute the centre of the head and its axes to the left, up and ahead, of the length of its size, (4, T, 3)."""
    neck = points["neck"]
    if "left_ear" in points:
        ears = (points["left_ear"] + points["right_ear"]) / 2
        left = normalize(points["left_ear"] - points["right_ear"])
        ahead = points["nose"] - ears
        # The nose is below the ears, so the line between them is levelled.
        ahead = normalize(ahead - dot(ahead, left) * left)
        up = np.cross(ahead, left)
        up = np.where(up[:, 1:2] < 0, up, -up)
        tilt = np.deg2rad(-18)
        ahead, up = np.cos(tilt) * ahead - np.sin(tilt) * up, np.cos(tilt) * up + np.sin(tilt) * ahead
        return np.stack([ears + 0.012 * up + 0.055 * ahead, *(HEAD_SIZE * axis for axis in (left, up, ahead))])
    top = points["head"] if "head" in points else points["nose"]
    up = normalize(top - neck)
    left = points["left_shoulder"] - points["right_shoulder"]
    left = normalize(left - dot(left, up) * up)
    ahead = points["nose"] - neck
    ahead = normalize(ahead - dot(ahead, up) * up - dot(ahead, left) * left)
    return np.stack([neck + 0.19 * up + 0.02 * ahead, *(HEAD_SIZE * axis for axis in (left, up, ahead))])


def hair_behind(head: np.ndarray, look: Look, detail: int) -> list[Shape]:
    """Build the hair that is behind the face and the shoulders, from back to front."""
    width = 0.096 + 0.018 * look.hair_length
    crown = _ellipse(head, (0, 0.022, -0.02), width, 0.112, detail, flat=False)
    # The fringe is in front of the crown, and beyond it where the head is turned: the hair between them is filled.
    cap = np.concatenate([crown, _fringe(head, look, detail)], axis=1)
    shapes = [Shape(hull_of(cap, detail), look.hair)]
    if look.hair_length > 0.3:
        shapes.append(Shape(_curve(_upright(head), _fall(look), detail), shade(look.hair, 0.86)))
    return shapes


def _fall(look: Look) -> list[tuple[float, float, float]]:
    """Return the corners of the hair that falls below the ears."""
    length, width = 0.012 + 0.17 * (look.hair_length - 0.3), 0.096 + 0.018 * look.hair_length
    fall = [(-width, 0.03, -0.03), (width, 0.03, -0.03), (width + 0.012, -0.06 - length, -0.02)]
    fall += [(0.6 * width, -0.115 - length, -0.03), (-0.6 * width, -0.115 - length, -0.03)]
    return [*fall, (-width - 0.012, -0.06 - length, -0.02)]


def back_of_head(head: np.ndarray, look: Look, detail: int) -> Part:
    """Build the hair on the back of the head, in front of the face where the head looks away, else a hidden dot.

    It is the hull of the hairline and of the hair behind it, so it covers the face more the further the head is turned
    away. In profile it is hardly more than the hair that is behind the face.
    """
    half = [((1 + 0.2 * look.hair_length) * x, y, z) for x, y, z in _HAIRLINE]
    curves = [half + [_beside(-1, place) for place in half[::-1]]]
    if look.hair_length > 0.3:
        curves.append([(x, y, z - 0.03) for x, y, z in _fall(look)])
    rims = [_ellipse(head, (0, 0, -0.09), 0.06, 0.07, detail), *(_curve(head, curve, detail) for curve in curves)]
    is_away = _is_away(head)
    outline = np.where(is_away[:, None, None], hull_of(np.concatenate(rims, axis=1), detail), project(head[0])[:, None])
    return Part(np.where(is_away, -0.5, -0.9), [Shape(outline, look.hair)])


def _is_away(head: np.ndarray) -> np.ndarray:
    """Return in which frames (T,) the head looks away from the camera."""
    return head[3][:, 2] > 0


def head_shapes(points: dict[str, np.ndarray], head: np.ndarray, look: Look, detail: int) -> list[Shape]:
    """Build neck, face without its features, and the hair over the forehead, from back to front."""
    dark, blush = shade(look.skin, 0.80), shade(look.skin, 0.90)
    low, high = points["neck"] + 0.02 * facing(points) + 0.1 * (head[0] - points["neck"]), head[0] - 0.05 * head[2]
    ends = np.stack([low, low], axis=1), np.stack([low, high], axis=1)
    collar, throat = capsules(*ends, np.array([0.0655, THROAT[0]]), np.array([0.0655, THROAT[1]]), detail)
    shapes = [Shape(collar, shade(look.shirt, 0.76)), Shape(throat, dark)]
    face = _ellipse(head, (0, 0, 0), *FACE, detail, flat=False)
    for side in (-1, 1):
        shapes.append(Shape(_ellipse(head, _beside(side, EAR[0]), *EAR[1], detail, flat=False), blush))
    # Where the head is turned, the front of the face with the eyes is beyond the ellipse.
    front = np.concatenate([face, _places(head, _FRONT)], axis=1)
    shapes.append(Shape(hull_of(front, detail), look.skin))
    shapes.append(Shape(_fringe(head, look, detail), look.hair))
    return shapes


def face_features(head: np.ndarray, look: Look, detail: int) -> Part:
    """Build eyes, nose and lips, which are behind the face where the head looks away."""
    shapes = []
    for side in (-1, 1):
        for (place, axes), colour in zip((EYE_WHITE, IRIS), EYES, strict=True):
            shapes.append(Shape(_ellipse(head, _beside(side, place), *axes, detail), colour))
        shapes.append(Shape(_curve(head, [(side * x, y, 0.084) for x, y in LID]), shade(look.hair, 0.55)))
        shapes.append(Shape(_curve(head, [(side * x, y, 0.085) for x, y in BROW]), shade(look.hair, 0.85)))
    shapes.append(Shape(_curve(head, NOSE), shade(look.skin, 0.90)))
    shapes.append(Shape(_curve(head, LIPS), lip_colour(look)))
    return Part(np.where(_is_away(head), -0.65, -0.55), shapes)


def lip_colour(look: Look) -> Colour:
    """Return the colour of the lips on the skin of a look."""
    return int(0.80 * look.skin[0]), int(0.58 * look.skin[1]), int(0.58 * look.skin[2])


def _beside(side: int, place: tuple[float, float, float]) -> tuple[float, float, float]:
    return (side * place[0], *place[1:])


def _fringe(head: np.ndarray, look: Look, detail: int) -> np.ndarray:
    """Return the outline of the hair over the forehead, parted at the side."""
    low = 0.035 - 0.03 * look.hair_length
    rim = [(-0.097, low - 0.01, 0.0), (-0.088, 0.075, 0.01), (-0.045, 0.128, 0.01), (0.01, 0.138, 0.01)]
    rim += [(0.06, 0.120, 0.01), (0.092, 0.070, 0.01), (0.097, low - 0.01, 0.0), (0.080, low + 0.015, 0.05)]
    rim += [(0.062, 0.066, 0.07), (0.030, 0.086, 0.075), (-0.020, 0.070, 0.078), (-0.062, 0.052, 0.07)]
    rim += [(-0.081, low + 0.012, 0.05)]
    return _curve(_half_turned(head), rim, detail)


def _ellipse(
    head: np.ndarray, place: tuple[float, float, float], across: float, tall: float, detail: int, flat: bool = True
) -> np.ndarray:
    """Return an ellipse (T, n, 2) on the head: in the plane of the face if flat, otherwise facing the camera."""
    angle = np.linspace(0, 2 * np.pi, 28 * detail, endpoint=False)
    left, up = (head if flat else _upright(head))[1:3]
    centre = _on_head(head, place)[:, None]
    rim = centre + across * np.cos(angle)[:, None] * left[:, None] + tall * np.sin(angle)[:, None] * up[:, None]
    return project(rim)


def _upright(head: np.ndarray) -> np.ndarray:
    """Return the head turned to the camera, with the inclination that it has in the picture."""
    up = HEAD_SIZE * normalize(head[2] * np.array([1, 1, 0]))
    left = np.stack([-up[:, 1], up[:, 0], np.zeros(len(up))], axis=-1)
    return np.stack([head[0], left, up, np.broadcast_to([0.0, 0.0, -HEAD_SIZE], up.shape)])


def _half_turned(head: np.ndarray) -> np.ndarray:
    """Return the head turned away from the camera by at most 24 degrees, so that no outline on it is folded."""
    _, left, up, ahead = _upright(head) / HEAD_SIZE
    sideways, upwards = (np.clip(dot(head[3] / HEAD_SIZE, axis), -_MOST_TURNED, _MOST_TURNED) for axis in (left, up))
    # From behind, one sees the top of a head that looks up.
    upwards = np.where(_is_away(head)[:, None], -upwards, upwards)
    ahead = normalize(sideways * left + upwards * up + np.sqrt(1 - sideways**2 - upwards**2) * ahead)
    left = normalize(left - dot(left, ahead) * ahead)
    up = normalize(up - dot(up, ahead) * ahead - dot(up, left) * left)
    return np.stack([head[0], *(HEAD_SIZE * axis for axis in (left, up, ahead))])


def _curve(head: np.ndarray, places: Sequence[tuple[float, float, float]], detail: int = 1) -> np.ndarray:
    return smooth(_places(head, places), detail)


def _places(head: np.ndarray, places: Sequence[tuple[float, float, float]]) -> np.ndarray:
    return project(np.stack([_on_head(head, place) for place in places], axis=1))


def _on_head(head: np.ndarray, place: tuple[float, float, float]) -> np.ndarray:
    return head[0] + place[0] * head[1] + place[1] * head[2] + place[2] * head[3]

"""Shapes of the head: face, hair and neck."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.figure.shapes import Look, Shape, capsules, dot, facing, hull_of, project, shade, smooth, unit

_SIZE = 1.16  # factor of a head that is 0.23 m high
_MOST_TURNED = 0.4  # sine of the angle between the hair over the forehead and the camera
_FRONT = ((-0.060, 0.030, 0.082), (0.060, 0.030, 0.082), (-0.058, -0.020, 0.080), (0.058, -0.020, 0.080))
_FRONT += ((0.0, 0.060, 0.085), (0.0, -0.040, 0.098), (-0.03, -0.075, 0.075), (0.03, -0.075, 0.075), (0.0, -0.1, 0.07))


def head_frame(points: dict[str, np.ndarray]) -> np.ndarray:
    """Compute the centre of the head and its axes to the left, up and ahead, of the length of its size, (4, T, 3)."""
    neck = points["neck"]
    if "left_ear" in points:
        ears = (points["left_ear"] + points["right_ear"]) / 2
        left = unit(points["left_ear"] - points["right_ear"])
        ahead = points["nose"] - ears
        # The nose is below the ears, so the line between them is levelled.
        ahead = unit(ahead - dot(ahead, left) * left)
        up = np.cross(ahead, left)
        up = np.where(up[:, 1:2] < 0, up, -up)
        tilt = np.deg2rad(-18)
        ahead, up = np.cos(tilt) * ahead - np.sin(tilt) * up, np.cos(tilt) * up + np.sin(tilt) * ahead
        return np.stack([ears + 0.012 * up + 0.055 * ahead, *(_SIZE * axis for axis in (left, up, ahead))])
    top = points["head"] if "head" in points else points["nose"]
    up = unit(top - neck)
    left = points["left_shoulder"] - points["right_shoulder"]
    left = unit(left - dot(left, up) * up)
    ahead = points["nose"] - neck
    ahead = unit(ahead - dot(ahead, up) * up - dot(ahead, left) * left)
    return np.stack([neck + 0.19 * up + 0.02 * ahead, *(_SIZE * axis for axis in (left, up, ahead))])


def hair_behind(head: np.ndarray, look: Look, detail: int) -> list[Shape]:
    """Build the hair that is behind the face and the shoulders, from back to front."""
    length = 0.012 + 0.17 * max(look.hair_length - 0.3, 0.0)
    width = 0.096 + 0.018 * look.hair_length
    crown = _ellipse(head, (0, 0.022, -0.02), width, 0.112, detail, flat=False)
    # The fringe is in front of the crown, and beyond it where the head is turned: the hair between them is filled.
    cap = np.concatenate([crown, _fringe(head, look, detail)], axis=1)
    shapes = [Shape(hull_of(cap, detail), look.hair)]
    if look.hair_length > 0.3:
        fall = [(-width, 0.03, -0.03), (width, 0.03, -0.03), (width + 0.012, -0.06 - length, -0.02)]
        fall += [(0.6 * width, -0.115 - length, -0.03), (-0.6 * width, -0.115 - length, -0.03)]
        fall += [(-width - 0.012, -0.06 - length, -0.02)]
        outline = _curve(_upright(head), fall, detail)
        shapes.append(Shape(outline, shade(look.hair, 0.86)))
    return shapes


def head_shapes(points: dict[str, np.ndarray], head: np.ndarray, look: Look, detail: int) -> list[Shape]:
    """Build neck, face and the hair over the forehead, from back to front."""
    dark, blush = shade(look.skin, 0.80), shade(look.skin, 0.90)
    low, high = points["neck"] + 0.02 * facing(points) + 0.1 * (head[0] - points["neck"]), head[0] - 0.05 * head[2]
    ends = np.stack([low, low], axis=1), np.stack([low, high], axis=1)
    collar, throat = capsules(*ends, np.array([0.0655, 0.061]), np.array([0.0655, 0.055]), detail)
    shapes = [Shape(collar, shade(look.shirt, 0.76)), Shape(throat, dark)]
    face = _ellipse(head, (0, 0, 0), 0.086, 0.116, detail, flat=False)
    for side in (-1, 1):
        shapes.append(Shape(_ellipse(head, (side * 0.086, -0.012, -0.01), 0.017, 0.027, detail, flat=False), blush))
    # Where the head is turned, the front of the face with the eyes is beyond the ellipse.
    front = np.concatenate([face, _places(head, _FRONT)], axis=1)
    shapes.append(Shape(hull_of(front, detail), look.skin))
    shapes.append(Shape(_fringe(head, look, detail), look.hair))
    for side in (-1, 1):
        lid = [(0.016, -0.004), (0.024, 0.005), (0.036, 0.0075), (0.049, 0.001), (0.036, 0.001)]
        brow = [(0.017, 0.022), (0.034, 0.029), (0.053, 0.020), (0.034, 0.0235)]
        shapes.append(Shape(_ellipse(head, (side * 0.033, -0.004, 0.080), 0.0150, 0.0088, detail), (250, 250, 250)))
        shapes.append(Shape(_ellipse(head, (side * 0.033, -0.004, 0.083), 0.0078, 0.0084, detail), (60, 44, 38)))
        shapes.append(Shape(_curve(head, [(side * x, y, 0.084) for x, y in lid]), shade(look.hair, 0.55)))
        shapes.append(Shape(_curve(head, [(side * x, y, 0.085) for x, y in brow]), shade(look.hair, 0.85)))
    nose = [(0.0, 0.0, 0.088), (0.011, -0.034, 0.104), (0.0, -0.040, 0.106), (-0.011, -0.034, 0.104)]
    shapes.append(Shape(_curve(head, nose), blush))
    lips = [(-0.026, -0.061, 0.078), (0.0, -0.068, 0.088), (0.026, -0.061, 0.078), (0.0, -0.076, 0.086)]
    lip_colour = (int(0.80 * look.skin[0]), int(0.58 * look.skin[1]), int(0.58 * look.skin[2]))
    shapes.append(Shape(_curve(head, lips), lip_colour))
    return shapes


def _fringe(head: np.ndarray, look: Look, detail: int) -> np.ndarray:
    """Return the outline of the hair over the forehead, parted at the side."""
    low = 0.035 - 0.03 * look.hair_length
    rim = [(-0.097, low - 0.01, 0.0), (-0.088, 0.075, 0.01), (-0.045, 0.128, 0.01), (0.01, 0.138, 0.01)]
    rim += [(0.06, 0.120, 0.01), (0.092, 0.070, 0.01), (0.097, low - 0.01, 0.0), (0.080, low + 0.015, 0.05)]
    rim += [(0.062, 0.066, 0.07), (0.030, 0.086, 0.075), (-0.020, 0.070, 0.078), (-0.062, 0.052, 0.07)]
    rim += [(-0.081, low + 0.012, 0.05)]
    return _curve(_half_turned(head), rim, detail)


def _ellipse(
    head: np.ndarray,
    place: tuple[float, float, float],
    across: float,
    tall: float,
    detail: int,
    flat: bool = True,
) -> np.ndarray:
    """Return an ellipse (T, n, 2) on the head: in the plane of the face if flat, else facing the camera."""
    angle = np.linspace(0, 2 * np.pi, 28 * detail, endpoint=False)
    left, up = (head if flat else _upright(head))[1:3]
    centre = _on_head(head, place)[:, None]
    rim = centre + across * np.cos(angle)[:, None] * left[:, None] + tall * np.sin(angle)[:, None] * up[:, None]
    return project(rim)


def _upright(head: np.ndarray) -> np.ndarray:
    """Return the head turned to the camera, with the inclination that it has in the picture."""
    up = _SIZE * unit(head[2] * np.array([1, 1, 0]))
    left = np.stack([-up[:, 1], up[:, 0], np.zeros(len(up))], axis=-1)
    return np.stack([head[0], left, up, np.broadcast_to([0.0, 0.0, -_SIZE], up.shape)])


def _half_turned(head: np.ndarray) -> np.ndarray:
    """Return the head turned away from the camera by at most 24 degrees, so that no outline on it is folded."""
    _, left, up, ahead = _upright(head) / _SIZE
    sideways, upwards = (np.clip(dot(head[3] / _SIZE, axis), -_MOST_TURNED, _MOST_TURNED) for axis in (left, up))
    ahead = unit(sideways * left + upwards * up + np.sqrt(1 - sideways**2 - upwards**2) * ahead)
    left = unit(left - dot(left, ahead) * ahead)
    up = unit(up - dot(up, ahead) * ahead - dot(up, left) * left)
    return np.stack([head[0], *(_SIZE * axis for axis in (left, up, ahead))])


def _curve(head: np.ndarray, places: list[tuple[float, float, float]], detail: int = 1) -> np.ndarray:
    """Return a smooth closed outline through places on the head."""
    return smooth(_places(head, places), detail)


def _places(head: np.ndarray, places: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Return places on the head in the picture plane (T, n, 2)."""
    return project(np.stack([_on_head(head, place) for place in places], axis=1))


def _on_head(head: np.ndarray, place: tuple[float, float, float]) -> np.ndarray:
    return head[0] + place[0] * head[1] + place[1] * head[2] + place[2] * head[3]

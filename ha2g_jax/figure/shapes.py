"""Elements of a figure for T frames at a time: perspective, capsules, hulls, smooth curves, light."""

import functools
from typing import NamedTuple

import numpy as np
from PIL import Image

from ha2g_jax.skeleton import normalize

Colour = tuple[int, int, int]

_CAMERA = 3.2  # metres in front of the spine
_NEAREST = 0.8  # metres; points nearer to the camera are drawn as large as at this distance
_TINY = 1e-6  # metres and radians


class Look(NamedTuple):
    """Appearance of a figure: RGB colours from 0 to 255, build 1 for the average, and hair length from 0 to 1."""

    skin: Colour
    hair: Colour
    shirt: Colour
    background: Colour
    build: float = 1.0
    hair_length: float = 0.4


class Shape(NamedTuple):
    """A filled shape in T frames; the outline is (T, n, 2) corners in metres in the picture plane."""

    outline: np.ndarray
    colour: Colour


class Part(NamedTuple):
    """Shapes that are drawn together, from back to front; parts are sorted by the (T,) numbers `key`."""

    key: np.ndarray
    shapes: list[Shape]


def enlarged(depths: np.ndarray) -> np.ndarray:
    """Return the factors by which perspective enlarges objects at depths behind the spine in metres."""
    return _CAMERA / np.maximum(_CAMERA + depths, _NEAREST)


def project(points: np.ndarray) -> np.ndarray:
    """Project points (..., 3) to the picture plane (..., 2) for a camera that looks along +z; both are in metres."""
    return points[..., :2] * enlarged(points[..., 2:])


def capsules(
    starts: np.ndarray, ends: np.ndarray, wide: np.ndarray, narrow: np.ndarray, detail: int = 1
) -> list[np.ndarray]:
    """Build the outlines (T, 14 * detail + 4, 2) of n tapered capsules, the hulls of two discs each.

    A capsule that points to the camera is a whole disc, so that there is no gap at a joint from any side. Starts and
    ends are (T, n, 3), the radii there, `wide` and `narrow`, are (n,), all in metres.
    """
    first, last = project(starts), project(ends)
    wide, narrow = wide * enlarged(starts[..., 2]), narrow * enlarged(ends[..., 2])
    along = last - first
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), _TINY)
    # Each straight side touches the discs at the same angle from the direction of the capsule.
    touch = np.arccos(np.clip((wide - narrow) / length, -1, 1))[..., None]
    evenly = np.linspace(-np.pi, np.pi, 14 * detail, endpoint=False)
    around = np.broadcast_to(evenly, (*touch.shape[:-1], len(evenly)))
    sides = (touch - _TINY, touch + _TINY, _TINY - touch, -_TINY - touch)
    around = np.sort(np.concatenate([around, *sides], axis=-1), axis=-1)
    is_far = (np.abs(around) < touch)[..., None]
    angle = around + np.arctan2(along[..., 1], along[..., 0])[..., None]
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    centre = np.where(is_far, last[..., None, :], first[..., None, :])
    radius = np.where(is_far, narrow[..., None, None], wide[..., None, None])
    return list(np.moveaxis(centre + radius * rim, -3, 0))


def hull(centres: np.ndarray, radii: np.ndarray, detail: int = 1) -> np.ndarray:
    """Build the outline (T, 32 * detail, 2) of the convex hull of n discs, with (T, n, 3) centres in metres."""
    rim = _directions(detail)
    places, radii = project(centres), radii * enlarged(centres[..., 2])
    # In each direction, the point of the disc that reaches farthest.
    farthest = np.argmax(places @ rim.T + radii[..., None], axis=-2)
    centre = np.take_along_axis(places, farthest[..., None], axis=-2)
    return centre + np.take_along_axis(radii, farthest, axis=-1)[..., None] * rim


def hull_of(corners: np.ndarray, detail: int) -> np.ndarray:
    """Return the convex hull (T, 32 * detail, 2) of points (T, n, 2) in the picture plane."""
    farthest = np.argmax(corners @ _directions(detail).T, axis=-2)
    return np.take_along_axis(corners, farthest[..., None], axis=-2)


def _directions(detail: int) -> np.ndarray:
    angle = np.arange(32 * detail) * (np.pi / (16 * detail))
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def smooth(outline: np.ndarray, detail: int) -> np.ndarray:
    """Return a closed Catmull-Rom curve (T, 5 * n * detail, 2) through points (T, n, 2)."""
    u = (np.arange(5 * detail) / (5 * detail))[:, None]
    before, here, after, later = (np.roll(outline, shift, axis=-2)[..., None, :] for shift in (1, 0, -1, -2))
    curve = 2 * here + (after - before) * u + (2 * before - 5 * here + 4 * after - later) * u**2
    curve = 0.5 * (curve + (3 * here - before - 3 * after + later) * u**3)
    return curve.reshape(len(outline), -1, 2)


@functools.lru_cache(maxsize=8)
def backdrop(colour: Colour, width: int, height: int) -> Image.Image:
    """Return a background image of one colour that darkens towards the corners."""
    light = light_behind(width, height)
    return Image.fromarray(np.clip(light[..., None] * np.array(colour), 0, 255).astype(np.uint8))


def light_behind(width: int, height: int) -> np.ndarray:
    """Return the (height, width) factors of the colour of the background, for sizes in pixels."""
    x, y = np.linspace(-1, 1, width)[None], np.linspace(-1, 1, height)[:, None]
    return 1.05 - 0.20 * np.clip(0.7 * x**2 + 0.5 * (y + 0.25) ** 2, 0, 1.2)


def shade(colour: Colour, factor: float) -> Colour:
    """Multiply a colour by a factor; above 1 it becomes lighter."""
    red, green, blue = (int(np.clip(channel * factor, 0, 255)) for channel in colour)
    return red, green, blue


def to_hex(colour: Colour) -> str:
    """Return a colour as HTML and SVG write it, such as #3e6e9e."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return inner products (..., 1) of vectors (..., 3)."""
    return np.sum(a * b, axis=-1, keepdims=True)


def facing(points: dict[str, np.ndarray]) -> np.ndarray:
    """Return the directions (T, 3) in which the trunk faces."""
    up, across = points["neck"] - points["spine"], points["left_shoulder"] - points["right_shoulder"]
    return normalize(np.cross(across, up))

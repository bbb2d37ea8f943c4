"""Elements of a figure for T frames at a time: perspective, capsules, smooth curves, light."""

import functools
from typing import NamedTuple

import numpy as np
from PIL import Image

Colour = tuple[int, int, int]

TOP, BOTTOM = -0.70, 0.42  # upper and lower edge of an image in metres from the spine, y down

_CAMERA = 3.2  # metres in front of the spine


class Look(NamedTuple):
    """Appearance of a figure; colours are RGB from 0 to 255.

    Attributes:
        skin: colour of the skin.
        hair: colour of the hair.
        shirt: colour of the shirt.
        background: colour behind the figure.
        build: factor of the width of the body, 1 for an average build.
        hair_length: 0 for short hair to 1 for long hair.
    """

    skin: Colour
    hair: Colour
    shirt: Colour
    background: Colour
    build: float = 1.0
    hair_length: float = 0.4


class Shape(NamedTuple):
    """A filled shape in T frames.

    Attributes:
        outline: (T, n, 2) corners in metres in the picture plane.
        colour: colour of the shape.
    """

    outline: np.ndarray
    colour: Colour


def project(points: np.ndarray) -> np.ndarray:
    """Project points (..., 3) to the picture plane (..., 2) for a camera that looks along +z; both are in metres."""
    return points[..., :2] * (_CAMERA / (_CAMERA + points[..., 2:]))


def capsules(
    starts: np.ndarray, ends: np.ndarray, wide: np.ndarray, narrow: np.ndarray, detail: int = 1
) -> list[np.ndarray]:
    """Build the outlines of n tapered capsules.

    Args:
        starts: (T, n, 3) first ends in metres.
        ends: (T, n, 3) second ends in metres.
        wide: (n,) radii at the first ends in metres.
        narrow: (n,) radii at the second ends in metres.
        detail: factor of the number of points.

    Returns:
        n outlines (T, 16 * detail + 2, 2).
    """
    arc = np.linspace(-np.pi / 2, np.pi / 2, 8 * detail + 1)
    first, last = project(starts), project(ends)
    wide = wide * _CAMERA / (_CAMERA + starts[..., 2])
    narrow = narrow * _CAMERA / (_CAMERA + ends[..., 2])
    along = last - first
    angle = np.arctan2(along[..., 1], along[..., 0])
    near, far = angle[..., None] + np.pi + arc, angle[..., None] + arc
    outline_near = first[..., None, :] + wide[..., None, None] * np.stack([np.cos(near), np.sin(near)], axis=-1)
    outline_far = last[..., None, :] + narrow[..., None, None] * np.stack([np.cos(far), np.sin(far)], axis=-1)
    return list(np.moveaxis(np.concatenate([outline_near, outline_far], axis=-2), -3, 0))


def smooth(outline: np.ndarray, detail: int = 1) -> np.ndarray:
    """Return a closed Catmull-Rom curve (T, 5 * n * detail, 2) through points (T, n, 2)."""
    u = (np.arange(5 * detail) / (5 * detail))[:, None]
    before, here, after, later = (np.roll(outline, shift, axis=-2)[..., None, :] for shift in (1, 0, -1, -2))
    curve = 2 * here + (after - before) * u + (2 * before - 5 * here + 4 * after - later) * u**2
    curve = 0.5 * (curve + (3 * here - before - 3 * after + later) * u**3)
    return curve.reshape(len(outline), -1, 2)


@functools.lru_cache(maxsize=8)
def backdrop(colour: Colour, width: int, height: int) -> Image.Image:
    """Return a background image of one colour that darkens towards the corners.

    Args:
        colour: colour in the centre.
        width: width in pixels.
        height: height in pixels.
    """
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


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return inner products (..., 1) of vectors (..., 3)."""
    return np.sum(a * b, axis=-1, keepdims=True)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) scaled to length 1."""
    return vectors / np.maximum(np.sqrt(dot(vectors, vectors)), 1e-8)


def facing(points: dict[str, np.ndarray]) -> np.ndarray:
    """Return the directions (T, 3) in which the trunk faces."""
    up, across = points["neck"] - points["spine"], points["left_shoulder"] - points["right_shoulder"]
    return unit(np.cross(across, up))

"""Pictures of figures side by side as the three planes of a video: brightness, and two of colour at half the size.

A picture in RGB that is converted afterwards costs more than everything else. So each outline is filled with its
brightness on a canvas of twice the size, which is then halved, as far as the figure reaches; and with its colour on
one of half the size, where the eye does not see the steps. The colours are those of BT.709, from black at 16 to white
at 235.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ha2g_jax.figure.outlines import outline
from ha2g_jax.figure.shapes import BOTTOM, TOP, Colour, Look, light_behind
from ha2g_jax.skeleton import Skeleton

_INK = (70, 74, 82)
_RED, _GREEN, _BLUE = 0.2126, 0.7152, 0.0722  # of BT.709


class Panel(NamedTuple):
    """The place of one figure in the picture: pixels, all even."""

    left: int
    top: int
    width: int
    height: int

    @property
    def scale(self) -> float:
        """Pixels in a metre: the figure is as tall as the panel, or less where the arms need the room."""
        return min(self.width, self.height) / (BOTTOM - TOP)

    @property
    def spine(self) -> np.ndarray:
        """(2,) where the spine is in the picture; what is spare lies above the figure."""
        return np.array([self.left + self.width / 2, self.top + self.height - BOTTOM * self.scale])


class Stage(NamedTuple):
    """What is the same in every picture.

    Attributes:
        panels: of the figures.
        background: its colour.
        clean: the picture without figures: planes (height, width) and twice (height / 2, width / 2), uint8.
        canvas: its brightness at twice the size.
    """

    panels: tuple[Panel, ...]
    background: Colour
    clean: tuple[np.ndarray, np.ndarray, np.ndarray]
    canvas: Image.Image


class Drawing(NamedTuple):
    """A figure in T frames of a video, ready for `paint`.

    Attributes:
        points: (T, N, 2) corners of all outlines in pixels of the picture.
        boxes: (T, 2, 2) upper left and lower right of what they cover of the panel, even.
        order: (T, S) outlines from back to front.
        spans: where each outline starts and ends among the 2 N numbers of a frame's points.
        shades: the brightness of each outline.
        inks: the colour of each outline as a place in `blues` and `reds`.
        blues, reds: 256 values of the planes of colour; at 0 those of the background.
    """

    points: np.ndarray
    boxes: np.ndarray
    order: np.ndarray
    spans: tuple[tuple[int, int], ...]
    shades: tuple[int, ...]
    inks: tuple[int, ...]
    blues: tuple[int, ...]
    reds: tuple[int, ...]


def panels(count: int, width: int, height: int) -> tuple[Panel, ...]:
    """Return a grid of places for figures, in rows from the left, with as many columns as make the figures largest."""
    columns = max(range(1, count + 1), key=lambda columns: min(width // columns, height // math.ceil(count / columns)))
    rows = math.ceil(count / columns)
    xs = [2 * (width * column // (2 * columns)) for column in range(columns + 1)]
    ys = [2 * (height * row // (2 * rows)) for row in range(rows + 1)]
    places = [(index % columns, index // columns) for index in range(count)]
    return tuple(Panel(xs[x], ys[y], xs[x + 1] - xs[x], ys[y + 1] - ys[y]) for x, y in places)


def set_stage(names: Sequence[str], background: Colour, width: int, height: int) -> Stage:
    """Return an empty stage for figures with names.

    Args:
        names: one a figure; an empty one is not written.
        background: its colour.
        width, height: of the picture in pixels, even.
    """
    places = panels(len(names), width, height)
    brightness, blue, red = to_yuv(background)
    backdrop = np.rint(16 + (brightness - 16) * light_behind(width, height)).astype(np.uint8)
    canvas = Image.fromarray(backdrop).resize((2 * width, 2 * height), Image.Resampling.NEAREST)
    for name, panel in zip(names, places, strict=True):
        _write_name(canvas, name, panel)
    blues, reds = (np.full((height // 2, width // 2), round(value), np.uint8) for value in (blue, red))
    return Stage(places, background, (np.asarray(canvas.reduce(2)), blues, reds), canvas)


def draw(stage: Stage, index: int, positions: np.ndarray, skeleton: Skeleton, look: Look) -> Drawing:
    """Return the figure in panel `index` for positions (T, joints, 3) in metres, y down."""
    panel = stage.panels[index]
    figure = outline(positions, skeleton, look, detail=2)
    colours = tuple(dict.fromkeys([stage.background, *figure.colours]))
    shades, blues, reds = zip(*([round(value) for value in to_yuv(colour)] for colour in colours), strict=True)
    inks = tuple(colours.index(colour) for colour in figure.colours)
    ends = (2 * figure.ends).tolist()
    unused = (0,) * (256 - len(colours))
    points = figure.points * panel.scale + panel.spine
    corners = np.stack([points.min(axis=1) // 2 * 2, points.max(axis=1) // 2 * 2 + 2], axis=1)
    boxes = np.clip(corners, panel[:2], np.add(panel[:2], panel[2:])).astype(int)
    return Drawing(
        points=points,
        boxes=boxes,
        order=figure.order,
        spans=tuple(itertools.pairwise(ends)),
        shades=tuple(shades[ink] for ink in inks),
        inks=inks,
        blues=blues + unused,
        reds=reds + unused,
    )


def paint(stage: Stage, drawings: Sequence[Drawing], frame: int, planes: Sequence[np.ndarray]) -> None:
    """Fill the three planes of a picture, of the shapes of `Stage.clean`."""
    for plane, clean in zip(planes, stage.clean, strict=True):
        plane[:] = clean
    for drawing in drawings:
        (left, top), (right, bottom) = drawing.boxes[frame].tolist()
        if left == right or top == bottom:
            continue
        points = drawing.points[frame] - (left, top)
        order = drawing.order[frame].tolist()
        brightness = stage.canvas.crop((2 * left, 2 * top, 2 * right, 2 * bottom))
        _fill(brightness, 2 * points, order, drawing.spans, drawing.shades)
        planes[0][top:bottom, left:right] = np.asarray(brightness.reduce(2))
        colour = Image.new("L", ((right - left) // 2, (bottom - top) // 2))
        _fill(colour, points / 2, order, drawing.spans, drawing.inks)
        for plane, table in zip(planes[1:], (drawing.blues, drawing.reds), strict=True):
            plane[top // 2 : bottom // 2, left // 2 : right // 2] = np.asarray(colour.point(table))


def to_yuv(colour: Colour) -> tuple[float, float, float]:
    """Brightness, blue and red of BT.709 as a video has them: 16 to 235, and 16 to 240 with grey at 128."""
    red, green, blue = (channel / 255 for channel in colour)
    luma = _RED * red + _GREEN * green + _BLUE * blue
    return 16 + 219 * luma, 128 + 112 * (blue - luma) / (1 - _BLUE), 128 + 112 * (red - luma) / (1 - _RED)


def _fill(
    canvas: Image.Image,
    points: np.ndarray,
    order: Sequence[int],
    spans: Sequence[tuple[int, int]],
    values: Sequence[int],
) -> None:
    corners = points.ravel().tolist()
    pen = ImageDraw.Draw(canvas)
    for shape in order:
        start, end = spans[shape]
        pen.polygon(corners[start:end], fill=values[shape])


def _write_name(canvas: Image.Image, name: str, panel: Panel) -> None:
    """Return the name in the upper left corner of its panel, where the figure seldom is, on a canvas of twice the size."""
    if not name:
        return
    side = 2 * min(panel.width, panel.height)
    room = 2 * panel.width - side / 12
    share = min(1.0, room / ImageFont.load_default(side / 18).getlength(name))
    font = ImageFont.load_default(share * side / 18)
    place = 2 * panel.left + side / 24, 2 * panel.top + side / 24
    ImageDraw.Draw(canvas).text(place, name, fill=round(to_yuv(_INK)[0]), font=font, anchor="lt")

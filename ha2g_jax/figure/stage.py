"""Images of figures side by side as the three planes of a video: brightness, and two planes of colour at half the size.

The conversion of an RGB image would take more time than everything else. So the brightness of each outline is drawn on
a canvas of twice the size, which is then reduced to half within the bounds of the figure, and its colour on a canvas
of half the size, where the eye does not see the missing antialiasing. The colours are those of BT.709, from black at
16 to white at 235.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from ha2g_jax.figure import DEFAULT_VIEW, View, outline
from ha2g_jax.figure.lettering import font_for
from ha2g_jax.figure.shapes import Colour, Look, light_behind
from ha2g_jax.skeleton import Skeleton

_INK = (70, 74, 82)
_STRIP = 0.018  # half of the height of the strip for names, as a fraction of the smaller side of the image
_NAME_SCALES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)  # factors of the size of a name; the first that fits its panel is used
_RED, _GREEN, _BLUE = 0.2126, 0.7152, 0.0722  # weights of BT.709


class Panel(NamedTuple):
    """The rectangle of one figure in the image, in even numbers of pixels."""

    left: int
    top: int
    width: int
    height: int


class Stage(NamedTuple):
    """The part of an image that does not change: its uint8 planes, and its brightness `canvas` at twice the size."""

    panels: tuple[Panel, ...]
    background: Colour
    clean: tuple[np.ndarray, np.ndarray, np.ndarray]
    canvas: Image.Image


class Drawing(NamedTuple):
    """A figure in T frames of a video, prepared for `paint`.

    Attributes:
        points: (T, N, 2) corners of all outlines in pixels of the image.
        boxes: (T, 2, 2) upper left and lower right corner of the figure in its panel, in even numbers of pixels.
        order: (T, S) indices of the outlines from back to front.
        spans: start and end of each outline in the 2 N coordinates of a frame.
        shades: brightness of each outline.
        inks: colour of each outline as an index of `blues` and `reds`.
        blues, reds: 256 values of the blue and of the red plane; the first is that of the background.
    """

    points: np.ndarray
    boxes: np.ndarray
    order: np.ndarray
    spans: tuple[tuple[int, int], ...]
    shades: tuple[int, ...]
    inks: tuple[int, ...]
    blues: tuple[int, ...]
    reds: tuple[int, ...]


def panels(count: int, width: int, height: int, shape: float = 1.0, strip: int = 0) -> tuple[Panel, ...]:
    """Divide an image into panels in rows from the left, with the number of columns that makes the figures largest.

    Args:
        shape: width of the view of a figure, divided by its height.
        strip: pixels above each panel, for its name.
    """
    columns = max(
        range(1, count + 1),
        key=lambda columns: min(width / columns / shape, height / math.ceil(count / columns) - strip),
    )
    rows = math.ceil(count / columns)
    xs = [2 * (width * column // (2 * columns)) for column in range(columns + 1)]
    ys = [2 * (height * row // (2 * rows)) for row in range(rows + 1)]
    places = [(index % columns, index // columns) for index in range(count)]
    return tuple(Panel(xs[x], ys[y] + strip, xs[x + 1] - xs[x], ys[y + 1] - ys[y] - strip) for x, y in places)


def set_stage(names: Sequence[str], background: Colour, width: int, height: int, views: Sequence[View]) -> Stage:
    """Prepare the image without figures, with a panel for each name, "" for a figure without one.

    The size of the views, which is the same for all, decides how many panels are side by side. A name is a line above
    its figure.
    """
    strip = 2 * round(_STRIP * min(width, height)) if any(names) else 0
    shape = (views[0].right - views[0].left) / (views[0].bottom - views[0].top)
    places = panels(len(names), width, height, shape, strip)
    brightness, blue, red = to_yuv(background)
    backdrop = np.rint(16 + (brightness - 16) * light_behind(width, height)).astype(np.uint8)
    canvas = Image.fromarray(backdrop).resize((2 * width, 2 * height), Image.Resampling.NEAREST)
    for name, panel, view in zip(names, places, views, strict=True):
        _write_name(canvas, name, panel, view, strip)
    blues, reds = (np.full((height // 2, width // 2), round(value), np.uint8) for value in (blue, red))
    return Stage(places, background, (np.asarray(canvas.reduce(2)), blues, reds), canvas)


def draw(
    stage: Stage, index: int, positions: np.ndarray, skeleton: Skeleton, look: Look, view: View = DEFAULT_VIEW
) -> Drawing:
    """Prepare the drawing of a figure with positions (T, joints, 3) in metres; its panel shows at least the view."""
    panel = stage.panels[index]
    figure = outline(positions, skeleton, look, detail=2)
    colours = tuple(dict.fromkeys([stage.background, *figure.colours]))
    shades, blues, reds = zip(*([round(value) for value in to_yuv(colour)] for colour in colours), strict=True)
    inks = tuple(colours.index(colour) for colour in figure.colours)
    ends = (2 * figure.ends).tolist()
    unused = (0,) * (256 - len(colours))
    scale, spine = view.place(panel.width, panel.height)
    points = figure.points * scale + np.add(spine, panel[:2])
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
    """Paint one frame of figures into uint8 planes of the shapes of `Stage.clean`, which are overwritten."""
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
    """Convert an RGB colour to brightness (16 to 235), blue and red (16 to 240, grey at 128) of BT.709."""
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


def _write_name(canvas: Image.Image, name: str, panel: Panel, view: View, strip: int) -> None:
    """Write a name into the strip above the view in its panel, a long one smaller."""
    if not name:
        return
    scale, spine = view.place(panel.width, panel.height)
    x, y = 2 * (panel.left + spine[0]), 2 * (panel.top + spine[1] + view.top * scale) - strip
    width = 4 * min(spine[0], panel.width - spine[0]) - strip
    fonts = (font_for(name, scale * 1.2 * strip) for scale in _NAME_SCALES)
    font = next((font for font in fonts if font.getlength(name) <= width), None)
    if font is None:
        font = font_for(name, _NAME_SCALES[-1] * 1.2 * strip)
        while font.getlength(name) > width:
            name = name[:-1]
    ImageDraw.Draw(canvas).text((x, y), name, fill=round(to_yuv(_INK)[0]), font=font, anchor="mm")

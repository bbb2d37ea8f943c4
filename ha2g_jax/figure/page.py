"""Pages of small images of figures with text, as PNG or SVG."""

import html
import io
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ha2g_jax.figure import draw_figure
from ha2g_jax.figure.outlines import outline
from ha2g_jax.figure.shapes import Colour, Look, shade
from ha2g_jax.figure.view import View
from ha2g_jax.skeleton import Skeleton

_PAPER = (255, 255, 255)


class Picture(NamedTuple):
    """One pose in a square.

    Attributes:
        x: left edge in pixels from the left of the page.
        y: upper edge in pixels from the top of the page.
        size: side in pixels.
        positions: (joints, 3) metres, y down.
        skeleton: skeleton of the positions.
        look: colours and build of the figure.
        view: part of the picture plane that the square shows at least.
    """

    x: int
    y: int
    size: int
    positions: np.ndarray
    skeleton: Skeleton
    look: Look
    view: View


class Text(NamedTuple):
    """One line of words.

    Attributes:
        x: pixels from the left of the page to the start or the middle of the line.
        y: pixels from the top of the page to the baseline.
        words: each word with its colour.
        size: size of the font in pixels.
        anchor: which point of the line is at `x`.
    """

    x: float
    y: float
    words: tuple[tuple[str, Colour], ...]
    size: float
    anchor: Literal["start", "middle"] = "start"


class Page(NamedTuple):
    """The content of a page.

    Attributes:
        width: width in pixels.
        height: height in pixels.
        pictures: images of figures.
        texts: lines of words.
    """

    width: int
    height: int
    pictures: tuple[Picture, ...]
    texts: tuple[Text, ...]


def text_width(text: str, size: float) -> float:
    """Return the width of a text in pixels, as `as_png` writes it.

    Args:
        text: text in one line.
        size: size of the font in pixels.
    """
    return ImageFont.load_default(size).getlength(text)


def as_png(page: Page) -> bytes:
    """Draw a page as a PNG.

    Args:
        page: content of the page.

    Returns:
        Bytes of the file.
    """
    image = Image.new("RGB", (page.width, page.height), _PAPER)
    for picture in page.pictures:
        size = picture.size
        pixels = draw_figure(picture.positions, picture.skeleton, picture.look, size, size, picture.view)
        image.paste(Image.fromarray(pixels), (picture.x, picture.y))
    pen = ImageDraw.Draw(image)
    for text in page.texts:
        font = ImageFont.load_default(text.size)
        width = font.getlength(" ".join(word for word, _ in text.words))
        x = text.x - width / 2 if text.anchor == "middle" else text.x
        for word, colour in text.words:
            pen.text((x, text.y), word, fill=colour, font=font, anchor="ls")
            x += font.getlength(f"{word} ")
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def as_svg(page: Page) -> str:
    """Draw a page as an SVG document whose texts remain texts.

    Args:
        page: content of the page.

    Returns:
        Text of the document.
    """
    return "\n".join(_svg_lines(page)) + "\n"


def _svg_lines(page: Page) -> Iterator[str]:
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width}" height="{page.height}" '
        f'viewBox="0 0 {page.width} {page.height}" font-family="Helvetica, Arial, sans-serif">'
    )
    yield f'<rect width="100%" height="100%" fill="{_hex(_PAPER)}"/>'
    backgrounds = list(dict.fromkeys(picture.look.background for picture in page.pictures))
    for index, background in enumerate(backgrounds):  # approximates `shapes.backdrop`
        yield f'<radialGradient id="light{index}" cx="50%" cy="37.5%" r="75%">'
        for offset, light in ((0, 1.05), (0.5, 1.0), (1, 0.85)):
            yield f'<stop offset="{offset}" stop-color="{_hex(shade(background, light))}"/>'
        yield "</radialGradient>"
    for picture in page.pictures:
        yield from _svg_picture(picture, backgrounds.index(picture.look.background))
    for text in page.texts:
        place = f'x="{text.x:.1f}" y="{text.y:.1f}" font-size="{text.size:g}" text-anchor="{text.anchor}"'
        words = (f'<tspan fill="{_hex(colour)}">{html.escape(word)}</tspan>' for word, colour in text.words)
        yield f"<text {place}>{' '.join(words)}</text>"
    yield "</svg>"


def _svg_picture(picture: Picture, light: int) -> Iterator[str]:
    figure = outline(picture.positions[None], picture.skeleton, picture.look, detail=2)
    scale, spine = picture.view.place(picture.size, picture.size)
    points = figure.points[0] * scale + spine
    yield f'<svg x="{picture.x}" y="{picture.y}" width="{picture.size}" height="{picture.size}">'
    yield f'<rect width="100%" height="100%" fill="url(#light{light})"/>'
    for shape in figure.order[0].tolist():
        corners = points[figure.ends[shape] : figure.ends[shape + 1]]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners.tolist())
        yield f'<polygon points="{path}" fill="{_hex(figure.colours[shape])}"/>'
    yield "</svg>"


def _hex(colour: Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)

"""Drawing of a posed upper body from the front, for the portraits of Talk and the videos of generated motion.

Everything is a filled shape on a canvas of twice the size, which is then reduced to half for antialiasing.
"""

import numpy as np
from PIL import Image, ImageDraw

from ha2g_jax.figure.outlines import outline
from ha2g_jax.figure.shapes import Colour, Look, backdrop
from ha2g_jax.figure.view import DEFAULT_VIEW, View, fit
from ha2g_jax.skeleton import Skeleton

__all__ = ["DEFAULT_LOOK", "DEFAULT_VIEW", "Colour", "Look", "View", "draw_figure", "fit"]

DEFAULT_LOOK = Look((232, 190, 160), (74, 52, 42), (62, 110, 158), (232, 234, 238))

_SUPERSAMPLE = 2
_LARGE = 400  # pixels from which curves need more points


def draw_figure(
    positions: np.ndarray, skeleton: Skeleton, look: Look, width: int, height: int, view: View = DEFAULT_VIEW
) -> np.ndarray:
    """Draw one pose.

    Args:
        positions: (joints, 3) metres, y down; the root may be anywhere.
        skeleton: skeleton of the positions; fingers and ears are drawn where it has them.
        look: colours and build of the figure.
        width: width of the image in pixels.
        height: height of the image in pixels.
        view: part of the picture plane that the image shows at least; `fit` finds it for a motion.

    Returns:
        (height, width, 3) uint8 RGB image.
    """
    figure = outline(positions[None], skeleton, look, detail=1 if height < _LARGE else 2)
    scale, spine = view.place(_SUPERSAMPLE * width, _SUPERSAMPLE * height)
    corners = (figure.points[0] * scale + spine).ravel().tolist()
    image: Image.Image = backdrop(look.background, _SUPERSAMPLE * width, _SUPERSAMPLE * height).copy()
    canvas = ImageDraw.Draw(image)
    for shape in figure.order[0]:
        start, end = figure.ends[shape : shape + 2]
        canvas.polygon(corners[2 * start : 2 * end], fill=figure.colours[shape])
    return np.asarray(image.reduce(_SUPERSAMPLE))

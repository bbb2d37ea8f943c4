"""Drawing of a posed upper body, seen from the front: the portraits of Talk and the videos of generated motion.

Everything is a filled shape on a canvas of twice the size, which is then halved; that is the antialiasing.
"""

import numpy as np
from PIL import Image, ImageDraw

from ha2g_jax.figure.body import arm_shapes, hand_shapes, torso_shapes
from ha2g_jax.figure.face import hair_behind, head_frame, head_shapes
from ha2g_jax.figure.shapes import Colour, Look, Shape, backdrop
from ha2g_jax.skeleton import Skeleton

__all__ = ["DEFAULT_LOOK", "Colour", "Look", "draw_figure"]

DEFAULT_LOOK = Look((232, 190, 160), (74, 52, 42), (62, 110, 158), (232, 234, 238))

_SUPERSAMPLE = 2
_TOP, _BOTTOM = -0.70, 0.42  # metres above and below the spine that the picture shows


def draw_figure(positions: np.ndarray, skeleton: Skeleton, look: Look, width: int, height: int) -> np.ndarray:
    """A picture of one pose.

    Args:
        positions: (joints, 3) metres, y down; the root may be anywhere.
        skeleton: names the joints; fingers and ears are drawn where it has them.
        look: colours and build.
        width, height: size of the picture in pixels.

    Returns:
        (height, width, 3) uint8.
    """
    points = _from_the_front(positions, skeleton)
    scale = _SUPERSAMPLE * height / (_BOTTOM - _TOP)
    centre = np.array([_SUPERSAMPLE * width / 2, -_TOP * scale])
    image: Image.Image = backdrop(look.background, _SUPERSAMPLE * width, _SUPERSAMPLE * height).copy()
    canvas = ImageDraw.Draw(image)
    for shape in _body(points, look):
        canvas.polygon((shape.outline * scale + centre).ravel().tolist(), fill=shape.colour)
    return np.asarray(image.reduce(_SUPERSAMPLE))


def _from_the_front(positions: np.ndarray, skeleton: Skeleton) -> dict[str, np.ndarray]:
    """Joints by name, spine at the origin, turned so that the person faces -z and has the left at +x."""
    mean = skeleton.mean_pose
    turned = mean[skeleton.joint("left_shoulder"), 0] < mean[skeleton.joint("right_shoulder"), 0]
    sign = np.array([-1.0, 1.0, -1.0]) if turned else np.ones(3)
    centred = (positions - positions[0]) * sign
    return dict(zip(skeleton.joints, centred, strict=True))


def _body(points: dict[str, np.ndarray], look: Look) -> list[Shape]:
    """All shapes, from back to front."""
    head = head_frame(points)
    shapes = [*hair_behind(head, look), *torso_shapes(points, look), *head_shapes(points, head, look)]
    for side in sorted(("left", "right"), key=lambda side: -float(points[f"{side}_wrist"][2])):
        shapes += [*arm_shapes(points, side, look), *hand_shapes(points, side, look)]
    return shapes

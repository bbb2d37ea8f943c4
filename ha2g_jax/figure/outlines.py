"""Outlines of a moving figure, and the order in which they are drawn."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.body import arm_shapes, hand_parts, torso_shapes
from ha2g_jax.figure.face import hair_behind, head_frame, head_shapes
from ha2g_jax.figure.shapes import Colour, Look
from ha2g_jax.skeleton import Skeleton


class Outlines(NamedTuple):
    """A figure in T frames as S filled outlines.

    Attributes:
        points: (T, N, 2) corners of all outlines in metres in the picture plane, from the spine: x to the right of the
            image, y down.
        ends: (S + 1,) indices; the corners of outline s are `points[:, ends[s] : ends[s + 1]]`.
        colours: colour of each outline.
        order: (T, S) indices of the outlines from back to front.
    """

    points: np.ndarray
    ends: np.ndarray
    colours: tuple[Colour, ...]
    order: np.ndarray


def outline(positions: np.ndarray, skeleton: Skeleton, look: Look, detail: int = 1) -> Outlines:
    """Compute the outlines of a figure in T poses from the front.

    Args:
        positions: (T, joints, 3) metres, y down; the root may be anywhere.
        skeleton: skeleton of the positions; fingers and ears are drawn where it has them.
        look: colours and build of the figure.
        detail: factor of the number of points of a curve; 1 suffices for images of a few hundred pixels.

    Returns:
        The outlines.
    """
    points = _from_the_front(positions, skeleton)
    head = head_frame(points)
    shapes = [*hair_behind(head, look, detail), *torso_shapes(points, look)]
    shapes += head_shapes(points, head, look, detail)
    trunk = np.zeros(len(positions))
    # Sort keys: the trunk first, then the farther arm with its hand, and in a hand the farther fingers first.
    keys = [(trunk, trunk, trunk, trunk)] * len(shapes)
    for index, side in enumerate(("left", "right"), start=1):
        distance, arm = -points[f"{side}_wrist"][:, 2], arm_shapes(points, side, look, detail)
        # Where both arms are equally far, the index of the arm keeps their outlines apart.
        keys += [(trunk + 1, distance, trunk + index, trunk - np.inf)] * len(arm)
        shapes += arm
        for part in hand_parts(points, side, look, detail):
            keys += [(trunk + 1, distance, trunk + index, -part.depth)] * len(part.shapes)
            shapes += part.shapes
    columns = [np.stack([key[level] for key in keys]) for level in (3, 2, 1, 0)]
    corners = [shape.outline for shape in shapes]
    return Outlines(
        points=np.concatenate(corners, axis=1),
        ends=np.cumsum([0, *(corner.shape[1] for corner in corners)]),
        colours=tuple(shape.colour for shape in shapes),
        order=np.lexsort(columns, axis=0).T,
    )


def _from_the_front(positions: np.ndarray, skeleton: Skeleton) -> dict[str, np.ndarray]:
    """Return joints (T, 3) by name with the spine at the origin, in axes in which the person faces -z, left at +x."""
    mean = skeleton.mean_pose
    is_reversed = mean[skeleton.joint("left_shoulder"), 0] < mean[skeleton.joint("right_shoulder"), 0]
    sign = np.array([-1.0, 1.0, -1.0]) if is_reversed else np.ones(3)
    centred = (positions - positions[:, :1]) * sign
    return dict(zip(skeleton.joints, np.moveaxis(centred, 1, 0), strict=True))

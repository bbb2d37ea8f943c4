"""All outlines of a figure that moves, and the order in which they are drawn."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.body import arm_shapes, hand_parts, torso_shapes
from ha2g_jax.figure.face import hair_behind, head_frame, head_shapes
from ha2g_jax.figure.shapes import Colour, Look
from ha2g_jax.skeleton import Skeleton


class Outlines(NamedTuple):
    """A figure in T frames as S filled outlines.

    Attributes:
        points: (T, N, 2) corners of all outlines, in metres of the picture plane from the spine: x to the right of
            the picture, y down.
        ends: (S + 1,) the corners of outline s are `points[:, ends[s] : ends[s + 1]]`.
        colours: of each outline.
        order: (T, S) outlines from back to front.
    """

    points: np.ndarray
    ends: np.ndarray
    colours: tuple[Colour, ...]
    order: np.ndarray


def outline(positions: np.ndarray, skeleton: Skeleton, look: Look, detail: int = 1) -> Outlines:
    """Return the outlines of a figure in many poses, seen from the front.

    Args:
        positions: (T, joints, 3) metres, y down; the root may be anywhere.
        skeleton: names the joints; fingers and ears are drawn where it has them.
        look: colours and build.
        detail: 1 for pictures of a few hundred pixels, more for rounder curves.
    """
    points = _from_the_front(positions, skeleton)
    head = head_frame(points)
    shapes = [*hair_behind(head, look, detail), *torso_shapes(points, look)]
    shapes += head_shapes(points, head, look, detail)
    trunk = np.zeros(len(positions))
    # What each outline is sorted by: first the trunk, then the farther arm with its hand, the farther fingers first.
    keys = [(trunk, trunk, trunk, trunk)] * len(shapes)
    for index, side in enumerate(("left", "right"), start=1):
        distance, arm = -points[f"{side}_wrist"][:, 2], arm_shapes(points, side, look, detail)
        # An arm as far as the other comes second: a key of its own keeps the two apart.
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
    """Return joints (T, 3) by name, spine at the origin, turned so that the person faces -z and has the left at +x."""
    mean = skeleton.mean_pose
    turned = mean[skeleton.joint("left_shoulder"), 0] < mean[skeleton.joint("right_shoulder"), 0]
    sign = np.array([-1.0, 1.0, -1.0]) if turned else np.ones(3)
    centred = (positions - positions[:, :1]) * sign
    return dict(zip(skeleton.joints, np.moveaxis(centred, 1, 0), strict=True))

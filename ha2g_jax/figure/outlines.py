"""Outlines of a moving figure, and the order in which they are drawn."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.arms import arm_shapes
from ha2g_jax.figure.face import hair_behind, head_frame, head_shapes
from ha2g_jax.figure.hands import hand_parts
from ha2g_jax.figure.order import arm_ranks
from ha2g_jax.figure.shapes import Colour, Look, Part
from ha2g_jax.figure.trunk import trunk_shapes
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
    points = from_the_front(positions, skeleton)
    head = head_frame(points)
    trunk = trunk_shapes(points, look, detail)
    sides = ("left", "right")
    arms = [arm_shapes(points, side, look, detail) for side in sides]
    shoulders = [shape for arm in arms for shape in arm.shoulder]
    body = (hair_behind(head, look, detail), trunk, head_shapes(points, head, look, detail))
    keys = (-9.0, -0.8, -0.7, -0.6)
    parts = [Part(np.full(len(positions), key), shapes) for key, shapes in zip(keys, (shoulders, *body), strict=True)]
    for side, arm, ranks in zip(sides, arms, arm_ranks(points, head[0]), strict=True):
        parts += [Part(np.minimum(ranks.upper, ranks.lower) - 0.1, arm.edges)]
        parts += [Part(ranks.upper, arm.upper), Part(ranks.lower, arm.lower)]
        for part in hand_parts(points, side, look, detail):
            parts.append(Part(ranks.lower + 0.3 - np.clip(part.key, -2, 2) / 10, part.shapes))
    shapes = [shape for part in parts for shape in part.shapes]
    keys = np.repeat(np.stack([part.key for part in parts], axis=1), [len(part.shapes) for part in parts], axis=1)
    corners = [shape.outline for shape in shapes]
    return Outlines(
        points=np.concatenate(corners, axis=1),
        ends=np.cumsum([0, *(corner.shape[1] for corner in corners)]),
        colours=tuple(shape.colour for shape in shapes),
        order=np.argsort(keys, axis=1, kind="stable"),
    )


def from_the_front(positions: np.ndarray, skeleton: Skeleton) -> dict[str, np.ndarray]:
    """Return joints (T, 3) by name with the spine at the origin, in axes in which the person faces -z, left at +x."""
    mean = skeleton.mean_pose
    is_reversed = mean[skeleton.joint("left_shoulder"), 0] < mean[skeleton.joint("right_shoulder"), 0]
    sign = np.array([-1.0, 1.0, -1.0]) if is_reversed else np.ones(3)
    centred = (positions - positions[:, :1]) * sign
    return dict(zip(skeleton.joints, np.moveaxis(centred, 1, 0), strict=True))

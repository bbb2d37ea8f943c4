"""The part of the picture plane that an image shows."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.face import head_frame
from ha2g_jax.figure.outlines import from_the_front
from ha2g_jax.figure.shapes import enlarged, project
from ha2g_jax.skeleton import Skeleton

_MARGIN = 0.04  # metres between the figure and the edge of the image
_LIMB = 0.06  # metres of a limb around its joints, with the tips of the fingers
_HEAD = 0.18  # metres of the head around its centre
_MITTEN = 0.11  # metres from the wrist to the last joint of a hand without fingers
_KNEES = 0.95  # metres below the spine to which the legs are drawn in most poses
_PIECE = 2048  # frames that are projected at a time


class View(NamedTuple):
    """A rectangle of the picture plane in metres from the spine, y down.

    Attributes:
        left: smallest x.
        top: smallest y.
        right: largest x.
        bottom: largest y.
    """

    left: float
    top: float
    right: float
    bottom: float

    def place(self, width: float, height: float) -> tuple[float, np.ndarray]:
        """Place the view in an image as large as it fits, in the middle; the legs use half of the unused height.

        Args:
            width: width of the image in pixels.
            height: height of the image in pixels.

        Returns:
            Pixels per metre, and the (2,) position of the spine in pixels.
        """
        scale = min(width / (self.right - self.left), height / (self.bottom - self.top))
        unused = height / scale - (self.bottom - self.top)
        bottom = max(self.bottom, min(self.bottom + unused / 2, _KNEES))
        middle = (self.left + self.right) / 2
        return scale, np.array([width / 2 - middle * scale, height - bottom * scale])


DEFAULT_VIEW = View(-0.56, -0.70, 0.56, 0.42)


def fit(motions: Iterable[tuple[np.ndarray, Skeleton]]) -> View:
    """Find the smallest view that contains the default view, and all figures in all their poses with a margin.

    Args:
        motions: (T, joints, 3) positions in metres, y down, and the skeleton of each figure.

    Returns:
        The view.
    """
    low, high = np.array(DEFAULT_VIEW[:2]), np.array(DEFAULT_VIEW[2:])
    for positions, skeleton in motions:
        for start in range(0, len(positions), _PIECE):
            corners = _corners(from_the_front(positions[start : start + _PIECE], skeleton))
            low = np.minimum(low, corners.min(axis=(0, 1)) - _MARGIN)
            high = np.maximum(high, corners.max(axis=(0, 1)) + _MARGIN)
    return View(*low.tolist(), *high.tolist())


def _corners(points: dict[str, np.ndarray]) -> np.ndarray:
    """Return the corners (T, n, 2) of squares around joints, hands and head."""
    centres = list(points.values())
    for side in ("left", "right"):
        if f"{side}_index_1" not in points:
            wrist, elbow = points[f"{side}_wrist"], points[f"{side}_elbow"]
            length = np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
            centres.append(wrist + _MITTEN / np.maximum(length, 1e-8) * (wrist - elbow))
    radii = np.array([_LIMB] * len(centres) + [_HEAD])
    discs = np.stack([*centres, head_frame(points)[0]], axis=1)
    places, reach = project(discs), (radii * enlarged(discs[..., 2]))[..., None]
    return np.concatenate([places - reach, places + reach], axis=1)

"""Closed smooth surfaces made of rings of points, with the influence of the joints on each point."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.motion.rotations import unit

_CAP_ANGLES = np.deg2rad([25.0, 50.0, 70.0])
_MAX_JOINTS = 4  # joints that may move a point in the first set of glTF
_MIN_WEIGHT = 1e-4


class Surface(NamedTuple):
    """A surface of triangles.

    Attributes:
        points: (n, 3) metres.
        normals: (n, 3) unit vectors.
        faces: (m, 3) indices of the corners of each triangle, anticlockwise from outside.
        influence: (n, J) weight of each joint in the movement of a point; each row sums to 1.
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    influence: np.ndarray

    @property
    def bindings(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 4) indices of the joints with the most influence on a point, and their (n, 4) weights, with sum 1."""
        joints = np.argsort(-self.influence, axis=1, kind="stable")[:, :_MAX_JOINTS]
        weights = np.take_along_axis(self.influence, joints, axis=1)
        weights = np.where(weights < _MIN_WEIGHT, 0, weights)
        weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
        # glTF requires joint 0 where the weight is 0.
        return np.where(weights > 0, joints, 0), weights


def loft(
    centres: np.ndarray,
    across: np.ndarray,
    ahead: np.ndarray,
    radii: np.ndarray,
    influence: np.ndarray,
    *,
    sides: int = 20,
    squareness: float = 2.0,
    caps: tuple[float, float] = (1.0, 1.0),
) -> Surface:
    """Build a surface over rings, closed at both ends.

    Args:
        centres: (R, 3) metres.
        across: (R, 3) or (3,) unit vectors of the first axis of the rings.
        ahead: (R, 3) or (3,) unit vectors of the second axis; the rings follow each other along `ahead` x `across`.
        radii: (R, 2) half-widths along the two axes in metres.
        influence: (R, J) influence of the joints on each ring, or (R, sides, J) on each point.
        squareness: exponent of the superellipse of a ring: 2 for an ellipse, more for a rounded rectangle.
        caps: height of the caps at both ends in radii; 1 for half spheres.
    """
    across, ahead = np.broadcast_to(across, centres.shape), np.broadcast_to(ahead, centres.shape)
    influence = influence if influence.ndim == 3 else np.repeat(influence[:, None], sides, axis=1)
    first, last = _cap(centres, across, ahead, radii, 0, caps[0]), _cap(centres, across, ahead, radii, -1, caps[1])
    counts = [len(first[0]), len(last[0])]
    centres = np.concatenate([first[0][::-1], centres, last[0]])
    radii = np.concatenate([first[1][::-1], radii, last[1]])
    across, ahead, influence = (_extend(values, counts) for values in (across, ahead, influence))
    angles = 2 * np.pi * np.arange(sides) / sides
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rim = np.sign(rim) * np.abs(rim) ** (2 / squareness)
    wide = radii[:, None] * rim
    rings = centres[:, None] + wide[..., :1] * across[:, None] + wide[..., 1:] * ahead[:, None]
    poles = np.stack([first[2], last[2]])
    points = np.concatenate([rings.reshape(-1, 3), poles])
    influence = np.concatenate([influence.reshape(-1, influence.shape[-1]), influence[[0, -1]].mean(axis=1)])
    return with_normals(points, _faces(len(rings), sides), influence)


def tube(
    path: np.ndarray,
    radii: np.ndarray,
    influence: np.ndarray,
    reference: np.ndarray,
    **options: int | float | tuple[float, float],
) -> Surface:
    """Build a loft along a path (R, 3), with rings at right angles to it; the options are those of `loft`.

    Args:
        radii: (R,) radii or (R, 2) half-widths of the rings in metres.
        reference: (3,) vector that is not parallel to the path; the first axis of the rings is at right angles to it.
    """
    along = unit(np.gradient(path, axis=0))
    across = unit(np.cross(along, reference))
    ahead = np.cross(across, along)
    radii = radii if radii.ndim == 2 else np.stack([radii, radii], axis=-1)
    return loft(path, across, ahead, radii, influence, **options)  # type: ignore[arg-type]


def ellipsoid(centre: np.ndarray, radii: Sequence[float], influence: np.ndarray) -> Surface:
    """Build an ellipsoid with half-lengths `radii` along x, y and z."""
    x, y, z = np.eye(3)
    height = np.linspace(-0.8, 0.8, 9)
    width = np.sqrt(1 - height**2)
    centres = centre + radii[1] * height[:, None] * y
    rings = np.stack([radii[0] * width, radii[2] * width], axis=-1)
    tall = float(radii[1] * 0.2 / rings[0, 0])
    return loft(centres, x, z, rings, np.tile(influence, (len(centres), 1)), sides=14, caps=(tall, tall))


def with_normals(points: np.ndarray, faces: np.ndarray, influence: np.ndarray) -> Surface:
    """Return a surface whose normals are the means of those of the faces around a point, weighted by area."""
    corners = points[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    np.add.at(normals, faces, areas[:, None])
    return Surface(points, unit(normals), faces, influence)


def join(surfaces: Sequence[Surface]) -> Surface:
    """Join several surfaces to one."""
    starts = np.cumsum([0, *(len(surface.points) for surface in surfaces[:-1])])
    faces = [surface.faces + start for surface, start in zip(surfaces, starts)]
    points, normals, _, influence = (np.concatenate(parts) for parts in zip(*surfaces))
    return Surface(points, normals, np.concatenate(faces), influence)


def _cap(
    centres: np.ndarray, across: np.ndarray, ahead: np.ndarray, radii: np.ndarray, end: int, bulge: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rings that close an end: (3, 3) centres, (3, 2) radii and the (3,) pole."""
    out = np.cross(ahead[end], across[end]) * (1 if end else -1)
    height = bulge * radii[end].mean()
    rings = centres[end] + height * np.sin(_CAP_ANGLES)[:, None] * out
    return rings, radii[end] * np.cos(_CAP_ANGLES)[:, None], centres[end] + height * out


def _extend(values: np.ndarray, counts: Sequence[int]) -> np.ndarray:
    """Repeat the first entry before and the last entry after an array, each as often as counted."""
    return np.concatenate([np.repeat(values[:1], counts[0], axis=0), values, np.repeat(values[-1:], counts[1], axis=0)])


def _faces(rings: int, sides: int) -> np.ndarray:
    ring, side = (grid.ravel() for grid in np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij"))
    after = (side + 1) % sides
    a, b, c, d = ring * sides + side, ring * sides + after, (ring + 1) * sides + side, (ring + 1) * sides + after
    first, second, last = np.arange(sides), np.arange(1, sides + 1) % sides, (rings - 1) * sides
    pole = np.full(sides, rings * sides)
    triangles = [(a, c, b), (b, c, d), (pole, first, second), (pole + 1, last + second, last + first)]
    return np.concatenate([np.stack(corners, axis=-1) for corners in triangles])

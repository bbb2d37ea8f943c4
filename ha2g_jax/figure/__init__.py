"""Drawing of a posed upper body from the front, for the portraits of Talk and the videos of generated motion.

Everything is a filled shape on a canvas of twice the size, which is then reduced to half for antialiasing.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from ha2g_jax.errors import UserError
from ha2g_jax.figure.person import (
    arm_shapes,
    back_of_head,
    face_features,
    hair_behind,
    hand_parts,
    head_frame,
    head_shapes,
    trunk_shapes,
)
from ha2g_jax.figure.shapes import Colour, Look, Part, backdrop, enlarged, project
from ha2g_jax.skeleton import Skeleton

_REACH = 0.05  # metres in the picture plane within which two limbs overlap
_CLEAR = 0.03  # metres; with a larger difference of depths the order is certain
_BEHIND = 0.12  # metres behind head or trunk from which a forearm is drawn behind the body

_ORDERS = np.array(list(itertools.permutations(range(4))))
# Whether the second of two parts is in front of the first, for each order of the four parts from back to front.
_PLACES = np.argsort(_ORDERS, axis=1)
_IS_BEFORE = (_PLACES[:, :, None] < _PLACES[:, None, :]).astype(np.float64)
_MARGIN = 0.04  # metres between the figure and the edge of the image
_LIMB = 0.06  # metres by which a limb extends around its joints, including the tips of the fingers
_HEAD = 0.18  # metres by which the head extends around its centre
_MITTEN = 0.11  # metres from the wrist to the last joint of a hand without fingers
_KNEES = 0.95  # metres below the spine to which the legs are drawn in most poses
_PIECE = 2048  # frames that are projected at a time

# Shirts of figures side by side; the first is that of a figure alone.
SHIRTS: tuple[Colour, ...] = (
    *((62, 110, 158), (181, 88, 63), (75, 138, 99), (125, 90, 148)),
    *((176, 138, 53), (63, 138, 145), (156, 70, 104), (96, 112, 127)),
)
DEFAULT_LOOK = Look((232, 190, 160), (74, 52, 42), SHIRTS[0], (232, 234, 238))

_SUPERSAMPLE = 2
_LARGE = 400  # pixels from which curves need more points


class Ranks(NamedTuple):
    """Ranks (T,) of an upper arm, and of its forearm with the hand, among those of both arms: 0 at the back to 3.

    Ranks of -5 to -2 are behind the head and the trunk.
    """

    upper: np.ndarray
    lower: np.ndarray


def arm_ranks(points: dict[str, np.ndarray], head: np.ndarray) -> tuple[Ranks, Ranks]:
    """Compute the ranks of the left and the right arm by their depths where they cross; the head is (T, 3) metres."""
    chains = np.stack([chain for side in ("left", "right") for chain in _chains(points, side)], axis=1)
    places, depths = project(chains), chains[..., 2]
    apart = places[:, :, None, :, None] - places[:, None, :, None, :]
    overlap = np.exp(-np.sum(apart**2, axis=-1) / (2 * _REACH**2))
    nearer = np.clip((depths[:, :, None, :, None] - depths[:, None, :, None, :]) / _CLEAR, -1, 1)
    certainty = np.sum(overlap * nearer, axis=(-2, -1))
    order = np.argmax(np.einsum("tab,oab->to", certainty, _IS_BEFORE), axis=1)
    ranks = _PLACES[order].T.astype(np.float64)
    left, right = (
        ranks[lower] - np.where(_behind(chains[:, lower, 2:], points, head) > _BEHIND, 5, 0) for lower in (1, 3)
    )
    return Ranks(ranks[0], left), Ranks(ranks[2], right)


def _chains(points: dict[str, np.ndarray], side: str) -> tuple[np.ndarray, np.ndarray]:
    """Return six points (T, 6, 3) along the upper arm, and along the forearm with the hand."""
    shoulder, elbow, wrist = (points[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist"))
    hand = points.get(f"{side}_middle_2", wrist + 0.3 * (wrist - elbow))
    upper = [shoulder + part * (elbow - shoulder) for part in np.linspace(0, 1, 6)]
    lower = [elbow + part * (wrist - elbow) for part in (0.0, 0.35, 0.7, 1.0)]
    return np.stack(upper, axis=1), np.stack([*lower, (wrist + hand) / 2, hand], axis=1)


def _behind(chain: np.ndarray, points: dict[str, np.ndarray], head: np.ndarray) -> np.ndarray:
    """Return by how many metres (T,) a chain (T, n, 3) is behind the head or the trunk, mostly where they overlap."""
    spine, neck = points["spine"][:, None], points["neck"][:, None]
    axis = neck - spine
    height = np.clip(np.sum((chain - spine) * axis, axis=-1) / np.maximum(np.sum(axis**2, axis=-1), 1e-8), -0.5, 1)
    body = spine + height[..., None] * axis
    is_high = chain[..., 1] < neck[..., 1] - 0.04
    body = np.where(is_high[..., None], head[:, None], body)
    weight = np.exp(-np.sum((project(chain) - project(body)) ** 2, axis=-1) / (2 * 0.12**2)) + 1e-9
    return np.sum(weight * (chain[..., 2] - body[..., 2]), axis=-1) / np.sum(weight, axis=-1)


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
    """Compute the outlines of a figure in T poses (T, joints, 3) from the front, in metres with y down.

    Fingers and ears are drawn where the skeleton has them. `detail` is a factor of the number of points of a curve; 1
    suffices for images of a few hundred pixels.
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
    parts += [face_features(head, look, detail), back_of_head(head, look, detail)]
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
    centred = (positions - positions[:, :1]) * (skeleton.left, 1.0, skeleton.left)
    return dict(zip(skeleton.joints, np.moveaxis(centred, 1, 0), strict=True))


class View(NamedTuple):
    """A rectangle of the picture plane in metres from the spine, y down."""

    left: float
    top: float
    right: float
    bottom: float

    def place(self, width: float, height: float) -> tuple[float, np.ndarray]:
        """Return pixels per metre and the spine (2,) in pixels for the view in the middle of an image, as large as it
        fits; the legs use half of the unused height.
        """
        scale = min(width / (self.right - self.left), height / (self.bottom - self.top))
        unused = height / scale - (self.bottom - self.top)
        bottom = max(self.bottom, min(self.bottom + unused / 2, _KNEES))
        middle = (self.left + self.right) / 2
        return scale, np.array([width / 2 - middle * scale, height - bottom * scale])


DEFAULT_VIEW = View(-0.56, -0.70, 0.56, 0.42)
# The smallest view of a camera, which is fitted to head and hands: to the hips, or of the upper body.
CAMERAS = {"body": View(-0.36, -0.66, 0.36, 0.58), "close": View(-0.36, -0.66, 0.36, 0.06)}


def view_of(camera: str) -> View:
    """Return the smallest view of a camera.

    Raises:
        UserError: it is none of `CAMERAS`.
    """
    if camera not in CAMERAS:
        raise UserError(f"no camera {camera!r}; expected one of {', '.join(CAMERAS)}")
    return CAMERAS[camera]


def fit(motions: Iterable[tuple[np.ndarray, Skeleton]], least: View = DEFAULT_VIEW) -> View:
    """Find the smallest view that contains the view `least` and all figures (T, joints, 3) with a margin."""
    low, high = np.array(least[:2]), np.array(least[2:])
    for positions, skeleton in motions:
        for start in range(0, len(positions), _PIECE):
            corners = _corners(from_the_front(positions[start : start + _PIECE], skeleton))
            low = np.minimum(low, corners.min(axis=(0, 1)) - _MARGIN)
            high = np.maximum(high, corners.max(axis=(0, 1)) + _MARGIN)
    return View(*low.tolist(), *high.tolist())


def align(views: Sequence[View]) -> list[View]:
    """Widen the views of figures side by side to one size, each about the middle of its own, at one height."""
    top, bottom = min(view.top for view in views), max(view.bottom for view in views)
    half = max(view.right - view.left for view in views) / 2
    middles = [(view.left + view.right) / 2 for view in views]
    return [View(middle - half, top, middle + half, bottom) for middle in middles]


def _corners(points: dict[str, np.ndarray]) -> np.ndarray:
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


def draw_figure(
    positions: np.ndarray, skeleton: Skeleton, look: Look, width: int, height: int, view: View = DEFAULT_VIEW
) -> np.ndarray:
    """Draw one pose (joints, 3) in metres, y down, as a (height, width, 3) uint8 RGB image that contains `view`."""
    figure = outline(positions[None], skeleton, look, detail=1 if height < _LARGE else 2)
    scale, spine = view.place(_SUPERSAMPLE * width, _SUPERSAMPLE * height)
    corners = (figure.points[0] * scale + spine).ravel().tolist()
    image: Image.Image = backdrop(look.background, _SUPERSAMPLE * width, _SUPERSAMPLE * height).copy()
    canvas = ImageDraw.Draw(image)
    for shape in figure.order[0]:
        start, end = figure.ends[shape : shape + 2]
        canvas.polygon(corners[2 * start : 2 * end], fill=figure.colours[shape])
    return np.asarray(image.reduce(_SUPERSAMPLE))

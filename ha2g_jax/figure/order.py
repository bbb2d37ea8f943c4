"""Which part of which arm is in front."""

import itertools
from typing import NamedTuple

import numpy as np

from ha2g_jax.figure.shapes import project

_REACH = 0.05  # metres in the picture plane within which two limbs overlap
_CLEAR = 0.03  # metres of depth from which an order is certain
_BEHIND = 0.12  # metres behind head or trunk from which a forearm is drawn behind the body

_ORDERS = np.array(list(itertools.permutations(range(4))))
# Whether the second of two parts is in front of the first, in each order of the four parts from back to front.
_PLACES = np.argsort(_ORDERS, axis=1)
_IS_BEFORE = (_PLACES[:, :, None] < _PLACES[:, None, :]).astype(np.float64)


class Ranks(NamedTuple):
    """The order of an upper arm and its forearm.

    Attributes:
        upper: (T,) ranks of the upper arm among the parts of both arms, from 0 at the back to 3.
        lower: (T,) ranks of the forearm with the hand; -5 to -2 are behind the head and the trunk.
    """

    upper: np.ndarray
    lower: np.ndarray


def arm_ranks(points: dict[str, np.ndarray], head: np.ndarray) -> tuple[Ranks, Ranks]:
    """Compute the order of upper arms and forearms, by their depths where they cross.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        head: (T, 3) centre of the head in metres.

    Returns:
        Ranks of the left arm and of the right arm.
    """
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

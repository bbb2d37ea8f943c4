"""A motion as the turns of its parts away from a reference pose, and back.

The turn of each part is seen from the part it hangs on: the forearm's from the upper arm, the hand's from the forearm,
a finger bone's from the one before it. So a share of the turns is a pose in which the hand sits on its arm as well as
in the pose itself; a share of each bone's own way through space would take the hand apart.
"""

import numpy as np

from ha2g_jax.motion.control.parts import HAND, HEAD, Part
from ha2g_jax.motion.rotations import IDENTITY, between, conjugate, from_matrix, multiply, rotate

# The turn of a head or a hand goes on the way it went, up to this angle; beyond it, it is taken to have come back.
_LONGEST = 1.3 * np.pi

Turns = dict[tuple[int, ...], np.ndarray]


def away_from(reference: np.ndarray, directions: np.ndarray, chosen: tuple[Part, ...]) -> Turns:
    """The turns of parts from a reference pose to the poses of a motion.

    Args:
        reference: (bones, 3) unit vectors.
        directions: (T, bones, 3) unit vectors.
        chosen: the parts; with a part, those it hangs on.

    Returns:
        Unit quaternions (T, 4) of each bone, and of the bones of a head or a hand together, by the bones' indices. The
        latter are continuous, and so may have w < 0: an angle above pi.
    """
    reference, poses = np.asarray(reference, np.float64), np.asarray(directions, np.float64)
    frames: dict[int, np.ndarray] = {-1: IDENTITY}
    turns = {}
    for part in chosen:
        frame, bones = frames[part.parent], list(part.bones)
        if part.kind in (HEAD, HAND):
            common = _common_turn(reference[bones], rotate(conjugate(frame)[..., None, :], poses[:, bones]))
            turns[part.bones] = _continuous(common)
            frame = multiply(frame, turns[part.bones])
        for bone in bones:
            turns[bone,] = between(reference[bone], rotate(conjugate(frame), poses[:, bone]))
            frames[bone] = multiply(frame, turns[bone,])
    return turns


def poses_of(reference: np.ndarray, turns: Turns, chosen: tuple[Part, ...]) -> dict[int, np.ndarray]:
    """The directions (T, 3) of each bone of the parts, turned from a reference pose: the inverse of `away_from`."""
    reference = np.asarray(reference, np.float64)
    frames: dict[int, np.ndarray] = {-1: IDENTITY}
    directions = {}
    for part in chosen:
        frame = frames[part.parent]
        if part.kind in (HEAD, HAND):
            frame = multiply(frame, turns[part.bones])
        for bone in part.bones:
            frames[bone] = multiply(frame, turns[bone,])
            directions[bone] = rotate(frames[bone], reference[bone])
    return directions


def power(turn: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Turns (T, 4) by shares (T,) of their angle; of a quaternion with w < 0 the angle is the one above pi."""
    axis = turn[:, :3]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    half = share[:, None] * np.arctan2(length, turn[:, 3:])
    return np.concatenate([axis / np.maximum(length, 1e-12) * np.sin(half), np.cos(half)], axis=-1)


def _common_turn(reference: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The turn (T, 4) that brings (k, 3) reference vectors nearest to (T, k, 3) (Wahba 1965; by SVD, Markley 1988)."""
    u, _, v = np.linalg.svd(np.einsum("tki,kj->tij", vectors, reference))
    u[..., 2] *= np.where(np.linalg.det(u @ v) < 0, -1.0, 1.0)[:, None]
    return from_matrix(u @ v)


def _continuous(turns: np.ndarray) -> np.ndarray:
    """The same turns (T, 4) with signs that follow one another, as long as the way is not too long."""
    stays = (np.sum(turns[1:] * turns[:-1], axis=-1) >= 0).tolist()
    least = np.cos(_LONGEST / 2)
    signs = [1.0]
    for stay, w in zip(stays, turns[1:, 3].tolist(), strict=True):
        sign = signs[-1] if stay else -signs[-1]
        signs.append(sign if sign * w >= least else -sign)
    return turns * np.array(signs)[:, None]

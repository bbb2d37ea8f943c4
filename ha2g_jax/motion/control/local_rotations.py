"""Conversion of a motion to the rotations of its parts from a reference pose, and back.

The rotation of each part is relative to the part it is attached to: that of the forearm to the upper arm, that of the
hand to the forearm, that of a finger bone to the bone before it. So a pose with scaled rotations still has a hand of
the right shape on its arm; if the direction of each bone were scaled on its own, the hand would come apart.
"""

import numpy as np

from ha2g_jax.motion.control.parts import HAND, HEAD, Part
from ha2g_jax.motion.rotations import IDENTITY, between, conjugate, from_matrix, multiply, rotate

# The rotation of a head or a hand is continued in its direction up to this angle; beyond it the short way is taken.
_LONGEST = 1.3 * np.pi

# Indices of the bones that rotate together -> (T, 4) unit quaternions.
Rotations = dict[tuple[int, ...], np.ndarray]


def rotations_from(reference: np.ndarray, directions: np.ndarray, chosen: tuple[Part, ...]) -> Rotations:
    """Compute the rotations of parts from a reference pose to the poses of a motion.

    Args:
        reference: (bones, 3) unit vectors.
        directions: (T, bones, 3) unit vectors.
        chosen: parts to convert, including the parts that they are attached to.

    Returns:
        Unit quaternions (T, 4) of each bone, and of all bones of a head or a hand together, by the indices of the
        bones. The latter are continuous over time and so may have w < 0, which stands for an angle above pi.
    """
    reference, poses = np.asarray(reference, np.float64), np.asarray(directions, np.float64)
    frames: dict[int, np.ndarray] = {-1: IDENTITY}
    rotations = {}
    for part in chosen:
        frame, bones = frames[part.parent], list(part.bones)
        if part.kind in (HEAD, HAND):
            common = _common_rotation(reference[bones], rotate(conjugate(frame)[..., None, :], poses[:, bones]))
            rotations[part.bones] = _continuous(common)
            frame = multiply(frame, rotations[part.bones])
        for bone in bones:
            rotations[bone,] = between(reference[bone], rotate(conjugate(frame), poses[:, bone]))
            frames[bone] = multiply(frame, rotations[bone,])
    return rotations


def apply_rotations(reference: np.ndarray, rotations: Rotations, chosen: tuple[Part, ...]) -> dict[int, np.ndarray]:
    """Rotate the parts of a reference pose, the inverse of `rotations_from`.

    Args:
        reference: (bones, 3) unit vectors.
        rotations: rotations of the parts, as `rotations_from` returns them.
        chosen: parts to rotate, including the parts that they are attached to.

    Returns:
        (T, 3) direction vectors by the index of the bone.
    """
    reference = np.asarray(reference, np.float64)
    frames: dict[int, np.ndarray] = {-1: IDENTITY}
    directions = {}
    for part in chosen:
        frame = frames[part.parent]
        if part.kind in (HEAD, HAND):
            frame = multiply(frame, rotations[part.bones])
        for bone in part.bones:
            frames[bone] = multiply(frame, rotations[bone,])
            directions[bone] = rotate(frames[bone], reference[bone])
    return directions


def power(rotation: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """Scale the angles of rotations.

    Args:
        rotation: (T, 4) unit quaternions; one with w < 0 stands for the angle above pi.
        exponent: (T,) factors of the angles.

    Returns:
        (T, 4) unit quaternions.
    """
    axis = rotation[:, :3]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    half = exponent[:, None] * np.arctan2(length, rotation[:, 3:])
    return np.concatenate([axis / np.maximum(length, 1e-12) * np.sin(half), np.cos(half)], axis=-1)


def _common_rotation(reference: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Fit rotations (T, 4) of vectors (k, 3) to (T, k, 3) by least squares (Wahba 1965; by SVD, Markley 1988)."""
    u, _, v = np.linalg.svd(np.einsum("tki,kj->tij", vectors, reference))
    u[..., 2] *= np.where(np.linalg.det(u @ v) < 0, -1.0, 1.0)[:, None]
    return from_matrix(u @ v)


def _continuous(rotations: np.ndarray) -> np.ndarray:
    """Return the same rotations (T, 4) with signs that are continuous over time up to the longest angle."""
    stays = (np.sum(rotations[1:] * rotations[:-1], axis=-1) >= 0).tolist()
    least = np.cos(_LONGEST / 2)
    signs = [1.0]
    for stay, w in zip(stays, rotations[1:, 3].tolist(), strict=True):
        sign = signs[-1] if stay else -signs[-1]
        signs.append(sign if sign * w >= least else -sign)
    return rotations * np.array(signs)[:, None]

"""Paired differences of mean opinion scores between systems, free of how strict participants and how hard clips are."""

import itertools
from collections.abc import Sequence

import numpy as np

from ha2g_jax.apps.user_study.crossed import Estimate, crossed, jackknife

_CHUNK = 256  # participants left out at a time
_RIDGE = 1e-10
_TOLERANCE = 1e-5


def system_differences(
    scores: np.ndarray, participants: np.ndarray, clips: np.ndarray, systems: np.ndarray, num_systems: int
) -> Estimate:
    """Return the difference of each pair of systems, in the order of `pairs`.

    Least squares with an effect of each system, each participant and each clip: score = system + participant + clip +
    rest. In a complete design this is the difference of the means; in an incomplete one, participants who rate low or
    clips that are hard count for no system. An interval has the differences between participants and between clips; see
    `crossed.crossed`.

    Args:
        scores: (n,) ratings.
        participants: (n,) index of the participant of each.
        clips: (n,) index of the clip of each.
        systems: (n,) index of the system of each.
        num_systems: number of systems.

    Returns:
        Estimates (pairs,): first system less second. NaN where no answers connect the two, such as of participants who
        each rated one system only, and NaN bounds where this is so without one of the participants or clips.
    """
    shape = (participants.max() + 1, num_systems, clips.max() + 1)
    cells = np.ravel_multi_index((participants, systems, clips), shape)
    counts = np.bincount(cells, minlength=np.prod(shape)).reshape(shape).astype(float)
    sums = np.bincount(cells, scores, minlength=np.prod(shape)).reshape(shape)
    is_there = counts.sum((1, 2)) > 0
    counts, sums = counts[is_there], sums[is_there]
    used = counts.sum((0, 1)) > 0
    counts, sums = counts[..., used], sums[..., used]
    blocks, rights = _normal_equations(counts, sums)
    block, right = blocks.sum(0), rights.sum(0)
    value = _solve(block[None], right[None], num_systems)[0]
    chunks = [slice(start, start + _CHUNK) for start in range(0, len(blocks), _CHUNK)]
    without_participant = np.concatenate(
        [_solve(block - blocks[chunk], right - rights[chunk], num_systems) for chunk in chunks]
    )
    without_clip = []
    for clip in range(counts.shape[2]):
        left = np.arange(counts.shape[2]) != clip
        blocks, rights = _normal_equations(counts[..., left], sums[..., left])
        without_clip.append(_solve(blocks.sum(0)[None], rights.sum(0)[None], num_systems)[0])
    return crossed(value, jackknife(without_participant.T), jackknife(np.array(without_clip).T))


def pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return all pairs of systems, in the order of `system_differences`."""
    return list(itertools.combinations(names, 2))


def _normal_equations(counts: np.ndarray, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of systems and clips for each participant, whose own effect is eliminated.

    Args:
        counts: (P, S, C) number of ratings.
        sums: (P, S, C) sum of ratings.

    Returns:
        Matrices (P, S + C, S + C) and right sides (P, S + C).
    """
    num_systems = counts.shape[1]
    seen = np.concatenate([counts.sum(2), counts.sum(1)], axis=1)
    scored = np.concatenate([sums.sum(2), sums.sum(1)], axis=1)
    total = np.maximum(counts.sum((1, 2)), 1)
    matrices = seen[:, :, None] * np.eye(seen.shape[1])
    matrices[:, :num_systems, num_systems:] = counts
    matrices[:, num_systems:, :num_systems] = counts.transpose(0, 2, 1)
    matrices -= seen[:, :, None] * seen[:, None, :] / total[:, None, None]
    return matrices, scored - seen * (sums.sum((1, 2)) / total)[:, None]


def _solve(matrices: np.ndarray, rights: np.ndarray, num_systems: int) -> np.ndarray:
    """Return the differences of all pairs of systems (batch, pairs), NaN where the equations do not determine them."""
    first, second = np.array(list(itertools.combinations(range(num_systems), 2)), int).reshape(-1, 2).T
    contrasts = np.zeros((len(first), matrices.shape[-1]))
    contrasts[np.arange(len(first)), first], contrasts[np.arange(len(first)), second] = 1, -1
    # The equations are singular, as a constant can move from the systems to the clips; a small ridge fixes it, and
    # shows in the weights of a contrast that the equations do not determine.
    ridge = _RIDGE * (1 + matrices.trace(axis1=1, axis2=2)[:, None, None]) * np.eye(matrices.shape[-1])
    weights = np.linalg.solve(matrices + ridge, contrasts.T).transpose(0, 2, 1)  # (batch, pairs, S + C)
    is_determined = np.abs(weights @ matrices - contrasts).max(-1, initial=0.0) < _TOLERANCE
    return np.where(is_determined, (weights @ rights[..., None])[..., 0], np.nan)

"""The FGD of the hands: the Frechet distance of windows of finger flexions, in principal components of true ones."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.anatomy import finger_flexions
from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.metrics.frechet import RecordingMoments, distance
from ha2g_jax.metrics.row import FGD_CUT, SEED_FRAMES, Cut, Latents
from ha2g_jax.skeleton import Skeleton

COMPONENTS = 16


def flexion_windows(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    """Return the flexions of ten fingers (windows, 340) of a motion (T, bones, 3), in windows without overlap."""
    flexions = finger_flexions(skeleton, directions)[SEED_FRAMES:].reshape(-1, 10)
    count = len(flexions) // WINDOW_FRAMES
    return flexions[: count * WINDOW_FRAMES].reshape(count, -1)


def principal_axes(skeleton: Skeleton, training: Sequence[np.ndarray]) -> np.ndarray:
    """Return the first principal components (340, 16) of the windows of true motions of the training split."""
    windows = np.concatenate([flexion_windows(skeleton, directions) for directions in training])
    return np.linalg.svd(windows - windows.mean(axis=0), full_matrices=False)[2][:COMPONENTS].T


def hands_fgd(
    skeleton: Skeleton,
    axes: np.ndarray,
    motions: Sequence[np.ndarray],
    truth: Sequence[np.ndarray],
    speakers: Sequence[str],
) -> tuple[float, dict[str, float]]:
    """Compute the FGD of the hands of motions, each (T, bones, 3) of a speaker, to the true ones; NaN without windows.

    Returns:
        The distance, and by speaker that without the speaker.
    """
    names = sorted(set(speakers))
    own, true = (_moments(skeleton, axes, each, [names.index(name) for name in speakers]) for each in (motions, truth))
    every = np.ones(len(names))
    drawn = {name: every - one for name, one in zip(names, np.eye(len(names)), strict=True)}
    without = {name: distance(own.pool(counts), true.pool(counts)) for name, counts in drawn.items()}
    return distance(own.pool(every), true.pool(every)), without


def _moments(
    skeleton: Skeleton, axes: np.ndarray, motions: Sequence[np.ndarray], members: Sequence[int]
) -> RecordingMoments:
    windows = [flexion_windows(skeleton, directions) @ axes for directions in motions]
    places = np.repeat(members, [len(each) for each in windows])
    latents = Latents(np.concatenate(windows), places, places, Cut(FGD_CUT, SEED_FRAMES, WINDOW_FRAMES))
    return RecordingMoments(latents, max(members) + 1)

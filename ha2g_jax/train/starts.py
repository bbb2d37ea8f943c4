"""Assets that training adds to a model: calm start poses, and the styles of the speakers."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ha2g_jax.data.windows import Windows
from ha2g_jax.methods.build import encode_identity
from ha2g_jax.methods.method import Spec

_NUM_STARTS = 16
_CLIPS_PER_SPEAKER = 8


def calm_starts(windows: Windows, mean_directions: np.ndarray, num_frames: int) -> np.ndarray:
    """Return calm seed poses: of the starts of windows that are near the mean pose, those that move least.

    Args:
        windows: windows of the training split.
        mean_directions: (bones, 3) mean direction vectors of the training split.
        num_frames: number of frames of a seed pose, M.

    Returns:
        (K, M, bones, 3) float32 unit vectors, at most 16, and at most one from each clip.
    """
    starts = np.stack([windows.directions(index)[:num_frames] for index in range(len(windows))])
    distance = np.linalg.norm(starts - mean_directions, axis=-1).mean(axis=(1, 2))
    motion = np.linalg.norm(np.diff(starts, axis=1), axis=-1).sum(axis=1).mean(axis=-1)
    near = np.argsort(distance, kind="stable")[: max(_NUM_STARTS, len(starts) // 4)]
    calmest: dict[int, int] = {}
    for index in near[np.argsort(motion[near], kind="stable")]:
        calmest.setdefault(windows.clip_index(index), index)
    return starts[list(calmest.values())[:_NUM_STARTS]]


def speaker_identities(
    spec: Spec, variables: dict[str, Any], windows: Windows, names: list[str]
) -> dict[str, np.ndarray]:
    """Return the style of every speaker, the output of E_ID, averaged over at most eight training clips.

    Args:
        spec: networks and sizes.
        variables: variables of the generator.
        windows: windows of the training split.
        names: names of the speakers of the training split, by index.

    Returns:
        name -> (style_dim,) float32; empty for a method without identities.
    """
    if not spec.identity:
        return {}

    def identity(speaker):
        if spec.identity == "speaker":
            return np.asarray(encode_identity(spec, variables, np.int32(speaker)))
        images = windows.reference_images(speaker, limit=_CLIPS_PER_SPEAKER)
        return np.mean([encode_identity(spec, variables, image) for image in images], axis=0)

    with ThreadPoolExecutor() as pool:  # threads decode images in parallel
        return dict(zip(names, pool.map(identity, range(len(names))), strict=True))

"""Semantic-relevant gesture recall: is the joint where the real one was, above all where the words have meaning?"""

from typing import Literal

import numpy as np

DELTA = 0.1  # units of the positions within which a joint counts as found


def srgr(
    generated: np.ndarray,
    real: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    delta: float = DELTA,
    norm: Literal["l1", "l2"] = "l1",
    mean_weight: float | None = None,
    first_frame: int = 4,
) -> float:
    """Mean over frames and joints of w(t) [error of the joint < delta], over the mean weight: perfect motion has 1.

    BEAT (Liu et al., ECCV 2022). It punishes gestures that are valid but different.

    Args:
        generated, real: (T, joints, 3).
        weights: (T,) semantic weights, at least 0; without, every frame counts alike and this is the percentage of
            correct keypoints (PCK).
        delta: units of the positions.
        norm: of the error over the 3 coordinates, "l1" as in EMAGE or "l2" as in GENEA 2025.
        mean_weight: that of the data set (EMAGE writes 0.165, GENEA 2025 0.1672); by default that of the scored frames.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        A number, 1 for perfect motion; NaN where no frame is scored or the mean weight is 0.
    """
    difference = np.asarray(generated, np.float64)[first_frame:] - np.asarray(real, np.float64)[first_frame:]
    errors = np.linalg.norm(difference, ord={"l1": 1, "l2": 2}[norm], axis=-1)
    scored = np.ones(len(errors)) if weights is None else np.asarray(weights, np.float64)[first_frame:]
    if not len(scored):
        return np.nan
    divisor = scored.mean() if mean_weight is None else mean_weight
    return float(np.mean(scored[:, None] * (errors < delta)) / divisor) if divisor > 0 else np.nan

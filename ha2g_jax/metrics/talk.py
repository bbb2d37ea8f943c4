"""Scores that need the causes of a motion to be known: hand shapes at words, and the style that was asked for."""

import numpy as np

from ha2g_jax.metrics.beats import wrist_speeds
from ha2g_jax.skeleton import Skeleton, normalize

HANDS = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")


def finger_flexion(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    """How far each finger is bent, 0 straight and 1 closed.

    The bend of a finger is the sum of the angles from the bone of the palm to the last bone of the finger.

    Args:
        skeleton: with joints `left_thumb_1` to `right_pinky_3`.
        directions: (T, bones, 3) direction vectors.

    Returns:
        (T, 2, 5): left and right hand; thumb, index, middle, ring and pinky.
    """
    bones = np.array([[[skeleton.bone(f"{hand}_{finger}_{i}") for i in (1, 2, 3)] for finger in FINGERS] for hand in HANDS])
    vectors = normalize(directions.astype(np.float64))[:, bones]
    cosines = np.sum(vectors[..., 1:, :] * vectors[..., :-1, :], axis=-1)
    bend = np.degrees(np.arccos(np.clip(cosines, -1, 1))).sum(axis=-1)
    return (bend - STRAIGHT) / (CLOSED - STRAIGHT)


def expected_match(predicted: np.ndarray, true: np.ndarray) -> float:
    """Share of words that would match by chance if the predictions were shuffled among the words: sum_c p(c) q(c)."""
    names = np.unique(np.concatenate([predicted, true]))
    return float(sum(np.mean(predicted == name) * np.mean(true == name) for name in names))


def movement(skeleton: Skeleton, directions: np.ndarray, fps: float) -> tuple[float, float]:
    """Amplitude and handedness of a motion, as they can be seen.

    Args:
        skeleton: with joints `left_wrist` and `right_wrist`.
        directions: (T, bones, 3) direction vectors.
        fps: frames per second.

    Returns:
        Mean speed of the two wrists in m/s, and (right - left) / (right + left) of their mean speeds, 0 at rest.
    """
    left, right = wrist_speeds(skeleton, directions, fps).mean(axis=0)
    return float(left + right) / 2, float((right - left) / max(right + left, 1e-9))

"""Scores that need the causes of a motion to be known: hand shapes at words, and the style that was asked for."""

import numpy as np

SHAPE_WINDOW = (-0.1, 0.2)  # seconds around the moment of the gesture in which a hand shape should be seen


def hand_shape(
    flexions: np.ndarray, shapes: np.ndarray, time: float, fps: float, window: tuple[float, float] = SHAPE_WINDOW
) -> int:
    """The shape that a hand takes at a word: the nearest template to its mean flexion over a short window.

    Args:
        flexions: (T, hands, 5) flexion of the fingers, 0 straight and 1 closed, of the hands that should gesture.
        shapes: (classes, 5) flexions of each template.
        time: seconds at which the word's gesture should be seen.
        fps: frames per second of `flexions`.
        window: seconds before and after `time`.

    Returns:
        Index of the template with the least Euclidean distance, summed over hands.
    """
    frames = np.arange(len(flexions)) / fps - time
    seen = (frames >= window[0]) & (frames <= window[1])
    if not seen.any():
        seen = np.abs(frames) == np.abs(frames).min()
    mean = flexions[seen].mean(axis=0)
    return int(np.argmin(np.linalg.norm(mean[None] - shapes[:, None], axis=-1).sum(axis=-1)))


def expected_match(predicted: np.ndarray, true: np.ndarray) -> float:
    """Share of the words that match when the predictions are shuffled among them: sum over classes of p(c) q(c)."""
    names = np.unique(np.concatenate([predicted, true]))
    return float(sum(np.mean(predicted == name) * np.mean(true == name) for name in names))


def movement(wrists: np.ndarray, fps: float) -> tuple[float, float]:
    """Amplitude and handedness of a motion, as they can be seen.

    Args:
        wrists: (T, 2, 3) positions of the left and the right wrist in metres.
        fps: frames per second.

    Returns:
        Mean speed of the faster wrist in m/s, and (right - left) / (right + left) of their mean speeds, 0 at rest. (Of
        simple measures of amplitude this one follows the style of the Talk corpus' teacher best: r = 0.79.)
    """
    speeds = np.linalg.norm(np.diff(wrists, axis=0), axis=-1) * fps
    left, right = speeds.mean(axis=0)
    return float(speeds.max(axis=1).mean()), float((right - left) / (right + left)) if right + left else 0.0


def correlation(pairs: np.ndarray) -> float:
    """Pearson correlation of the two columns of (n, 2); NaN where a column is constant."""
    centred = pairs - np.mean(pairs, axis=0, keepdims=True)
    x, y = centred[:, 0], centred[:, 1]
    scale = np.sqrt(np.sum(x * x) * np.sum(y * y))
    return float(np.sum(x * y) / scale) if scale > 1e-9 else float("nan")

"""Nods of a listener, compared with their known cause: the ends of phrases in the words of the other speaker."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.features.phrases import LEAST_PHRASE, PAUSE
from ha2g_jax.features.text import Word
from ha2g_jax.metrics.beats.times import deep_minima
from ha2g_jax.motion.control.parts import HEAD, bones_of_kind, rest_pose
from ha2g_jax.motion.states import NOD_DELAY
from ha2g_jax.skeleton import Skeleton

TOLERANCE = 0.25  # seconds between the time at which a nod is due and the lowest point of the nod that matches it
_RISE = 5.0  # degrees by which the head is lower than around it


def due_nods(words: Sequence[Word]) -> np.ndarray:
    """Return the times in seconds, (n,), at which nods are due for words with known times, in order.

    A phrase is a run of words that ends with a pause of 0.3 s or with the turn. A nod is due 0.7 s after the end of
    each phrase of at least a second.
    """
    breaks = [k for k in range(1, len(words)) if words[k].start - words[k - 1].end >= PAUSE]
    edges = zip([0, *breaks], [*breaks, len(words)], strict=True) if words else ()
    phrases = [(words[first].start, words[end - 1].end) for first, end in edges]
    return np.array([end + NOD_DELAY for start, end in phrases if end - start >= LEAST_PHRASE])


def nod_times(skeleton: Skeleton, directions: np.ndarray, fps: float) -> np.ndarray:
    """Return the times in seconds, (n,), at which the head of a motion (T, bones, 3) is lowest in a nod.

    A nod lowers the head by at least 5 degrees, and raises it again.
    """
    head = bones_of_kind(skeleton, HEAD)
    rest, turned = (poses[..., head, 1:].astype(np.float64) for poses in (rest_pose(skeleton), directions))
    # The angle about the axis from side to side that takes the head at rest nearest to the head of each frame.
    across = np.sum(rest[:, 0] * turned[..., 1] - rest[:, 1] * turned[..., 0], axis=-1)
    pitch = np.rad2deg(np.arctan2(across, np.sum(rest * turned, axis=(-1, -2))))
    return deep_minima(-skeleton.left * pitch, _RISE) / fps

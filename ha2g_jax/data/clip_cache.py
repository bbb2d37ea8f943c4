"""The features of clips in memory: made when first asked for, kept as long as there is room."""

import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import cachetools
import numpy as np

from ha2g_jax.data.speech import Speech


class Track(NamedTuple):
    """The features of a whole clip.

    Attributes:
        speech: what models hear.
        directions: (T, bones, 3) float32.
        frames: (M, S, S, 3) uint8, None where identities come from a table.
    """

    speech: Speech
    directions: np.ndarray
    frames: np.ndarray | None


class ClipCache:
    """Tracks by the number of their clip; the one unused for the longest time makes room for a new one.

    Threads may share it. A copy made by pickle is empty, as a worker process starts with it.

    Args:
        decode: makes the track of a clip from its number.
        max_bytes: of all tracks in memory; a track larger than this is made anew each time.
    """

    def __init__(self, decode: Callable[[int], Track], max_bytes: int):
        self._decode, self._max_bytes = decode, max_bytes
        self._lock = threading.Lock()
        self._tracks: cachetools.LRUCache[int, Track] = cachetools.LRUCache(max_bytes, getsizeof=_num_bytes)

    def __getitem__(self, number: int) -> Track:
        track = self.peek(number)
        if track is None:
            # Outside the lock: two threads may decode one clip at once, which costs less than all waiting for one.
            track = self._decode(number)
            if _num_bytes(track) <= self._max_bytes:
                with self._lock:
                    track = self._tracks.setdefault(number, track)
        return track

    def peek(self, number: int) -> Track | None:
        """The track of a clip if it is in memory."""
        with self._lock:
            return self._tracks.get(number)

    def __reduce__(self) -> tuple[Any, ...]:
        return ClipCache, (self._decode, self._max_bytes)


def _num_bytes(track: Track) -> int:
    images = 0 if track.frames is None else track.frames.nbytes
    return track.speech.num_bytes + track.directions.nbytes + images

"""A cache of the features of clips in memory, computed on first access and evicted when memory is short."""

import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import cachetools
import numpy as np

from ha2g_jax.data.speech import Speech


class Track(NamedTuple):
    """The features of a whole clip.

    Attributes:
        speech: speech features.
        directions: (T, bones, 3) float32 direction vectors.
        images: (M, S, S, 3) uint8 images of the speaker, None if identities come from a table.
        power: mean power of the sound, see `features.spectrum.sound_power`; 0 without the input "mel".
    """

    speech: Speech
    directions: np.ndarray
    images: np.ndarray | None
    power: float = 0.0


class ClipCache:
    """Least-recently-used cache of tracks by the number of their clip.

    It is thread-safe. A pickled copy is empty, so a worker process starts with an empty cache.

    Args:
        decode: function that computes the track of a clip from its number.
        max_bytes: maximum size of all tracks in memory; a larger track is computed anew on each access.
    """

    def __init__(self, decode: Callable[[int], Track], max_bytes: int):
        self._decode, self._max_bytes = decode, max_bytes
        self._lock = threading.Lock()
        self._tracks: cachetools.LRUCache[int, Track] = cachetools.LRUCache(max_bytes, getsizeof=_num_bytes)

    def __getitem__(self, number: int) -> Track:
        track = self.peek(number)
        if track is None:
            # Outside the lock: two threads may decode one clip at once, which costs less than blocking all threads.
            track = self._decode(number)
            if _num_bytes(track) <= self._max_bytes:
                with self._lock:
                    track = self._tracks.setdefault(number, track)
        return track

    def peek(self, number: int) -> Track | None:
        """Return the track of a clip if it is in memory, else None."""
        with self._lock:
            return self._tracks.get(number)

    def __reduce__(self) -> tuple[Any, ...]:
        return ClipCache, (self._decode, self._max_bytes)


def _num_bytes(track: Track) -> int:
    images = 0 if track.images is None else track.images.nbytes
    return track.speech.num_bytes + track.directions.nbytes + images

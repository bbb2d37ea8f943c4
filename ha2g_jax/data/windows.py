"""Training windows: N frames of a clip with the speech that goes with them.

Windows overlap, so they are not copied: each clip is decoded and turned into features when one of its windows is
first asked for, and a window is a slice of those. Before that there is only an index.
"""

import copy
from collections.abc import Collection, Container
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from ha2g_jax.data import records, speech
from ha2g_jax.data.clip_cache import ClipCache, Track
from ha2g_jax.data.corpus import TRAIN, Clips, Corpus
from ha2g_jax.data.window_index import make_index
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.skeleton import Skeleton, positions_to_directions


class Windows:
    """The windows of one split by index, as examples without a batch axis.

    An example is a dict: of the speech what `inputs` names (see `data.speech.window`), "directions" (N, bones, 3)
    float32 unit vectors, "speaker" () int32 and, with `image_size`, "images" (M, S, S, 3) uint8. Its arrays may be
    shared and must not be written to. Threads may share a `Windows`, and pickled it is small: the index without
    decoded clips.

    Args:
        corpus: where the clips are.
        split: name of the split.
        vocabulary: of the training split.
        num_frames: N.
        inputs: what of the speech is wanted.
        num_reference_frames: M, images of a speaker.
        image_size: S, of the reference frames; None leaves them out.
        among: speakers whose clips are wanted; all by default.
        cache_bytes: memory for decoded clips.

    Attributes:
        skeleton: of the corpus.
        num_training_speakers: of the corpus.

    Raises:
        UserError: the split has no clip of N frames, a record that cannot be used, or no images where they are wanted.
    """

    def __init__(
        self,
        corpus: Corpus,
        split: str,
        vocabulary: Vocabulary,
        *,
        num_frames: int,
        num_reference_frames: int,
        inputs: Collection[str] = ("mel", "words"),
        image_size: int | None = None,
        among: Container[str] | None = None,
        cache_bytes: int = 8 << 30,
    ):
        self.num_frames, self.cache_bytes = num_frames, cache_bytes
        self.skeleton, self.num_training_speakers = corpus.skeleton, len(corpus.speakers_of(TRAIN))
        self._fps, self._vocabulary, self._inputs = corpus.fps, vocabulary, tuple(inputs)
        num_images = 0 if image_size is None else num_reference_frames
        self._index = make_index(corpus, split, num_frames, num_images, among)
        self._read = _Reader(corpus.clips(split), self.skeleton, self._inputs, num_reference_frames, image_size)
        self._cache = ClipCache(self._read.track, cache_bytes)
        self._last_motion: tuple[int, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self._index.clips)

    def __getitem__(self, index: int) -> dict[str, np.ndarray]:
        return self.example(index)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_last_motion": None}

    def with_cache(self, cache_bytes: int) -> "Windows":
        """The same windows with a cache of their own, which is empty."""
        windows = copy.copy(self)
        windows.cache_bytes, windows._cache = cache_bytes, ClipCache(self._read.track, cache_bytes)
        return windows

    def example(self, index: int, delay: int = 0) -> dict[str, np.ndarray]:
        """The window of an index, or one that starts `delay` frames later where the clip is long enough.

        Raises:
            UserError: audio or images of its clip cannot be decoded.
        """
        number, start = self._find(index)
        track = self._cache[number]
        start = min(start + delay, len(track.directions) - self.num_frames)
        heard = speech.window(track.speech, self._inputs, self._vocabulary, start, self.num_frames, self._fps)
        example = heard | {
            "directions": track.directions[start : start + self.num_frames],
            "speaker": self._index.speakers[number],
        }
        if track.frames is not None:
            example["images"] = track.frames
        return example

    def name(self, index: int) -> str:
        """What to call a window in a report: "CLIP_ID@FRAME"."""
        number, start = self._find(index)
        return f"{self._index.names[number]}@{start}"

    def clip_index(self, index: int) -> int:
        """The number of the clip in its split that a window lies in."""
        return self._find(index)[0]

    def directions(self, index: int) -> np.ndarray:
        """The motion of a window alone, (N, bones, 3); decodes no audio, and is quick in the order of the indices."""
        number, start = self._find(index)
        track, last = self._cache.peek(number), self._last_motion
        if track is not None:
            motion = track.directions
        elif last is not None and last[0] == number:
            motion = last[1]
        else:
            motion = self._read.motion(number)
            self._last_motion = number, motion
        return motion[start : start + self.num_frames]

    def speakers(self) -> set[int]:
        """The indices of the speakers of the split."""
        return set(self._index.speakers.tolist())

    def reference_frames(self, speaker: int, limit: int = 8) -> list[np.ndarray]:
        """The images of a speaker, (M, S, S, 3) uint8 of each of at most `limit` clips."""
        images = []
        for number in np.flatnonzero(self._index.speakers == speaker)[:limit].tolist():
            track = self._cache.peek(number)
            frames = track.frames if track is not None else self._read.frames(number)
            if frames is not None:
                images.append(frames)
        return images

    def _find(self, index: int) -> tuple[int, int]:
        return int(self._index.clips[index]), int(self._index.starts[index])


class _Reader(NamedTuple):
    """Makes features of clips by their number; all that decoding needs, and so what is sent to a worker."""

    clips: Clips
    skeleton: Skeleton
    inputs: tuple[str, ...]
    num_reference_frames: int
    image_size: int | None

    def track(self, number: int) -> Track:
        fields = self.clips.fields(number)
        audio = np.zeros(0, np.float32)
        if set(self.inputs) - {"words", "plain_words"}:
            audio = records.decode_audio(fields, self.clips.place(number))
        track = Track(
            speech=speech.prepare(audio, fields["words"], self.inputs),
            directions=self._directions(fields),
            frames=self._resized(fields, number),
        )
        for array in track[1:]:
            if array is not None:
                array.setflags(write=False)
        return track

    def motion(self, number: int) -> np.ndarray:
        return self._directions(self.clips.fields(number))

    def frames(self, number: int) -> np.ndarray | None:
        return None if self.image_size is None else self._resized(self.clips.fields(number), number)

    def _directions(self, fields: dict[str, Any]) -> np.ndarray:
        return np.ascontiguousarray(positions_to_directions(self.skeleton, fields["positions"]), np.float32)

    def _resized(self, fields: dict[str, Any], number: int) -> np.ndarray | None:
        if self.image_size is None:
            return None
        frames = records.decode_frames(fields, self.clips.place(number), self.num_reference_frames)
        return None if frames is None else resize_frames(frames, self.image_size)


def resize_frames(frames: np.ndarray, size: int) -> np.ndarray:
    """Images (M, height, width, 3) uint8 as E_ID takes them, (M, size, size, 3) uint8."""
    if frames.shape[1:3] == (size, size):
        return frames
    return np.stack([np.asarray(Image.fromarray(frame).resize((size, size))) for frame in frames])

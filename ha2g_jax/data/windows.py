"""Training windows: slices of N frames of a clip, whose features are computed when its first window is used."""

import copy
import threading
from collections.abc import Callable, Collection, Container
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from ha2g_jax.data import records, speech
from ha2g_jax.data.corpus import TRAIN, Clips, Corpus
from ha2g_jax.data.speech import Speech
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import sound_power
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.progress import track
from ha2g_jax.skeleton import Skeleton, positions_to_directions


class Track(NamedTuple):
    """The features of a whole clip.

    Attributes:
        directions: (T, bones, 3) float32 direction vectors.
        images: (M, S, S, 3) uint8 images of the speaker, None if identities come from a table.
        power: mean power of the sound, see `features.spectrum.sound_power`; 0 without the input "mel".
    """

    speech: Speech
    directions: np.ndarray
    images: np.ndarray | None
    power: float = 0.0


class ClipCache:
    """Least-recently-used cache of tracks, which `decode` computes, with the number of their clip as key.

    It is thread-safe. A pickled copy is empty, so a worker process starts with an empty cache. The tracks take at most
    `max_bytes` together; a larger track is computed anew on each access.
    """

    def __init__(self, decode: Callable[[int], Track], max_bytes: int):
        self._decode, self._max_bytes = decode, max_bytes
        self._lock = threading.Lock()
        self._tracks: dict[int, Track] = {}  # the one that was used last stands last
        self._num_bytes = 0

    def __getitem__(self, number: int) -> Track:
        if (track := self.peek(number)) is not None:
            return track
        # Outside the lock: two threads may decode one clip at once, which costs less than blocking all threads.
        track = self._decode(number)
        if (num_bytes := _num_bytes(track)) > self._max_bytes:
            return track
        with self._lock:
            if number in self._tracks:
                return self._tracks[number]
            self._tracks[number] = track
            self._num_bytes += num_bytes
            while self._num_bytes > self._max_bytes:
                self._num_bytes -= _num_bytes(self._tracks.pop(next(iter(self._tracks))))
        return track

    def peek(self, number: int) -> Track | None:
        """Return the track of a clip if it is in memory, else None."""
        with self._lock:
            if number in self._tracks:
                self._tracks[number] = self._tracks.pop(number)
            return self._tracks.get(number)

    def __reduce__(self) -> tuple[Any, ...]:
        return ClipCache, (self._decode, self._max_bytes)


def _num_bytes(track: Track) -> int:
    images = 0 if track.images is None else track.images.nbytes
    return track.speech.num_bytes + track.directions.nbytes + images


class WindowIndex(NamedTuple):
    """The windows (W,) of a split, by number of the clip and first frame, with the names and speakers of its clips.

    Attributes:
        lasts: (clips,) int32 last frame of each clip at which a window can start.
    """

    clips: np.ndarray
    starts: np.ndarray
    names: list[str]
    speakers: np.ndarray
    lasts: np.ndarray


class NoWindow(UserError):
    """A split has no window that a model can use."""


def make_index(
    corpus: Corpus, split: str, num_frames: int, num_images: int = 0, among: Container[str] | None = None
) -> WindowIndex:
    """Index the windows of a split, see `Windows`; audio and images stay compressed.

    Raises:
        NoWindow: no clip has a window of N frames.
        UserError: the named record is damaged or has too few images.
    """
    clips = corpus.clips(split)
    speaker_index = {name: index for index, name in enumerate(corpus.speakers)}
    names, speakers, lasts, starts, counts = [], [], [], [], []
    for number in track(range(len(clips)), f"reading the split {split}", "clip"):
        fields = clips.fields(number)
        if (found := len(fields["reference_images"] or [])) < num_images:
            raise UserError(
                f"{clips.title(fields, number)} has {found} images of its speaker, expected {num_images}; "
                "set --config.model.identity.kind=speakers"
            )
        last = len(fields["positions"]) - num_frames
        is_wanted = among is None or fields["speaker"] in among
        fitting = [start for start in fields["window_starts"] if is_wanted and 0 <= start <= last]
        names.append(fields["id"])
        speakers.append(speaker_index[fields["speaker"]])
        lasts.append(last)
        starts.append(np.array(fitting, np.int32))
        counts.append(len(fitting))
    if not sum(counts):
        whose = "" if among is None else "of a speaker of training "
        raise NoWindow(
            f"no clip {whose}in split {split!r} of {corpus.path} has a window of {num_frames} frames; "
            "lower data.num_frames, or give more data"
        )
    return WindowIndex(
        clips=np.repeat(np.arange(len(clips), dtype=np.int32), counts),
        starts=np.concatenate(starts),
        names=names,
        speakers=np.array(speakers, np.int32),
        lasts=np.array(lasts, np.int32),
    )


class Windows:
    """The windows of one split by index, as examples without a batch axis.

    An example is a dict of the speech inputs (see `data.speech.window`), "directions" (N, bones, 3) float32 unit
    vectors, "speaker" () int32 and, with `image_size`, "images" (M, S, S, 3) uint8 images. Several examples may refer
    to the same memory, so their arrays must not be written to. A `Windows` is thread-safe. Its pickle is small: the
    index without decoded clips.

    Args:
        num_frames: length N of a window in frames.
        inputs: names of the speech inputs, among `data.speech.INPUTS`.
        num_reference_images: number M of images of a speaker.
        image_size: width and height S of the images in pixels; None leaves them out.
        among: names of the speakers whose clips are used; all by default.
        cache_bytes: maximum memory for decoded clips.

    Raises:
        NoWindow: the split has no window of N frames.
        UserError: it has an unusable record, or too few images.
    """

    def __init__(
        self,
        corpus: Corpus,
        split: str,
        vocabulary: Vocabulary,
        *,
        num_frames: int,
        num_reference_images: int,
        inputs: Collection[str] = ("mel", "words"),
        image_size: int | None = None,
        among: Container[str] | None = None,
        cache_bytes: int = 8 << 30,
    ):
        self.num_frames, self.cache_bytes = num_frames, cache_bytes
        self.skeleton, self.num_training_speakers = corpus.skeleton, len(corpus.speakers_of(TRAIN))
        self.fps, self._vocabulary, self._inputs = corpus.fps, vocabulary, tuple(inputs)
        num_images = 0 if image_size is None else num_reference_images
        self._index = make_index(corpus, split, num_frames, num_images, among)
        self._read = _Reader(corpus.clips(split), self.skeleton, self._inputs, num_reference_images, image_size)
        self._cache = ClipCache(self._read.track, cache_bytes)
        self._last_motion: tuple[int, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self._index.clips)

    def __getitem__(self, index: int) -> dict[str, np.ndarray]:
        return self.example(index)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_last_motion": None}

    def with_cache(self, cache_bytes: int) -> "Windows":
        """Return the same windows with a new, empty cache of `cache_bytes`."""
        windows = copy.copy(self)
        windows.cache_bytes, windows._cache = cache_bytes, ClipCache(self._read.track, cache_bytes)
        return windows

    def example(self, index: int, delay: int = 0) -> dict[str, np.ndarray]:
        """Return the arrays by name (see the class) of a window that starts `delay` frames later, within its clip.

        Raises:
            UserError: audio or images of the clip cannot be decoded.
        """
        number, start = self._find(index)[0], self.start_frame(index, delay)
        track = self._cache[number]
        inputs = speech.window(track.speech, self._inputs, self._vocabulary, start, self.num_frames, self.fps)
        example = inputs | {
            "directions": track.directions[start : start + self.num_frames],
            "speaker": self._index.speakers[number],
        }
        if track.images is not None:
            example["images"] = track.images
        return example

    def start_frame(self, index: int, delay: int = 0) -> int:
        """Return the first frame of a window in its clip, `delay` frames later, limited by the end of the clip."""
        number, start = self._find(index)
        return min(start + delay, int(self._index.lasts[number]))

    def clip_power(self, index: int) -> float:
        """Return the mean power of the sound of a window's clip, see `sound_power`; 0 without the input "mel"."""
        return self._cache[self.clip_index(index)].power

    def name(self, index: int) -> str:
        """Return the name of a window in reports, "CLIP_ID@FRAME"."""
        number, start = self._find(index)
        return f"{self._index.names[number]}@{start}"

    def clip_index(self, index: int) -> int:
        """Return the number of the clip of a window in its split."""
        return self._find(index)[0]

    def directions(self, index: int) -> np.ndarray:
        """Return only the motion of a window, (N, bones, 3) float32 unit vectors; fastest for ascending indices."""
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

    def reference_images(self, speaker: int, limit: int = 8) -> list[np.ndarray]:
        """Return the images (M, S, S, 3) uint8 of a speaker from each of at most `limit` clips."""
        images = []
        for number in np.flatnonzero(self._index.speakers == speaker)[:limit].tolist():
            track = self._cache.peek(number)
            frames = track.images if track is not None else self._read.images(number)
            if frames is not None:
                images.append(frames)
        return images

    def _find(self, index: int) -> tuple[int, int]:
        return int(self._index.clips[index]), int(self._index.starts[index])


class _Reader(NamedTuple):
    """Reader of the features of clips by number; it holds everything that decoding needs, and is sent to workers."""

    clips: Clips
    skeleton: Skeleton
    inputs: tuple[str, ...]
    num_reference_images: int
    image_size: int | None

    def track(self, number: int) -> Track:
        fields = self.clips.fields(number)
        audio = np.zeros(0, np.float32)
        if set(self.inputs) - {"words", "plain_words"}:
            audio = records.decode_audio(fields, self.clips.place(number))
        prepared = speech.prepare(audio, fields["words"], self.inputs)
        mel = prepared.tracks.get("mel")
        track = Track(
            speech=prepared,
            directions=self._directions(fields),
            images=self._resized(fields, number),
            power=0.0 if mel is None else sound_power(np.power(10, mel.astype(np.float32) / 10)),
        )
        for array in (track.directions, track.images):
            if array is not None:
                array.setflags(write=False)
        return track

    def motion(self, number: int) -> np.ndarray:
        return self._directions(self.clips.fields(number))

    def images(self, number: int) -> np.ndarray | None:
        return None if self.image_size is None else self._resized(self.clips.fields(number), number)

    def _directions(self, fields: dict[str, Any]) -> np.ndarray:
        return np.ascontiguousarray(positions_to_directions(self.skeleton, fields["positions"]), np.float32)

    def _resized(self, fields: dict[str, Any], number: int) -> np.ndarray | None:
        if self.image_size is None:
            return None
        frames = records.decode_images(fields, self.clips.place(number), self.num_reference_images)
        return None if frames is None else resize_images(frames, self.image_size)


def resize_images(frames: np.ndarray, size: int) -> np.ndarray:
    """Resize images (M, height, width, 3) uint8 to the input size of the identity encoder E_ID, (M, size, size, 3)."""
    if frames.shape[1:3] == (size, size):
        return frames
    return np.stack([np.asarray(Image.fromarray(frame).resize((size, size))) for frame in frames])

"""Training windows: N frames of a clip with the speech that goes with them, and seeded batches of them.

Windows overlap, so they are not copied: each clip is decoded and turned into features once, and a window is a
slice of those.
"""

import bisect
from typing import NamedTuple

import grain
import numpy as np
import tqdm
from PIL import Image

from ha2g_jax.audio import log_mel, mel_window
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.text import Vocabulary, Word, words_to_frames

# Batches are slices of arrays in memory: two threads keep ahead of a device, more only contend for the interpreter.
_READ_OPTIONS = grain.ReadOptions(num_threads=2, prefetch_buffer_size=4)


class _Track(NamedTuple):
    """The features of a whole clip.

    Attributes:
        mel: (128, columns) float16 dB; half the memory, and finer than 0.07 dB.
        directions: (T, bones, 3) float32.
        words: in order of time.
        word_starts, word_ends: their times in seconds, in ascending order.
        speaker: index.
        frames: (M, S, S, 3) uint8, None where identities come from a table.
    """

    mel: np.ndarray
    directions: np.ndarray
    words: tuple[Word, ...]
    word_starts: list[float]
    word_ends: list[float]
    speaker: int
    frames: np.ndarray | None


class Windows:
    """The windows of one split by index, as examples without a batch axis.

    An example is a dict: "mel" (128, 70) float32 dB, "words" (N,) int32, "directions" (N, bones, 3) float32 unit
    vectors, "speaker" () int32 and, with `image_size`, "frames" (M, S, S, 3) uint8.

    Args:
        corpus: where the clips are.
        split: name of the split.
        vocabulary: of the training split.
        num_frames: N.
        num_reference_frames: M, images of a speaker.
        image_size: S, of the reference frames; None leaves them out.
        jitter: most frames by which `batches` lets a window start late.

    Raises:
        UserError: the split has no clip of N frames, or no images where they are wanted.
    """

    def __init__(
        self,
        corpus: Corpus,
        split: str,
        vocabulary: Vocabulary,
        *,
        num_frames: int,
        num_reference_frames: int,
        image_size: int | None = None,
        jitter: int = 0,
    ):
        self.num_frames, self.jitter = num_frames, jitter
        self._fps, self._vocabulary = corpus.fps, vocabulary
        self._tracks: list[_Track] = []
        self._index: list[tuple[int, int]] = []
        clips = corpus.clips(split)
        for number in tqdm.trange(len(clips), desc=f"Reading {split}", unit="clip", leave=False, disable=None):
            clip = clips[number]
            frames = None if image_size is None else _reference_frames(clip, num_reference_frames, image_size)
            self._tracks.append(
                _Track(
                    mel=log_mel(clip.audio).astype(np.float16),
                    directions=positions_to_directions(corpus.skeleton, clip.positions),
                    words=clip.words,
                    word_starts=[word.start for word in clip.words],
                    word_ends=np.maximum.accumulate([0.0, *(word.end for word in clip.words)])[1:].tolist(),
                    speaker=corpus.speakers.index(clip.speaker),
                    frames=frames,
                )
            )
            last = len(clip.positions) - num_frames
            self._index += [(number, start) for start in clip.window_starts if start <= last]
        if not self._index:
            raise UserError(
                f"no clip of split {split!r} of {corpus.path} has {num_frames} frames; lower data.num_frames"
            )

    def __len__(self) -> int:
        return len(self._index)

    def __getitem__(self, index: int) -> dict[str, np.ndarray]:
        return self.example(index)

    def example(self, index: int, delay: int = 0) -> dict[str, np.ndarray]:
        """The window of an index, or one that starts `delay` frames later where the clip is long enough."""
        number, start = self._index[index]
        track = self._tracks[number]
        start = min(start + delay, len(track.directions) - self.num_frames)
        example = {
            "mel": mel_window(track.mel, start, self._fps).astype(np.float32),
            "words": self._words(track, start),
            "directions": track.directions[start : start + self.num_frames],
            "speaker": np.int32(track.speaker),
        }
        if track.frames is not None:
            example["frames"] = track.frames
        return example

    def clip_index(self, index: int) -> int:
        """The number of the clip in its split that a window lies in."""
        return self._index[index][0]

    def directions(self, index: int) -> np.ndarray:
        """The motion of a window alone, (N, bones, 3)."""
        number, start = self._index[index]
        return self._tracks[number].directions[start : start + self.num_frames]

    def speakers(self) -> set[int]:
        """The indices of the speakers of the split."""
        return {track.speaker for track in self._tracks}

    def reference_frames(self, speaker: int) -> list[np.ndarray]:
        """The images of a speaker, (M, S, S, 3) uint8 of each clip."""
        return [track.frames for track in self._tracks if track.speaker == speaker and track.frames is not None]

    def _words(self, track: _Track, start: int) -> np.ndarray:
        # Only words near the window are laid out; a frame more on either side leaves rounding to `words_to_frames`.
        first = bisect.bisect_left(track.word_ends, (start - 1) / self._fps)
        last = bisect.bisect_right(track.word_starts, (start + self.num_frames + 1) / self._fps)
        words = track.words[first:last]
        return words_to_frames(words, self._vocabulary, start / self._fps, self.num_frames, self._fps)


def resize_frames(frames: np.ndarray, size: int) -> np.ndarray:
    """Images (M, height, width, 3) uint8 as E_ID takes them, (M, size, size, 3) uint8."""
    if frames.shape[1:3] == (size, size):
        return frames
    return np.stack([np.asarray(Image.fromarray(frame).resize((size, size))) for frame in frames])


def _reference_frames(clip: Clip, count: int, size: int) -> np.ndarray:
    found = 0 if clip.reference_frames is None else len(clip.reference_frames)
    if clip.reference_frames is None or found < count:
        raise UserError(
            f"clip {clip.id} has {found} images of its speaker, expected {count}: "
            "set --config.model.identity.kind=speakers"
        )
    return resize_frames(clip.reference_frames[:count], size)


def batches(windows: Windows, batch_size: int, seed: int) -> grain.DatasetIterator:
    """An endless iterator over batches, each epoch in another order; the same seed gives the same batches.

    Its `get_state()` and `set_state(state)` continue it exactly.

    Args:
        windows: of the training split.
        batch_size: B, of this host.
        seed: of the order and of the delays of windows.

    Raises:
        UserError: there are fewer windows than `batch_size`.
    """
    if batch_size > len(windows):
        raise UserError(
            f"a batch of {batch_size} is more than the {len(windows)} windows there are: "
            "lower --config.train.batch_size or take more data"
        )

    def draw(index: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        return windows.example(index, delay=int(rng.integers(windows.jitter + 1)))

    dataset = grain.MapDataset.range(len(windows)).seed(seed).shuffle().random_map(draw).repeat()
    return iter(dataset.batch(batch_size, drop_remainder=True).to_iter_dataset(_READ_OPTIONS))

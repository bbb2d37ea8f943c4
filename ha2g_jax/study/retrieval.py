"""Motion by retrieval: each window of speech gets the motion of the training window that sounds most like it.

A floor for models: real motion, whose rhythm follows the speech only as far as similar sound had similar gestures.
"""

from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import records
from ha2g_jax.data.corpus import TRAIN, Clips, Corpus
from ha2g_jax.features.audio import log_mel, mel_window
from ha2g_jax.metrics.row import SEED_FRAMES
from ha2g_jax.motion.windows import join_windows, num_windows
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.study.evaluation.clip_result import ClipResult

NAME = "retrieval"  # of its row in tables

_MAX_WINDOWS = 20_000  # of training, so that their features take 100 MB
_BANDS, _COLUMNS = 32, 35  # of a window's spectrogram, 128 x 70, averaged


class Library(NamedTuple):
    """The windows of a training split by their sound.

    Attributes:
        sounds: (n, values) float32 unit vectors, see `_sound`.
        clips: (n,) index of each window's clip.
        starts: (n,) first frame of each window.
    """

    sounds: np.ndarray
    clips: np.ndarray
    starts: np.ndarray


def make_library(corpus: Corpus) -> Library:
    """Compute the sound of the training windows of a corpus, of at most 20,000 in clips drawn at random."""
    clips = corpus.clips(TRAIN)
    length, stride = _window(corpus)
    sounds, owners, starts = [], [], []
    order = np.random.default_rng(0).permutation(len(clips)).tolist()
    for index in tqdm(order, "sound of training", unit="clip", disable=None, leave=False):
        mel, frames = _mel(clips, index)
        for start in range(0, frames - length + 1, stride):
            sounds.append(_sound(mel, start, length, corpus.fps))
            owners.append(index)
            starts.append(start)
        if len(sounds) >= _MAX_WINDOWS:
            break
    return Library(np.array(sounds, np.float32), np.array(owners), np.array(starts))


def retrieve(library: Library, corpus: Corpus, split: str) -> list[ClipResult]:
    """Return the retrieved motion of the clips of a split; its windows are joined as those of a model.

    Args:
        library: library of the same corpus.
        corpus: corpus of the clips.
        split: name of the split.
    """
    clips, training = corpus.clips(split), corpus.clips(TRAIN)
    length, _ = _window(corpus)
    found = []
    for index in tqdm(range(len(clips)), NAME, unit="clip", disable=None, leave=False):
        mel, frames = _mel(clips, index)
        hop = length - SEED_FRAMES
        starts = hop * np.arange(num_windows(frames, length, SEED_FRAMES))
        sounds = np.array([_sound(mel, start, length, corpus.fps) for start in starts.tolist()])
        nearest = np.argmax(sounds @ library.sounds.T, axis=1)
        windows = np.array([_motion(training, corpus, library, row, length) for row in nearest.tolist()])
        fields = clips.fields(index)
        borders = tuple(range(hop, frames - SEED_FRAMES, hop))
        directions = join_windows(windows, SEED_FRAMES)[:frames]
        found.append(
            ClipResult(fields["id"], fields["recording"] or fields["id"], directions, corpus.fps, borders=borders)
        )
    return found


def _window(corpus: Corpus) -> tuple[int, int]:
    """Return length and stride of the windows in frames."""
    return records.frames_at(records.WINDOW_FRAMES, corpus.fps), records.frames_at(records.WINDOW_STRIDE, corpus.fps)


def _mel(clips: Clips, index: int) -> tuple[np.ndarray, int]:
    """Return the log-mel spectrogram of a clip and its number of frames; images stay compressed."""
    fields = clips.fields(index)
    return log_mel(records.decode_audio(fields, clips.place(index), clips.fps)), len(fields["positions"])


def _sound(mel: np.ndarray, start: int, length: int, fps: float) -> np.ndarray:
    """Return the course of each band of a window as one unit vector, less the mean spectrum, which is the voice's."""
    window = mel_window(mel, start, length, fps)
    bands = np.array([part.mean(axis=0) for part in np.array_split(window, _BANDS, axis=0)])
    course = np.array([part.mean(axis=1) for part in np.array_split(bands, _COLUMNS, axis=1)])
    course -= course.mean(axis=0)
    return (course / max(np.linalg.norm(course), 1e-6)).ravel()


def _motion(training: Clips, corpus: Corpus, library: Library, row: int, length: int) -> np.ndarray:
    start = int(library.starts[row])
    positions = training.fields(int(library.clips[row]))["positions"][start : start + length]
    return np.asarray(positions_to_directions(corpus.skeleton, positions), np.float32)

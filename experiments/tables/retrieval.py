"""Motion by retrieval: each window of speech gets the motion of the training window that sounds most like it.

It is a floor for models: real motion, whose rhythm follows the speech only as far as similar sound has similar
gestures.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.data import records
from ha2g_jax.data.corpus import TRAIN, Clips, Corpus
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.features.spectrum import log_mel, mel_window
from ha2g_jax.metrics.row import SEED_FRAMES
from ha2g_jax.motion.windows import join_windows, num_windows
from ha2g_jax.progress import track
from ha2g_jax.skeleton import positions_to_directions

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
    """Compute the sound of the training windows of a corpus, of about 20,000 at most, in clips drawn at random."""
    clips = corpus.clips(TRAIN)
    length, stride = _window(corpus)
    sounds, owners, starts = [], [], []
    order = np.random.default_rng(0).permutation(len(clips)).tolist()
    for index in track(order, "reading the sound of training", "clip"):
        mel, frames = _mel(clips, index)
        for start in range(0, frames - length + 1, stride):
            sounds.append(_sound(mel, start, length, corpus.fps))
            owners.append(index)
            starts.append(start)
        if len(sounds) >= _MAX_WINDOWS:
            break
    return Library(np.array(sounds, np.float32), np.array(owners), np.array(starts))


def nearest_windows(library: Library, corpus: Corpus, split: str) -> dict[str, list[tuple[int, int]]]:
    """Find the training window that sounds most like each window of the clips of a split.

    Returns:
        Id of each clip -> index of the training clip and its first frame, for each window of the clip.
    """
    clips = corpus.clips(split)
    length, _ = _window(corpus)
    found = {}
    for index in track(range(len(clips)), "finding the nearest sound", "clip"):
        mel, frames = _mel(clips, index)
        hop = length - SEED_FRAMES
        starts = hop * np.arange(num_windows(frames, length, hop))
        sounds = np.array([_sound(mel, start, length, corpus.fps) for start in starts.tolist()])
        rows = np.argmax(sounds @ library.sounds.T, axis=1)
        windows = zip(library.clips[rows].tolist(), library.starts[rows].tolist(), strict=True)
        found[clips.fields(index)["id"]] = list(windows)
    return found


def join_motion(corpus: Corpus, split: str, nearest: Mapping[str, Sequence[Sequence[int]]]) -> list[ClipResult]:
    """Return the motion of training windows as that of the clips of a split, joined where they end.

    `nearest` is the return value of `nearest_windows`.
    """
    clips, training = corpus.clips(split), corpus.clips(TRAIN)
    length, _ = _window(corpus)
    hop = length - SEED_FRAMES
    found = []
    for index in range(len(clips)):
        fields = clips.fields(index)
        name, frames = fields["id"], len(fields["positions"])
        positions = [training.fields(clip)["positions"][start : start + length] for clip, start in nearest[name]]
        windows = np.asarray(positions_to_directions(corpus.skeleton, np.array(positions)), np.float32)
        directions = join_windows(windows, SEED_FRAMES, hop)[:frames]
        borders = tuple(range(hop, frames - SEED_FRAMES, hop))
        found.append(ClipResult(name, fields["recording"] or name, directions, corpus.fps, borders=borders))
    return found


def _window(corpus: Corpus) -> tuple[int, int]:
    """Return length and stride of the windows in frames."""
    return records.frames_at(records.WINDOW_FRAMES, corpus.fps), records.frames_at(records.WINDOW_STRIDE, corpus.fps)


def _mel(clips: Clips, index: int) -> tuple[np.ndarray, int]:
    """Return the log-mel spectrogram of a clip and its number of frames; images stay compressed."""
    fields = clips.fields(index)
    return log_mel(records.decode_audio(fields, clips.place(index))), len(fields["positions"])


def _sound(mel: np.ndarray, start: int, length: int, fps: float) -> np.ndarray:
    """Return the bands of a window over time, minus the mean spectrum, that of the voice, as one unit vector."""
    window = mel_window(mel, start, length, fps)
    bands = np.array([part.mean(axis=0) for part in np.array_split(window, _BANDS, axis=0)])
    course = np.array([part.mean(axis=1) for part in np.array_split(bands, _COLUMNS, axis=1)])
    course -= course.mean(axis=0)
    return (course / max(np.linalg.norm(course), 1e-6)).ravel()

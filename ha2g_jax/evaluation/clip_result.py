"""The motion of a clip and its sound, from a model or from a corpus."""

import dataclasses
import functools
import os
import pathlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ha2g_jax.data import records
from ha2g_jax.data.corpus import TRAIN, Clips, Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.data.windows import resize_images
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.metrics.beats.times import audio_onsets
from ha2g_jax.motion.windows import DEFAULT_HOP
from ha2g_jax.progress import track
from ha2g_jax.skeleton import positions_to_directions

if TYPE_CHECKING:  # JAX takes seconds to import, and folders of motion do without
    from ha2g_jax.synthesis import Model

Item = TypeVar("Item")
Value = TypeVar("Value")

_TRAIN_CLIPS = 40  # clips of the training split that are scored if no other split sets the number


@dataclasses.dataclass(frozen=True, eq=False)
class ClipResult:
    """The motion of one clip.

    Attributes:
        id: name of the clip; a motion is compared with the reference of the same id.
        recording: name of the recording that the clip was cut from. Clips of one recording are not independent.
        directions: (T, bones, 3) float32 unit vectors.
        fps: frames per second.
        onsets: (n,) onsets of the sound in seconds, None without sound; those of the reference are used for scores.
        audio: (samples,) float32 sound at 16 kHz, which only the legacy scores need; None otherwise.
        borders: first frames of the windows that the motion was joined from, where they are known.
        path: file that the motion was read from, None for motion from a model or a corpus.
    """

    id: str
    recording: str
    directions: np.ndarray
    fps: float
    onsets: np.ndarray | None = None
    audio: np.ndarray | None = None
    borders: tuple[int, ...] = ()
    path: pathlib.Path | None = None

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.directions)


def from_corpus(
    model: "Model",
    corpus: Corpus,
    split: str,
    *,
    seed: int = 0,
    limit: int | None = None,
    with_audio: bool = False,
    look_ahead: int | None = None,
) -> tuple[list[ClipResult], list[ClipResult]]:
    """Return the motion that a model generates for a split, and the true motion.

    At most `limit` clips are drawn at random, all by default; the legacy scores need `with_audio`. With `look_ahead`
    the motion is that of a stream that hears this many frames beyond each frame.

    Raises:
        UserError: see `generated`.
    """
    motion = generated(model, corpus, split, seed=seed, limit=limit, look_ahead=look_ahead)
    return motion, true(corpus, split, seed=seed, limit=limit, with_audio=with_audio)


def true(
    corpus: Corpus, split: str, *, seed: int = 0, limit: int | None = None, with_audio: bool = False
) -> list[ClipResult]:
    """Return the true motion of a split with onsets; the arguments are those of `from_corpus`.

    Raises:
        UserError: there is no such split, or it has no clip.
    """

    def read(clips: Clips, index: int) -> ClipResult:
        fields = clips.fields(index)  # images stay compressed
        audio = records.decode_audio(fields, clips.place(index))
        return ClipResult(
            id=fields["id"],
            recording=fields["recording"] or fields["id"],
            directions=_directions(corpus, fields["positions"]),
            fps=corpus.fps,
            onsets=audio_onsets(audio, len(audio) / SAMPLE_RATE),
            audio=audio if with_audio else None,
        )

    return _each_clip(corpus, split, seed, limit, "reading the true motion", read)


def generated(
    model: "Model",
    corpus: Corpus,
    split: str,
    *,
    seed: int = 0,
    limit: int | None = None,
    look_ahead: int | None = None,
) -> list[ClipResult]:
    """Return the motion that a model generates for the speech of a split, from the first frames of the true motion on.

    The style is that of the clip's speaker, see `clip_identity`; the arguments are those of `from_corpus`. A
    stream begins with a calm pose of the model instead.

    Raises:
        UserError: the model does not fit the corpus, there is no such split, it has no clip, or the model cannot follow
            a stream.
    """
    from ha2g_jax.synthesis.style import later_seed

    check_fit(model, corpus)
    seed_frames, stride = model.spec.num_seed_frames, model.spec.window_stride

    def read(clips: Clips, index: int) -> ClipResult:
        clip = clips[index]
        style = clip_identity(model, clip)
        start = _directions(corpus, clip.positions[:seed_frames])
        start = np.pad(start, ((0, seed_frames - len(start)), (0, 0), (0, 0)), "edge")
        directions = generate_clip(model, clip, style, later_seed(seed, index), start=start, look_ahead=look_ahead)
        borders = range(stride + seed_frames, len(directions) - seed_frames, stride) if look_ahead is None else ()
        return ClipResult(clip.id, clip.recording or clip.id, directions, corpus.fps, borders=tuple(borders))

    return _each_clip(corpus, split, seed, limit, "generating", read)


def training_motion(corpus: Corpus, *, limit: int, seed: int = 0) -> list[np.ndarray]:
    """Return direction vectors (T, bones, 3) of at most `limit` clips of the training split; no sound is decoded."""
    clips = corpus.clips(TRAIN)
    return [_directions(corpus, clips.fields(index)["positions"]) for index in sample(len(clips), limit, seed)]


def _each_clip(
    corpus: Corpus,
    split: str,
    seed: int,
    limit: int | None,
    title: str,
    read: Callable[[Clips, int], ClipResult],
) -> list[ClipResult]:
    _check_clips(corpus, split)
    clips = corpus.clips(split)
    chosen = sample(len(clips), limit, seed)
    return list(track(in_threads(functools.partial(read, clips), chosen), title, "clip", len(chosen)))


def _check_clips(corpus: Corpus, split: str) -> None:
    if not len(corpus.clips(split)):
        raise UserError(f"{corpus.path} has no clip in the split {split}; choose another of {', '.join(corpus.splits)}")


def in_threads(function: Callable[[Item], Value], items: Iterable[Item]) -> Iterator[Value]:
    """Yield the result of a function for each item, in order, with a thread for each core: a stream keeps one busy."""
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        yield from executor.map(function, items)


def sample(count: int, limit: int | None, seed: int) -> Sequence[int]:
    """Return indices below `count` in ascending order: all, or `limit` of them drawn at random."""
    if limit is None or limit >= count:
        return range(count)
    return sorted(np.random.default_rng(seed).permutation(count)[:limit].tolist())


def split_limits(corpus: Corpus, splits: Sequence[str]) -> dict[str, int | None]:
    """Return how many clips of each split are scored at most; None for all.

    For the training split the limit is the number of clips of the largest other split.

    Raises:
        UserError: there is no such split, or it has no clip.
    """
    for name in splits:
        _check_clips(corpus, name)
    most = max((len(corpus.clips(name)) for name in splits if name != TRAIN), default=_TRAIN_CLIPS)
    return {name: most if name == TRAIN else None for name in splits}


def _directions(corpus: Corpus, positions: np.ndarray) -> np.ndarray:
    return np.asarray(positions_to_directions(corpus.skeleton, positions), np.float32)


def check_fit(model: "Model", corpus: Corpus) -> None:
    """Raise a `UserError` if a model has another skeleton or frame rate than a corpus."""
    skeleton = model.spec.skeleton.name
    if skeleton != corpus.skeleton.name or model.fps != corpus.fps:
        raise UserError(
            f"{corpus.path} has the skeleton {corpus.skeleton.name} at {corpus.fps:g} frames per second, the model "
            f"{skeleton} at {model.fps:g}; give a corpus that fits"
        )


def clip_identity(model: "Model", clip: Clip) -> np.ndarray:
    """Return the style (style_dim,) of a clip's speaker: the mean of f_id, zeros for a model without identities.

    A model that reads images gets the reference images of the clip. One with a table of speakers looks up the name; a
    name that is not in the table gets the average of all styles.

    Raises:
        UserError: the model reads images and the clip has none.
    """
    from ha2g_jax.methods import encode_identity

    spec = model.spec
    if not spec.identity:
        return np.zeros(spec.style_dim, np.float32)
    if spec.identity != "images":
        known = model.assets.speakers
        return np.asarray(known.get(clip.speaker, np.mean(list(known.values()), axis=0)), np.float32)
    if clip.reference_images is None:
        raise UserError(f"clip {clip.id} has no reference images, which this model needs; give a corpus that has them")
    images = resize_images(clip.reference_images[: spec.num_reference_images], spec.image_size)
    return np.asarray(encode_identity(spec, model.variables, images))


def generate_clip(
    model: "Model",
    clip: Clip,
    style: np.ndarray,
    seed: int,
    *,
    start: np.ndarray | None = None,
    has_words: bool = True,
    look_ahead: int | None = None,
    hop: int = DEFAULT_HOP,
) -> np.ndarray:
    """Generate the direction vectors (T, bones, 3) of a motion for the speech of a clip, in a style (style_dim,).

    If no seed poses (seed frames, bones, 3) are given, the model draws them, as it always does for a stream. A stream
    hears `look_ahead` frames of speech beyond each frame and makes `hop` frames in a run; by default the whole clip is
    heard. Words are for a model that reads them.

    Raises:
        UserError: the model cannot follow a stream, or not with this look-ahead.
    """
    from ha2g_jax import synthesis

    if look_ahead is not None:
        stream = model.stream(look_ahead=look_ahead, hop=hop, style=synthesis.Style(values=style), seed=seed)
        return np.concatenate([stream.feed(clip.audio), stream.flush()])
    words = clip.words if has_words else ()
    return synthesis.generate_directions(model, clip.audio, style, seed, words=words, start=start)

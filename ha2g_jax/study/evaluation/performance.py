"""What is evaluated: the motion of a clip with the sound that it goes with, from a model or from a corpus."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import records
from ha2g_jax.data.corpus import Clips, Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.metrics.beat_alignment import audio_onsets
from ha2g_jax.skeleton import positions_to_directions

if TYPE_CHECKING:  # JAX takes seconds to import, and folders of motion do without
    from ha2g_jax.synthesis import Model

SEED_FRAMES = 4  # M of the paper: given to the models, so not scored


@dataclasses.dataclass(frozen=True, eq=False)
class Performance:
    """The motion of one clip.

    Attributes:
        id: name of the clip; a motion is compared with the reference of the same id.
        source: the recording that the clip was cut from. Clips of one source are not independent.
        directions: (T, bones, 3) float32 unit vectors.
        fps: frames per second.
        onsets: (n,) seconds of the onsets of its sound, None without sound. Those of the reference count.
        audio: (samples,) float32 at 16 kHz, which only the legacy scores need; None otherwise.
        borders: first frames of the windows that the motion was joined from, where they are known.
    """

    id: str
    source: str
    directions: np.ndarray
    fps: float
    onsets: np.ndarray | None = None
    audio: np.ndarray | None = None
    borders: tuple[int, ...] = ()

    @property
    def num_frames(self) -> int:
        return len(self.directions)

    @property
    def seconds(self) -> float:
        return self.num_frames / self.fps


def from_corpus(
    model: "Model", corpus: Corpus, split: str, *, seed: int = 0, limit: int | None = None, with_audio: bool = False
) -> tuple[list[Performance], list[Performance]]:
    """What a model performs for a split, and the true motion.

    Args:
        model: see `generated`.
        corpus, split: where the clips are.
        seed: of the sample of clips and of the start poses.
        limit: clips at most, drawn at random; all by default.
        with_audio: whether the legacy scores are wanted.

    Raises:
        UserError: as `generated` and `true`.
    """
    truth = true(corpus, split, seed=seed, limit=limit, with_audio=with_audio)
    return generated(model, corpus, split, seed=seed, limit=limit), truth


def true(
    corpus: Corpus, split: str, *, seed: int = 0, limit: int | None = None, with_audio: bool = False
) -> list[Performance]:
    """The true motion of a split with its onsets; for the arguments see `from_corpus`.

    Raises:
        UserError: there is no such split, or it has no clip.
    """

    def perform(clips: Clips, index: int) -> Performance:
        fields = clips.fields(index)  # images stay compressed
        audio = records.decode_audio(fields, clips.place(index))
        return Performance(
            id=fields["id"],
            source=fields["recording"] or fields["id"],
            directions=_directions(corpus, fields["positions"]),
            fps=corpus.fps,
            onsets=audio_onsets(audio, len(audio) / SAMPLE_RATE),
            audio=audio if with_audio else None,
        )

    return _each_clip(corpus, split, seed, limit, "true motion", perform)


def generated(
    model: "Model", corpus: Corpus, split: str, *, seed: int = 0, limit: int | None = None
) -> list[Performance]:
    """What a model performs for the speech of a split, from the first frames of the true motion on.

    The style is that of the clip's speaker, see `identity.clip_identity`.

    Args:
        model: of the skeleton and the frame rate of the corpus.
        corpus, split: where the clips are.
        seed: of the sample of clips, and of whatever the model draws.
        limit: clips at most, drawn at random; all by default.

    Raises:
        UserError: the model does not fit the corpus, there is no such split, or it has no clip.
    """
    from ha2g_jax import synthesis
    from ha2g_jax.study.identity import clip_identity

    _check_fit(model, corpus)
    seed_frames, stride = model.task.num_seed_frames, model.task.num_frames - model.task.num_seed_frames

    def perform(clips: Clips, index: int) -> Performance:
        clip = clips[index]
        style = clip_identity(model, clip)
        if not model.task.identity_input:  # what such a model takes for a style is noise (Joint Embedding)
            style = np.random.default_rng([seed, index]).standard_normal(len(style)).astype(np.float32)
        start = _directions(corpus, clip.positions[:seed_frames])
        start = np.pad(start, ((0, seed_frames - len(start)), (0, 0), (0, 0)), "edge")
        directions = synthesis.generate_directions(
            model, clip.audio, style, seed + index, words=clip.words, start=start
        )
        borders = tuple(range(stride, len(directions) - seed_frames, stride))
        return Performance(clip.id, clip.recording or clip.id, directions, corpus.fps, borders=borders)

    return _each_clip(corpus, split, seed, limit, "performing", perform)


def training_motion(corpus: Corpus, split: str, *, limit: int, seed: int = 0) -> list[np.ndarray]:
    """Direction vectors (T, bones, 3) of at most `limit` clips of a split; no sound is decoded."""
    clips = corpus.clips(split)
    return [_directions(corpus, clips.fields(index)["positions"]) for index in _sample(clips, limit, seed)]


def _each_clip(
    corpus: Corpus,
    split: str,
    seed: int,
    limit: int | None,
    title: str,
    perform: Callable[[Clips, int], Performance],
) -> list[Performance]:
    clips = corpus.clips(split)
    chosen = _sample(clips, limit, seed)
    if not chosen:
        raise UserError(f"{corpus.path} has no clip in the split {split}; choose another of {', '.join(corpus.splits)}")
    steps = tqdm(chosen, title, unit="clip", disable=None, leave=False)
    return [perform(clips, index) for index in steps]


def _sample(clips: Clips, limit: int | None, seed: int) -> Sequence[int]:
    """Indices in ascending order."""
    if limit is None or limit >= len(clips):
        return range(len(clips))
    return sorted(np.random.default_rng(seed).permutation(len(clips))[:limit].tolist())


def _directions(corpus: Corpus, positions: np.ndarray) -> np.ndarray:
    return np.asarray(positions_to_directions(corpus.skeleton, positions), np.float32)


def _check_fit(model: "Model", corpus: Corpus) -> None:
    skeleton = model.task.skeleton.name
    if skeleton != corpus.skeleton.name or model.fps != corpus.fps:
        raise UserError(
            f"{corpus.path} has the skeleton {corpus.skeleton.name} at {corpus.fps:g} frames per second, the model "
            f"{skeleton} at {model.fps:g}; give a corpus that fits"
        )

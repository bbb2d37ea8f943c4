"""Strips of pictures: the motion of a checkpoint for clips of the validation split, below the recorded motion."""

import base64
import dataclasses
import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.figure import DEFAULT_LOOK, draw_figure, fit
from ha2g_jax.progress import stage
from ha2g_jax.skeleton import Skeleton, directions_to_positions, positions_to_directions
from ha2g_jax.train.report.lines import Line
from ha2g_jax.train.report.runs import Run, checkpoint_step

SPLIT = "val"
SECONDS = 4.0  # of a strip, from the start of a clip
MOST_LINES = 4  # lines whose motion is drawn, because each compiles a model

_PICTURES, _WIDTH, _HEIGHT = 8, 120, 132
_SEED = 0
_RECORDED = "recorded"


class Strip(NamedTuple):
    """Pictures of one motion, in a row.

    Attributes:
        label: line that the motion is of, or "recorded".
        number: number of the line, None for recorded motion.
        picture: JPEG in base64.
    """

    label: str
    number: int | None
    picture: str


class ClipStrips(NamedTuple):
    """Strips for one clip.

    Attributes:
        clip: id of the clip.
        speaker: speaker of the clip.
        strips: recorded motion first.
    """

    clip: str
    speaker: str
    strips: tuple[Strip, ...]


class Samples(NamedTuple):
    """All strips of a page.

    Attributes:
        clips: strips of each clip.
        notes: label of a line -> checkpoint that was drawn, or the reason why its motion was not.
    """

    clips: tuple[ClipStrips, ...]
    notes: dict[str, str]


class _Figure(NamedTuple):
    directions: np.ndarray  # (T, bones, 3)
    skeleton: Skeleton
    fps: float


def make_samples(lines: Sequence[Line], num_clips: int) -> Samples:
    """Generate and draw the motion of the first run of each line.

    Args:
        lines: lines of the page; the first `MOST_LINES` are drawn.
        num_clips: number of clips, evenly over the validation split.
    """
    drawn: dict[tuple[str, int], tuple[Clip, dict[int | None, _Figure]]] = {}
    notes: dict[str, str] = {}
    for number, line in enumerate(lines[:MOST_LINES]):
        run = line.runs[0]
        try:
            with stage(f"motion of {run.name}"):
                notes[line.label] = _generate(run, number, num_clips, drawn)
        except UserError as error:
            notes[line.label] = f"no pictures: {error}"
    notes |= {line.label: f"no pictures: only the first {MOST_LINES} lines have some" for line in lines[MOST_LINES:]}
    clips = [
        ClipStrips(clip.id, clip.speaker, tuple(_strips(figures, [line.label for line in lines])))
        for clip, figures in drawn.values()
    ]
    return Samples(tuple(clips), notes)


def _generate(
    run: Run, number: int, num_clips: int, drawn: dict[tuple[str, int], tuple[Clip, dict[int | None, _Figure]]]
) -> str:
    """Add the motion of a run for each clip to `drawn`, and return which checkpoint it is of."""
    step = checkpoint_step(run.path)
    if step is None:
        raise UserError("no checkpoint yet")
    if not run.corpus:
        raise UserError("run.json does not say which corpus the run used")
    corpus = Corpus.open(run.corpus)
    if not corpus.has_clips(SPLIT):
        raise UserError(f"the corpus has no split {SPLIT}")
    clips = corpus.clips(SPLIT)

    from ha2g_jax import synthesis  # imports JAX, after what is needed was found
    from ha2g_jax.evaluation.generation import generate_clip
    from ha2g_jax.synthesis.samples import clip_style

    model = synthesis.load(run.path)
    skeleton = model.assets.skeleton
    if skeleton.name != corpus.skeleton.name or model.spec.fps != corpus.fps:
        raise UserError(f"the corpus is now another one: {corpus.skeleton.name} at {corpus.fps:g} frames per second")
    for place in sorted({number * len(clips) // num_clips for number in range(num_clips)}):
        clip, figures = drawn.setdefault((run.corpus, place), (_beginning(clips[place], corpus.fps), {}))
        if None not in figures:
            recorded = positions_to_directions(corpus.skeleton, clip.positions)
            figures[None] = _Figure(recorded, corpus.skeleton, corpus.fps)
        figures[number] = _Figure(generate_clip(model, clip, clip_style(model, clip), _SEED), skeleton, model.spec.fps)
    return f"{run.name}, checkpoint of step {step}"


def _beginning(clip: Clip, fps: float) -> Clip:
    """Return the first seconds of a clip."""
    frames, samples = round(SECONDS * fps), round(SECONDS * SAMPLE_RATE)
    return dataclasses.replace(clip, positions=clip.positions[:frames], audio=clip.audio[:samples])


def _strips(figures: dict[int | None, _Figure], labels: Sequence[str]) -> list[Strip]:
    """Draw figures at equal moments and from one place."""
    positions = {key: directions_to_positions(one.skeleton, one.directions) for key, one in figures.items()}
    view = fit((positions[key], one.skeleton) for key, one in figures.items())
    strips = []
    for key, one in figures.items():
        frames = np.minimum(np.arange(_PICTURES) * SECONDS / _PICTURES * one.fps, len(positions[key]) - 1).astype(int)
        pictures = [
            draw_figure(positions[key][frame], one.skeleton, DEFAULT_LOOK, _WIDTH, _HEIGHT, view) for frame in frames
        ]
        buffer = io.BytesIO()
        Image.fromarray(np.concatenate(pictures, axis=1)).save(buffer, "JPEG", quality=80)
        label = _RECORDED if key is None else labels[key]
        strips.append(Strip(label, key, base64.b64encode(buffer.getvalue()).decode()))
    return strips

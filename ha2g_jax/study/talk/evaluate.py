"""Scores of a checkpoint on the Talk corpus, whose causes are known, with a ceiling and floors in every table."""

import pathlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from ha2g_jax import synthesis
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import build, teacher
from ha2g_jax.data.talk.style import Style
from ha2g_jax.errors import UserError
from ha2g_jax.metrics import beats
from ha2g_jax.metrics.jackknife import Estimate
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.study.identity import clip_identity
from ha2g_jax.study.talk import probe, scores
from ha2g_jax.study.talk.scores import Trial
from ha2g_jax.study.talk.table import as_table
from ha2g_jax.synthesis import Model

__all__ = ["SPLITS", "as_table", "evaluate", "score"]

UNSEEN = "test_unseen_speakers"
SPLITS = (TRAIN, "test", UNSEEN)
MISMATCHES = 5  # motions for other clips that make the floor of a clip

_MAX_PROBE_CLIPS = 400
_TRAIN_CLIPS = 40  # of the training split, where no other split sets the number


def evaluate(
    checkpoint: str | pathlib.Path, data: str | pathlib.Path, *, splits: Sequence[str] | None = None, seed: int = 0
) -> dict[str, Any]:
    """All scores of a checkpoint, ready for JSON; `as_table` prints them.

    Args:
        checkpoint: "demo", a workdir or a model folder.
        data: "talk" or the folder of a Talk corpus.
        splits: to score; `SPLITS` by default.
        seed: of start poses, of the teacher's noise and of the sample of training clips.

    Raises:
        UserError: no such checkpoint, corpus or split; a corpus without known strokes or of another skeleton.
    """
    model = synthesis.load(checkpoint)
    corpus = Corpus.open(build.talk_path(str(data)))
    return {"checkpoint": str(checkpoint), **score(model, corpus, tuple(splits or SPLITS), seed)}


def score(model: Model, corpus: Corpus, splits: Sequence[str] = SPLITS, seed: int = 0) -> dict[str, Any]:
    """All scores of a model.

    Each split has the rows "model", "model, no words" (of one that reads words: without the transcript), "teacher" (the
    ceiling: the teacher performs again with other noise), "mean pose", "mismatched speech" (the model's motion for up
    to `MISMATCHES` clips of other talks), "majority" and "shuffled" (of the hand shapes). Beat recall is the share of
    the strokes caused by the sound that a motion beat meets within 0.1 s; precision is the share of the motion beats
    that meet a beat of the true motion, whatever causes it. In the strict F1 a motion beat that answers to a word is
    wrong. "beat_f1_gain" is the model's F1 less that of mismatched speech, its error that of the paired difference.

    A score is {"value", "error"}, the error a standard error by clip, for the style by speaker; None where it is
    undefined. The model takes the style of each clip from the clip's own reference frames, or from the speaker's name.
    The linear probe on frozen f_high is of HA2G alone. Of the training split as many clips are scored as the largest
    other split has.

    Raises:
        UserError: as `evaluate`.
    """
    chosen = _choose_clips(corpus, splits, seed)
    _check(model, corpus, chosen)
    num_clips = sum(map(len, chosen.values()))
    num_probed = num_clips + min(_MAX_PROBE_CLIPS, len(corpus.clips(TRAIN))) if model.has_audio_levels else 0
    with tqdm(desc="evaluate", total=num_clips + num_probed, unit="clip") as progress:
        results = {name: _score_split(model, corpus, clips, seed, progress) for name, clips in chosen.items()}
        accuracies = _probe(model, corpus, chosen, seed, progress) if model.has_audio_levels else {}
    return {
        "model": model.assets.hash,
        "data": {"name": corpus.metadata["name"], "source": corpus.metadata["source"]},
        "seed": seed,
        "num_test_words": sum(result["num_words"] for name, result in results.items() if name != TRAIN),
        "splits": results,
        "probe": {name: scores.row_as_json(row) for name, row in accuracies.items()},
    }


def _choose_clips(corpus: Corpus, names: Sequence[str], seed: int) -> dict[str, list[Clip]]:
    clips = {name: corpus.clips(name) for name in names}
    limit = max((len(clips[name]) for name in names if name != TRAIN), default=_TRAIN_CLIPS)
    chosen = {}
    for name, source in clips.items():
        indices = _sample(len(source), limit, seed) if name == TRAIN else range(len(source))
        chosen[name] = [source[index] for index in indices]
    return chosen


def _sample(count: int, size: int, seed: int) -> list[int]:
    """Indices below `count`, at most `size` of them, in ascending order."""
    return sorted(np.random.default_rng(seed).permutation(count)[:size].tolist())


def _check(model: Model, corpus: Corpus, chosen: dict[str, list[Clip]]) -> None:
    skeleton = model.task.skeleton.name
    if skeleton != corpus.skeleton.name or model.fps != corpus.fps:
        raise UserError(
            f"{corpus.path} has the skeleton {corpus.skeleton.name} at {corpus.fps:g} frames per second, the model "
            f"{skeleton} at {model.fps:g}; give a corpus that fits"
        )
    for name, clips in chosen.items():
        if not all(clip.strokes and clip.style for clip in clips):
            raise UserError(f"{corpus.path} ({name}) does not know its strokes; expected one of `ha2g data make-talk`")


def _score_split(model: Model, corpus: Corpus, clips: Sequence[Clip], seed: int, progress: tqdm) -> dict[str, Any]:
    skeleton, fps, first_frame = corpus.skeleton, corpus.fps, model.task.num_seed_frames

    generated, wordless, taught, still = [], [], [], []
    truths = [scores.truth(skeleton, clip, fps) for clip in clips]
    for index, (clip, truth) in enumerate(zip(clips, truths, strict=True)):
        speech = model, clip.audio, clip_identity(model, clip), seed + index
        directions = synthesis.generate_directions(*speech, words=clip.words)
        if model.reads_words:
            wordless.append(Trial(truth, scores.look(skeleton, synthesis.generate_directions(*speech), fps)))
        again = teacher.perform(clip.audio, clip.words, Style(*clip.style), np.random.default_rng([seed, index]), fps)
        taught.append(Trial(truth, scores.look(skeleton, positions_to_directions(skeleton, again.positions), fps)))
        generated.append(Trial(truth, scores.look(skeleton, directions, fps)))
        still_directions = np.broadcast_to(skeleton.mean_directions, directions.shape)
        still.append(Trial(truth, scores.look(skeleton, still_directions, fps)))
        progress.update()
    partners = _partners(clips, seed)
    mismatched = [Trial(truth, generated[other].seen) for truth, row in zip(truths, partners) for other in row]

    rows = {"model": generated, "model, no words": wordless, "teacher": taught, "mean pose": still}
    rows["mismatched speech"] = mismatched
    words = scores.word_shapes(generated, fps, first_frame)
    counts, floor = (scores.beat_counts(trials, fps, first_frame) for trials in (generated, mismatched))
    ids = [clip.id for clip in clips]
    return {
        "num_clips": len(clips),
        "num_speakers": len({clip.speaker for clip in clips}),
        "num_strokes": int(counts[:, 0].sum()),
        "num_words": len(words),
        "rows": {
            name: scores.row_as_json(row)
            for name, row in (
                *((name, scores.row(trials, fps, first_frame)) for name, trials in rows.items() if trials),
                *scores.semantic_floors(words).items(),
            )
        },
        "beat_f1_gain": scores.as_json(scores.gain(counts, floor, ids)),
        "beat_f1_strict_gain": scores.as_json(scores.gain(counts, floor, ids, beats.strict_f1)),
    }


def _partners(clips: Sequence[Clip], seed: int) -> list[list[int]]:
    """For each clip the same number of clips of other talks, drawn at random."""
    order = np.random.default_rng(seed).permutation(len(clips)).tolist()
    others = []
    for index, clip in enumerate(clips):
        place = order.index(index)
        following = order[place + 1 :] + order[:place]
        others.append([other for other in following if clips[other].recording != clip.recording][:MISMATCHES])
    fewest = min(map(len, others), default=0)
    return [row[:fewest] for row in others]


def _probe(
    model: Model, corpus: Corpus, chosen: dict[str, list[Clip]], seed: int, progress: tqdm
) -> dict[str, dict[str, Estimate]]:
    training = corpus.clips(TRAIN)
    probed = _sample(len(training), _MAX_PROBE_CLIPS, seed)
    heard = {name: probe.hear(_hear(model, clips, progress), model.fps) for name, clips in chosen.items()}
    learnt = probe.hear(_hear(model, (training[index] for index in probed), progress), model.fps)
    return probe.accuracy(learnt, heard)


def _hear(model: Model, clips: Iterable[Clip], progress: tqdm) -> Iterator[tuple[Clip, np.ndarray]]:
    """The clips with their f_high."""
    for clip in clips:
        yield clip, np.asarray(synthesis.encode_features(model, clip.audio).high)
        progress.update()

"""Score the inputs of `ha2g evaluate`, a corpus, a recording or folders of motion, with results of the same form."""

import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np

from ha2g_jax import __version__, metrics
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk import build
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.clip_result import check_fit, from_corpus, split_limits, training_motion
from ha2g_jax.evaluation.evaluate import LEVEL, check_autoencoder, evaluate, measure, score_as_json
from ha2g_jax.evaluation.motion_folders import (
    BEAT2,
    FPS,
    find_motions,
    from_folders,
    read_directions,
    references_of,
    score_beat2,
)
from ha2g_jax.evaluation.table import PARTS
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.files.reading import resolved, shown
from ha2g_jax.metrics.beats import strokes
from ha2g_jax.metrics.hands import upper_body
from ha2g_jax.metrics.legacy import check_rate
from ha2g_jax.metrics.row import SEED_FRAMES
from ha2g_jax.motion.readers import Reading, check_reading, read_motion
from ha2g_jax.motion.readers.recordings import compare_lengths
from ha2g_jax.progress import stage
from ha2g_jax.skeleton import directions_to_positions, load_skeleton

MIN_SECONDS = 10.0  # least length of a recording
TEST_SPLITS, OTHER_SPLIT = ("test", "test_unseen_speakers"), "val"

_TRAINING_CLIPS = 400  # clips that give the mean pose, usual changes and limits of angles


def evaluate_folders(
    motion: str | os.PathLike | Sequence[str | os.PathLike],
    reference: str | os.PathLike,
    *,
    autoencoder: str | os.PathLike | None = None,
    legacy: bool = False,
    skeleton: str | None = None,
    protocol: str | None = None,
    body_model: str | os.PathLike | None = None,
    seed: int = 0,
    **reading: Unpack[Reading],
) -> dict[str, Any]:
    """Score the motion in folders, each made by one system, against that in another one, paired by names of files.

    Args:
        motion: folder of the motion of a system, or several, which are scored on the clips that all of them have.
        reference: folder of the true motion; see `motion_folders.from_folders`.
        autoencoder: workdir or folder of a pose auto-encoder, for FGD and diversity.
        skeleton: "ted_expressive" or "ted_gesture"; by default that of the auto-encoder, or else of the files.
        protocol: "beat2" to add the scores of `score_beat2`, for SMPL-X motion, with its body model.
        reading: what is known about the files.

    Returns:
        As `make_results`, with one section under the name of the reference folder; the rows of the motion have the
        names of their folders.

    Raises:
        UserError: a folder, a file or the auto-encoder cannot be used, or a folder is given twice.
    """
    if protocol not in (None, BEAT2):
        raise UserError(f"no protocol {protocol}; expected {BEAT2}")
    if protocol is None and body_model is not None:
        raise UserError(f"--body-model is for the protocol {BEAT2}; add --protocol {BEAT2}")
    folders = [motion] if isinstance(motion, str | os.PathLike) else list(motion)
    names = _row_names(folders)
    features = _features(autoencoder)
    if skeleton is None and features is not None:
        skeleton = features.skeleton.name
    every = [pathlib.Path(folder) for folder in (reference, *folders)]
    check_reading([path for folder in every for path in find_motions(folder).values()], **reading)
    read = {}
    for name, folder in zip(names, folders, strict=True):
        read[name] = from_folders(folder, reference, skeleton=skeleton, with_audio=legacy, **reading)
        skeleton = read[name].skeleton.name
    of_protocol = {}
    if protocol is not None:  # first, because the other scores take longer than finding that the files do not fit
        of_protocol["beat2"] = score_beat2(read, body_model=body_model, seed=seed, **reading)
    truth = references_of(clip for each in read.values() for clip in each.reference)
    section = evaluate(
        {name: each.motion for name, each in read.items()},
        list(truth.values()),
        next(iter(read.values())).skeleton,
        autoencoder=features,
        legacy=legacy,
        seed=seed,
        notes=[note if len(read) == 1 else f"{name}: {note}" for name, each in read.items() for note in each.notes],
    )
    section |= of_protocol
    inputs = {"motion": ", ".join(map(str, folders)), "reference": str(reference)}
    return make_results(inputs, {_folder_name(reference): section})


def evaluate_checkpoint(
    checkpoint: str | pathlib.Path,
    data: str | os.PathLike,
    *,
    splits: Sequence[str] | None = None,
    autoencoder: str | os.PathLike | None = None,
    legacy: bool = False,
    look_ahead: int | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Score the motion that a checkpoint makes for the speech of a corpus against its true motion.

    Args:
        checkpoint: "demo", a workdir or a model folder.
        data: "talk" or the folder of a corpus.
        splits: splits to score; by default those of `TEST_SPLITS` that have a clip, or else "val". Of the training
            split as many clips are scored as the largest other split has.
        autoencoder: workdir or folder of a pose auto-encoder, for FGD and diversity.
        look_ahead: frames of speech that are heard beyond each frame, as in a stream; by default the whole clip.

    Returns:
        As `make_results`, with one section for each split; the row of the checkpoint is called "model". On a corpus
        with known causes a section has also "known_causes", see `talk_scores.score_known_causes`.

    Raises:
        UserError: the checkpoint, the corpus, a split or the auto-encoder cannot be used.
    """
    from ha2g_jax import synthesis
    from ha2g_jax.evaluation.talk_scores import has_known_causes, score_known_causes

    with stage("loading the model"):
        features, model = _features(autoencoder), synthesis.load(checkpoint)
    corpus = Corpus.open(build.talk_path(str(data)))
    # Before motion is generated:
    check_fit(model, corpus)
    check_autoencoder(features, corpus.skeleton, corpus.fps)
    if legacy:
        check_rate(corpus.fps)
    limits = split_limits(corpus, _choose_splits(corpus) if splits is None else splits)
    training = None
    if corpus.has_clips(TRAIN):
        training = training_motion(corpus, limit=_TRAINING_CLIPS, seed=seed)
    sections, streams = {}, {}
    for name, most in limits.items():
        motions, truth = from_corpus(
            model, corpus, name, seed=seed, limit=most, with_audio=legacy, look_ahead=look_ahead
        )
        if look_ahead is not None:
            streams[name] = motions
        sections[name] = evaluate(
            {"model": motions},
            truth,
            corpus.skeleton,
            training=training,
            autoencoder=features,
            legacy=legacy,
            seed=seed,
            notes=_given(model.spec.num_seed_frames) if look_ahead is None else (),
        )
    if has_known_causes(corpus):
        known = score_known_causes(model, corpus, limits, seed, look_ahead, streams=streams)
        sections = {name: section | {"known_causes": known[name]} for name, section in sections.items()}
    inputs = {"checkpoint": str(checkpoint), "model": model.assets.hash, "data": str(data)}
    inputs["corpus"] = corpus.metadata["name"]
    if look_ahead is not None:
        inputs["look_ahead"] = f"{look_ahead} frames"
    return make_results(inputs, sections)


def _given(seed_frames: int) -> list[str]:
    """Return a sentence if the model was given more than four poses, so that some given frames are scored."""
    if seed_frames <= SEED_FRAMES:
        return []
    return [
        f"the model is given the true poses of the first {seed_frames} frames, but scores begin at frame "
        f"{SEED_FRAMES}: it knew those of the first {seed_frames - SEED_FRAMES} scored frames of each clip"
    ]


def evaluate_recording(
    checkpoint: str | pathlib.Path,
    speech: str | os.PathLike,
    *,
    motion: str | os.PathLike | None = None,
    skeleton: str | None = None,
    seed: int = 0,
    **reading: Unpack[Reading],
) -> dict[str, Any]:
    """Score the motion of a file, or else that which a checkpoint makes in a random style, for a recording of speech.

    Args:
        checkpoint: "demo", a workdir or a model folder, if there is no `motion`.
        motion: file of motion, read with `skeleton` and `reading` as in `evaluate_folders`.

    Returns:
        As `make_results`, with one section under the name of the file. It has no "rows", which need true motion: the
        scores of the strokes are in "recording", {"rows": {"model": {metric: {"value", "low", "high", "error"}}}}.

    Raises:
        UserError: a file or the checkpoint cannot be used, there are less than 10 s of speech or of motion, or the
            lengths of the two differ so much that they cannot belong together.
    """
    from ha2g_jax import synthesis

    if motion is not None:
        check_reading([pathlib.Path(motion)], **reading)
    audio, warnings = read_audio(pathlib.Path(speech)), []
    _check_long_enough(speech, len(audio) / SAMPLE_RATE, "sound")
    if motion is None:
        with stage("loading the model"):
            model = synthesis.load(checkpoint)
        with stage("generating the motion"):
            directions = model.generate(audio, style=synthesis.Style(variation=0), seed=seed).directions
        fps, first_frame, body = model.fps, model.spec.num_seed_frames, model.spec.skeleton
        inputs = {"checkpoint": str(checkpoint), "model": model.assets.hash}
    else:
        body = load_skeleton(skeleton or read_motion(motion, **reading).meta["skeleton"])
        read = read_directions(pathlib.Path(motion), body.name, **reading)
        directions, fps, first_frame, inputs = read.directions, FPS, 0, {"motion": shown(motion)}
        seconds = len(directions) / FPS
        warnings += filter(None, [compare_lengths(pathlib.Path(motion), seconds, read.fps, audio)])
        _check_long_enough(motion, seconds, "motion")
    places = directions_to_positions(body, directions.astype(np.float64))
    row = strokes.recording_row(audio, upper_body(body, places, fps), first_frame)
    name = "model" if motion is None else "motion"
    section = {
        "methods": [name],
        "rows": {},
        "differences": {},
        "counts": {},
        "data": {
            "clips": 1,
            "recordings": 1,
            "seconds": round(row.seconds, 2),
            "windows": None,
            "skeleton": body.name,
            "fps": fps,
        },
        "settings": {"first_frame": first_frame, "seed": seed, "draws": 0, "level": LEVEL},
        "autoencoder": None,
        "flags": [],
        "warnings": warnings,
        "notes": [],
        "recording": {
            "rows": {name: {key: score_as_json(score) for key, score in measure(row, "recording").items()}},
            "notes": [
                "the mismatched speech is the recording rotated in time; intervals are 1.96 standard errors by "
                f"segments of {strokes.SEGMENT:g} s",
            ],
        },
    }
    return make_results(inputs | {"speech": shown(speech)}, {shown(pathlib.Path(speech).name): section})


def _check_long_enough(path: str | os.PathLike, seconds: float, of: str) -> None:
    if seconds < MIN_SECONDS:
        raise UserError(f"{shown(path)} has {seconds:.1f} s of {of}; expected at least {MIN_SECONDS:g} s")


def make_results(inputs: Mapping[str, str], sections: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Combine inputs and sections, which `evaluate` returns, into results, the form that `table` and JSON use.

    Returns:
        {"version", "inputs", "metrics": {name: {"title", "unit", "direction"}} of all scores, "sections"}.

    Raises:
        UserError: a score has a name that no metric is registered under.
    """
    names = dict.fromkeys(name for section in sections.values() for name in _score_names(section))
    found = {name: metrics.lookup(name) for name in names}
    return {
        "version": __version__,
        "inputs": dict(inputs),
        "metrics": {
            name: {"title": metric.title, "unit": metric.unit, "direction": metric.direction}
            for name, metric in found.items()
        },
        "sections": dict(sections),
    }


def _score_names(section: Mapping[str, Any]) -> list[str]:
    parts = [section["rows"], section["differences"]]
    parts += [section[part]["rows"] for part in PARTS if part in section]
    return [name for rows in parts for row in rows.values() for name in row]


def _choose_splits(corpus: Corpus) -> list[str]:
    chosen = [name for name in TEST_SPLITS if corpus.has_clips(name)]
    if chosen:
        return chosen
    if corpus.has_clips(OTHER_SPLIT):
        return [OTHER_SPLIT]
    expected = ", ".join((*TEST_SPLITS, OTHER_SPLIT))
    raise UserError(f"{corpus.path} has no clip in a split {expected}; name one of {', '.join(corpus.splits)}")


def _folder_name(folder: str | os.PathLike) -> str:
    return shown(resolved(folder).name)


def _row_names(folders: Sequence[str | os.PathLike]) -> list[str]:
    """Return the name of each folder, with that of the parent folder if two are equal."""
    found = [_folder_name(folder) for folder in folders]
    names = [
        name if found.count(name) == 1 else f"{_folder_name(resolved(folder).parent)}/{name}"
        for name, folder in zip(found, folders, strict=True)
    ]
    if len(set(names)) < len(names):
        raise UserError(f"two folders of motion have one name, of {', '.join(names)}; give folders of different names")
    return names


def _features(autoencoder: str | os.PathLike | None):
    if autoencoder is None:
        return None
    from ha2g_jax.evaluation.features import PoseFeatures

    return PoseFeatures(autoencoder)

"""What `ha2g evaluate` calls: folders of motion, or a checkpoint on a corpus, to results."""

import os
import pathlib
from typing import Any

from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.mocap.joint_maps import AUTO
from ha2g_jax.data.talk import build
from ha2g_jax.errors import UserError
from ha2g_jax.study.evaluation.evaluate import evaluate
from ha2g_jax.study.evaluation.motion_folders import from_folders
from ha2g_jax.study.evaluation.performance import from_corpus, training_motion

SPLITS = ("test", "val")  # of which the first that there is is scored

_TRAINING_CLIPS = 400  # whose motion sets the mean pose, usual changes and limits of angles


def evaluate_folders(
    motion: str | os.PathLike,
    reference: str | os.PathLike,
    *,
    autoencoder: str | os.PathLike | None = None,
    legacy: bool = False,
    skeleton: str | None = None,
    joint_map: str = AUTO,
    seed: int = 0,
) -> dict[str, Any]:
    """Scores the motion in a folder, made by any system, against that in another one, paired by names of files.

    Args:
        motion, reference: folders; see `motion_folders.from_folders`.
        autoencoder: a workdir or a folder of a pose auto-encoder, for FGD and diversity.
        legacy: whether to add the legacy scores.
        skeleton: "ted_expressive" or "ted_gesture"; by default that of the auto-encoder, or else of the files.
        joint_map: see `motion_files`.
        seed: of everything random.

    Returns:
        As `evaluation.evaluate`; the row of the motion is called as its folder.

    Raises:
        UserError: a folder, a file or the auto-encoder cannot be used.
    """
    features = _features(autoencoder)
    if skeleton is None and features is not None:
        skeleton = features.skeleton.name
    folders = from_folders(motion, reference, skeleton=skeleton, joint_map=joint_map, with_audio=legacy)
    name = pathlib.Path(motion).resolve().name
    results = evaluate(
        {name: folders.motion},
        folders.reference,
        folders.skeleton,
        autoencoder=features,
        legacy=legacy,
        seed=seed,
        notes=folders.notes,
    )
    return {"motion": str(motion), "reference": str(reference), **results}


def evaluate_checkpoint(
    checkpoint: str | pathlib.Path,
    data: str | os.PathLike,
    *,
    split: str | None = None,
    autoencoder: str | os.PathLike | None = None,
    legacy: bool = False,
    limit: int | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Scores what a checkpoint performs for the speech of a corpus against its true motion.

    Args:
        checkpoint: "demo", a workdir or a model folder.
        data: "talk" or the folder of a corpus.
        split: by default the first of `SPLITS` that has a clip.
        autoencoder: a workdir or a folder of a pose auto-encoder, for FGD and diversity.
        legacy: whether to add the legacy scores.
        limit: clips at most, drawn at random; all by default.
        seed: of everything random.

    Returns:
        As `evaluation.evaluate`; the row of the checkpoint is called "model".

    Raises:
        UserError: the checkpoint, the corpus, its split or the auto-encoder cannot be used.
    """
    from ha2g_jax import synthesis

    features = _features(autoencoder)
    model = synthesis.load(checkpoint)
    corpus = Corpus.open(build.talk_path(str(data)))
    chosen = split or next((name for name in SPLITS if corpus.has_clips(name)), None)
    if chosen is None:
        raise UserError(f"{corpus.path} has no split {' or '.join(SPLITS)}; name one of {', '.join(corpus.splits)}")
    motions, truth = from_corpus(model, corpus, chosen, seed=seed, limit=limit, with_audio=legacy)
    training = None
    if corpus.has_clips(TRAIN):
        training = training_motion(corpus, TRAIN, limit=_TRAINING_CLIPS, seed=seed)
    results = evaluate(
        {"model": motions},
        truth,
        corpus.skeleton,
        training=training,
        autoencoder=features,
        legacy=legacy,
        seed=seed,
    )
    names = {"checkpoint": str(checkpoint), "model": model.assets.hash, "corpus": corpus.metadata["name"]}
    return {**names, "split": chosen, **results}


def knows_strokes(data: str | os.PathLike) -> bool:
    """Whether a corpus knows what caused its motion, so that `study.talk` can score it too.

    Raises:
        UserError: there is no corpus.
    """
    corpus = Corpus.open(build.talk_path(str(data)))
    split = next((name for name in corpus.splits if corpus.has_clips(name)), None)
    return split is not None and bool(corpus.clips(split).fields(0)["style"])


def _features(autoencoder: str | os.PathLike | None):
    if autoencoder is None:
        return None
    from ha2g_jax.study.evaluation.features import PoseFeatures

    return PoseFeatures(pathlib.Path(autoencoder))

"""Inputs of a run, from its config: corpus, windows, batches, initial weights, seed poses and styles."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grain
import jax
import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import model_folder, weights, whisper
from ha2g_jax.checkpoint.weights import TABLE, in_vocabulary, is_word_table
from ha2g_jax.config.settings import Config, check_fps
from ha2g_jax.data.augment import Augmentation
from ha2g_jax.data.batches import batches
from ha2g_jax.data.corpus import TRAIN, Corpus, corpus_folder
from ha2g_jax.data.windows import NoWindow, Windows
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.features.word_vectors import read_word_vectors
from ha2g_jax.methods import encode_identity, variable_shapes
from ha2g_jax.methods.method import Spec

VALIDATION = "val"

_IDENTITY = "identity"  # name of the network E_ID
_NUM_SEED_POSES, _CLIPS_PER_SPEAKER = 16, 8


def open_corpus(config: Config) -> Corpus:
    """Open the corpus of a config; the Talk corpus ("talk") must have been built by `data.talk.build.talk_path`.

    Raises:
        UserError: there is no corpus, it is damaged, or its skeleton or frame rate differs from that of the config.
    """
    if not config.data.path:
        raise UserError("config.data.path is empty: set --config.data.path to 'talk' or to the folder of a corpus")
    corpus = Corpus.open(corpus_folder(config.data.path))
    check_fps(corpus.fps, f"the frame rate of {corpus.path}")
    found, expected = (corpus.skeleton.name, corpus.fps), (config.skeleton, config.data.fps)
    if found != expected:
        raise UserError(
            f"{corpus.path} has skeleton {found[0]} at {found[1]:g} fps, "
            f"the config {expected[0]} at {expected[1]:g} fps: choose a config that fits the data, "
            f"or set --config.skeleton={found[0]} --config.data.fps={found[1]:g}"
        )
    return corpus


def open_windows(config: Config, spec: Spec, corpus: Corpus, split: str) -> Windows:
    """Return the windows of a split in the shapes that a model takes; the words are those of the training split.

    A model with a table of speakers has rows for the speakers of the training split only, so that clips of other
    speakers are left out.

    Raises:
        UserError: the split has no clips that the model can use, or lacks inputs of the model.
    """
    return Windows(
        corpus,
        split,
        corpus.vocabulary(),
        num_frames=spec.num_frames,
        inputs=spec.training_inputs,
        num_reference_images=spec.num_reference_images,
        image_size=spec.image_size if spec.identity == "images" else None,
        among=frozenset(corpus.speakers_of(TRAIN)) if spec.identity == "speaker" else None,
        cache_bytes=int(config.data.cache_gib * 2**30),
    )


def open_validation(config: Config, spec: Spec, corpus: Corpus) -> Windows | None:
    """Return the windows of the validation split, None if the corpus has none that the model can use.

    Raises:
        UserError: the split cannot be used.
    """
    if not corpus.has_clips(VALIDATION):
        return None
    try:
        return open_windows(config, spec, corpus, VALIDATION)
    except NoWindow:
        return None


def training_batches(config: Config, windows: Windows, first: int) -> grain.DatasetIterator:
    """Return this host's part of the training batches from number `first` on; see `ha2g_jax.data.batches`."""
    data = config.data
    return batches(
        windows,
        config.train.batch_size,
        config.seed,
        augmentation=Augmentation(
            jitter=data.jitter,
            mirror=data.mirror,
            vocal_tract=data.vocal_tract,
            equalizer_db=data.equalizer_db,
            reverb=data.reverb,
            gain_db=data.gain_db,
            noise=data.noise,
            noise_snr_db=tuple(data.noise_snr_db),
            lookahead=data.lookahead,
            least_heard=data.num_seed_frames,
        ),
        first=first,
        host=jax.process_index(),
        num_hosts=jax.process_count(),
        workers=data.workers,
    )


def pretrained(config: Config, spec: Spec, vocabulary: Vocabulary) -> dict[str, Any]:
    """Read the weights that the config names, which replace random ones: those of a model or of parts of one.

    They are a part of the tree {"params", "batch_stats"} of the generator.

    Raises:
        UserError: a model or a file cannot be used, or does not fit the config.
    """
    text, audio = config.model.text, config.model.audio
    if audio.weights and (audio.kind != "whisper" or config.train.init_from):
        raise UserError(
            "config.model.audio.weights is read only with --config.model.audio.kind=whisper and without "
            "--config.train.init_from; leave it out"
        )
    if source := config.train.init_from:
        if text.vectors:
            raise UserError(
                f"the words of {source} have vectors already: leave out --config.model.text.vectors or "
                "--config.train.init_from"
            )
        return initial_variables(source, spec, vocabulary)
    parts = {}
    if text.vectors:
        if not {"words", "plain_words"} & set(spec.training_inputs):
            raise UserError(f"{config.method} reads no words: leave out --config.model.text.vectors")
        parts |= word_table(spec, read_word_vectors(text.vectors, vocabulary, text.embedding_dim))
    if audio.kind == "whisper":
        parts |= {"audio": {"whisper": _whisper(audio)}}
    return {"params": parts}


def word_table(spec: Spec, vectors: np.ndarray) -> dict[str, Any]:
    """Return parameters of a generator whose word embeddings start from vectors (vocabulary, embedding_dim)."""
    names = [name.removeprefix("params/") for name in weights.flatten(variable_shapes(spec)) if is_word_table(name)]
    return traverse_util.unflatten_dict(dict.fromkeys(names, vectors), sep="/")


def _whisper(audio: Config) -> dict[str, Any]:
    if not audio.weights:
        raise UserError(
            "config.model.audio.kind is 'whisper' but config.model.audio.weights is empty: set it to a folder with the "
            "config.json and model.safetensors of openai/whisper-tiny.en"
        )
    found, params = whisper.load(audio.weights)
    expected = whisper.WhisperSizes(**audio.whisper)
    if odd := [name for name in found._fields if getattr(found, name) != getattr(expected, name)]:
        settings = " ".join(f"--config.model.audio.whisper.{name}={getattr(found, name)}" for name in odd)
        raise UserError(f"{audio.weights} has an encoder of another size than the config: set {settings}")
    return params


def initial_variables(source: str, spec: Spec, vocabulary: Vocabulary) -> dict[str, Any]:
    """Read the weights of a model as the initial ones of a generator for other words and speakers.

    A word that the model knows keeps its vector; every other word starts with that of unknown words. The table of
    speakers is left out, so that it starts at random, and so is all of E_ID if either the model or the generator
    encodes images and the other has a table. The result is a part of the tree {"params", "batch_stats"} of the
    generator.

    Raises:
        UserError: there is no such model, or it has another method, skeleton or size than the generator.
    """
    model = model_folder.load(source)
    if model.spec.method != spec.method:
        raise UserError(
            f"{source} is a model of {model.spec.method}, but the config of {spec.method}: name a preset of its "
            f"method, as --config {model.spec.method}:bvh:medium"
        )
    if model.spec.skeleton.bones != spec.skeleton.bones:
        raise UserError(f"{source} has skeleton {model.spec.skeleton.name}, but the config has {spec.skeleton.name}")
    found = weights.flatten(model.variables)
    for name in filter(is_word_table, found):
        found[name] = in_vocabulary(found[name], model.assets.vocabulary, vocabulary)
    has_same_kind = model.spec.identity == spec.identity
    expected = {name: leaf.shape for name, leaf in weights.flatten(variable_shapes(spec)).items()}
    found, expected = (
        {name: value for name, value in tree.items() if not _is_new(name, has_same_kind)} for tree in (found, expected)
    )
    if difference := weights.compare({name: array.shape for name, array in found.items()}, expected):
        raise UserError(
            f"{source} has other networks than the config ({difference}): give the preset or the settings "
            "config.model that it was trained with"
        )
    return traverse_util.unflatten_dict(found, sep="/")


def _is_new(name: str, has_same_kind: bool) -> bool:
    """Return whether a variable belongs to the speakers of one corpus, and so starts anew on another."""
    is_identity = name.split("/")[1] == _IDENTITY
    return (name.endswith(TABLE) and not is_word_table(name)) or (is_identity and not has_same_kind)


def calm_seed_poses(windows: Windows, mean_directions: np.ndarray, num_frames: int) -> np.ndarray:
    """Return calm seed poses (K, M, bones, 3): those that move least among the starts of windows near the mean pose.

    There are at most 16, and at most one from each clip; the mean directions are (bones, 3).
    """
    distance, motion = np.zeros((2, len(windows)), np.float32)
    for index in range(len(windows)):  # one at a time, because together they are as large as the motion of the corpus
        start = windows.directions(index)[:num_frames]
        distance[index] = np.linalg.norm(start - mean_directions, axis=-1).mean()
        motion[index] = np.linalg.norm(np.diff(start, axis=0), axis=-1).sum(axis=0).mean()
    near = np.argsort(distance, kind="stable")[: max(_NUM_SEED_POSES, len(windows) // 4)]
    calmest: dict[int, int] = {}
    for index in near[np.argsort(motion[near], kind="stable")]:
        calmest.setdefault(windows.clip_index(index), index)
    return np.stack([windows.directions(index)[:num_frames] for index in list(calmest.values())[:_NUM_SEED_POSES]])


def speaker_styles(spec: Spec, variables: dict[str, Any], windows: Windows, names: list[str]) -> dict[str, np.ndarray]:
    """Return the style (style_dim,) of every speaker, the output of E_ID, averaged over at most eight training clips.

    Windows and names, by index, are those of the training split; a method without identities has no styles.
    """
    if not spec.identity:
        return {}
    variables = jax.device_put(variables)  # once, and not for each image

    def style(speaker):
        if spec.identity == "speaker":
            return np.asarray(encode_identity(spec, variables, np.int32(speaker)))
        images = windows.reference_images(speaker, limit=_CLIPS_PER_SPEAKER)
        return np.mean([encode_identity(spec, variables, image) for image in images], axis=0)

    with ThreadPoolExecutor() as pool:  # threads decode images in parallel
        return dict(zip(names, pool.map(style, range(len(names))), strict=True))

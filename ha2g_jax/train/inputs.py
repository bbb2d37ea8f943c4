"""Inputs of a run as its config states them: corpus, windows, batches and pretrained parameters."""

from typing import Any

import grain
import numpy as np
from flax import traverse_util

from ha2g_jax.checkpoint import weights
from ha2g_jax.checkpoint.word_tables import is_word_table
from ha2g_jax.config.settings import Config, check_fps
from ha2g_jax.data.augment import Augmentation
from ha2g_jax.data.batches import batches
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk.build import talk_path
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.features.word_vectors import read_word_vectors
from ha2g_jax.methods import whisper_weights
from ha2g_jax.methods.build import variable_shapes
from ha2g_jax.methods.method import Spec
from ha2g_jax.train.initial_model import initial_variables

VALIDATION = "val"


def open_corpus(config: Config) -> Corpus:
    """Open the corpus of a config; the Talk corpus ("talk") is made if it does not exist yet.

    Args:
        config: settings of the run.

    Raises:
        UserError: there is no corpus, it is damaged, or its skeleton or frame rate differs from that of the config.
    """
    if not config.data.path:
        raise UserError("config.data.path is empty: set --config.data.path to 'talk' or to the folder of a corpus")
    corpus = Corpus.open(talk_path(config.data.path))
    check_fps(corpus.fps, f"the frame rate of {corpus.path}")
    found, expected = (corpus.skeleton.name, corpus.fps), (config.skeleton, config.data.fps)
    if found != expected:
        raise UserError(
            f"{corpus.path} has skeleton {found[0]} at {found[1]:g} fps, "
            f"the config {expected[0]} at {expected[1]:g} fps: choose a config that fits the data"
        )
    return corpus


def open_windows(config: Config, spec: Spec, corpus: Corpus, vocabulary: Vocabulary, split: str) -> Windows:
    """Return the windows of a split in the shapes that a model takes.

    A model with a table of speakers has rows for the speakers of the training split only, so that clips of other
    speakers are left out.

    Args:
        config: settings of the run.
        spec: networks and sizes.
        corpus: corpus that has the split.
        vocabulary: words of the training split.
        split: name of the split.

    Raises:
        UserError: the split has no clips that the model can use, or lacks inputs of the model.
    """
    return Windows(
        corpus,
        split,
        vocabulary,
        num_frames=spec.num_frames,
        inputs=spec.training_inputs,
        num_reference_images=spec.num_reference_images,
        image_size=spec.image_size if spec.identity == "images" else None,
        among=frozenset(corpus.speakers_of(TRAIN)) if spec.identity == "speaker" else None,
        cache_bytes=int(config.data.cache_gib * 2**30),
    )


def open_validation(config: Config, spec: Spec, corpus: Corpus, vocabulary: Vocabulary) -> Windows | None:
    """Return the windows of the validation split, None if the corpus has none that the model can use.

    Args:
        config, spec, corpus, vocabulary: see `open_windows`.

    Raises:
        UserError: the split cannot be used.
    """
    if not corpus.has_clips(VALIDATION):
        return None
    is_known = set(corpus.speakers_of(VALIDATION)) & set(corpus.speakers_of(TRAIN))
    if spec.identity == "speaker" and not is_known:
        return None
    return open_windows(config, spec, corpus, vocabulary, VALIDATION)


def training_batches(
    config: Config, windows: Windows, first: int, host: int = 0, num_hosts: int = 1
) -> grain.DatasetIterator:
    """Return this host's part of the training batches; see `ha2g_jax.data.batches`.

    Args:
        config: settings of the run.
        windows: windows of the training split.
        first: number of the first batch.
        host: number of this host, from 0.
        num_hosts: number of hosts.
    """
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
        host=host,
        num_hosts=num_hosts,
        workers=data.workers,
    )


def pretrained(config: Config, spec: Spec, vocabulary: Vocabulary) -> dict[str, Any]:
    """Read the weights that the config names, of a model or of parts of one, which take the place of random ones.

    Args:
        config: settings of the run.
        spec: networks and sizes.
        vocabulary: words of the training split.

    Returns:
        A part of the tree {"params", "batch_stats"} of the generator.

    Raises:
        UserError: a model or a file cannot be used, or does not fit the config.
    """
    text, audio = config.model.text, config.model.audio
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
        vectors = read_word_vectors(text.vectors, vocabulary, text.embedding_dim)
        parts |= word_table(config, spec, len(vocabulary), vectors)
    if audio.kind == "whisper":
        parts |= {"audio": {"whisper": _whisper(audio)}}
    return {"params": parts}


def word_table(config: Config, spec: Spec, vocabulary_size: int, word_vectors: np.ndarray) -> dict[str, Any]:
    """Return pretrained parameters of a generator whose word embeddings start from word vectors.

    Args:
        config: settings of the model.
        spec: networks and sizes.
        vocabulary_size: number of words.
        word_vectors: (vocabulary_size, embedding_dim) vector of each word.

    Raises:
        UserError: the shape of the vectors is not that of the embedding.
    """
    table = (vocabulary_size, config.model.text.embedding_dim)
    if word_vectors.shape != table:
        raise UserError(
            f"word vectors have shape {word_vectors.shape}, expected {table}: "
            f"set --config.model.text.embedding_dim={word_vectors.shape[-1]}"
        )
    names = [name.removeprefix("params/") for name in weights.flatten(variable_shapes(spec)) if is_word_table(name)]
    return traverse_util.unflatten_dict(dict.fromkeys(names, word_vectors), sep="/")


def _whisper(audio: Config) -> dict[str, Any]:
    if not audio.weights:
        raise UserError(
            "config.model.audio.kind is 'whisper' but config.model.audio.weights is empty: set it to a folder with the "
            "config.json and model.safetensors of openai/whisper-tiny.en"
        )
    found, params = whisper_weights.load(audio.weights)
    expected = whisper_weights.WhisperSizes(**audio.whisper)
    if odd := [name for name in found._fields if getattr(found, name) != getattr(expected, name)]:
        settings = " ".join(f"--config.model.audio.whisper.{name}={getattr(found, name)}" for name in odd)
        raise UserError(f"{audio.weights} has an encoder of another size than the config: set {settings}")
    return params

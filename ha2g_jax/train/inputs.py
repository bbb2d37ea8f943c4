"""What a run reads, as its config asks for it: corpus, windows, batches and pretrained parameters."""

from typing import Any

import grain

from ha2g_jax.config import Config
from ha2g_jax.data.augment import Augmentation
from ha2g_jax.data.batches import batches
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk.build import talk_path
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.features.word_vectors import read_word_vectors
from ha2g_jax.methods import whisper_weights
from ha2g_jax.methods.building import find_method, word_table

VALIDATION = "val"


def open_corpus(config: Config) -> Corpus:
    """The corpus of a config; "talk" is made where there is none yet.

    Raises:
        UserError: there is none, it is damaged, or it has another skeleton or frame rate than the config.
    """
    if not config.data.path:
        raise UserError("the config names no data: set --config.data.path to 'talk' or to the folder of a corpus")
    corpus = Corpus.open(talk_path(config.data.path))
    found, expected = (corpus.skeleton.name, corpus.fps), (config.skeleton, config.data.fps)
    if found != expected:
        raise UserError(
            f"{corpus.path} has skeleton {found[0]} at {found[1]:g} fps, "
            f"the config {expected[0]} at {expected[1]:g} fps: choose the config that fits the data"
        )
    return corpus


def open_windows(config: Config, corpus: Corpus, vocabulary: Vocabulary, split: str) -> Windows:
    """The windows of a split in the shapes that the config asks for.

    A table of speakers knows those of training alone: with it, the clips of others are left out.

    Raises:
        UserError: the split does not have them.
    """
    kind = config.model.identity.kind
    return Windows(
        corpus,
        split,
        vocabulary,
        num_frames=config.data.num_frames,
        inputs=find_method(config).inputs(config),
        num_reference_frames=config.data.num_reference_frames,
        image_size=config.data.image_size if kind == "images" else None,
        among=frozenset(corpus.speakers_of(TRAIN)) if kind == "speakers" else None,
        cache_bytes=int(config.data.cache_gib * 2**30),
    )


def open_validation(config: Config, corpus: Corpus, vocabulary: Vocabulary) -> Windows | None:
    """The windows of the validation split, None where the corpus has none of a speaker that the model can know.

    Raises:
        UserError: the split cannot be used.
    """
    if not corpus.has_clips(VALIDATION):
        return None
    is_known = set(corpus.speakers_of(VALIDATION)) & set(corpus.speakers_of(TRAIN))
    if config.model.identity.kind == "speakers" and not is_known:
        return None
    return open_windows(config, corpus, vocabulary, VALIDATION)


def training_batches(
    config: Config, windows: Windows, first: int, host: int = 0, num_hosts: int = 1
) -> grain.DatasetIterator:
    """This host's part of the batches of training, from batch `first` on; see `ha2g_jax.data.batches`."""
    data = config.data
    return batches(
        windows,
        config.train.batch_size,
        config.seed,
        augmentation=Augmentation(data.jitter, data.mirror, data.gain_db, data.noise, tuple(data.noise_snr_db)),
        first=first,
        host=host,
        num_hosts=num_hosts,
        workers=data.workers,
    )


def pretrained(config: Config, vocabulary: Vocabulary) -> dict[str, Any]:
    """The parameters to start from that the config names files of; {} where it names none.

    Raises:
        UserError: a file cannot be used, or does not fit the model.
    """
    text, audio = config.model.text, config.model.audio
    parts = {}
    if text.vectors:
        if not {"words", "plain_words"} & set(find_method(config).inputs(config)):
            raise UserError(f"{config.method} reads no words: leave --config.model.text.vectors out")
        vectors = read_word_vectors(text.vectors, vocabulary, text.embedding_dim)
        parts |= word_table(config, len(vocabulary), vectors)
    if audio.kind == "whisper":
        parts |= {"audio": {"whisper": _whisper(audio)}}
    return parts


def _whisper(audio: Config) -> dict[str, Any]:
    if not audio.weights:
        raise UserError(
            "config.model.audio.kind is 'whisper' but no weights are named: set --config.model.audio.weights to a "
            "folder with the config.json and model.safetensors of openai/whisper-tiny.en"
        )
    found, params = whisper_weights.load(audio.weights)
    expected = whisper_weights.WhisperSizes(**audio.whisper)
    if odd := [name for name in found._fields if getattr(found, name) != getattr(expected, name)]:
        settings = " ".join(f"--config.model.audio.whisper.{name}={getattr(found, name)}" for name in odd)
        raise UserError(f"{audio.weights} has an encoder of another size than the config: set {settings}")
    return params

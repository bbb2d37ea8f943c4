"""What a run reads, as its config asks for it: corpus, windows, batches and word vectors."""

import grain
import numpy as np

from ha2g_jax.config import Config
from ha2g_jax.data.augment import Augmentation
from ha2g_jax.data.batches import batches
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk.build import talk_path
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.text import Vocabulary
from ha2g_jax.word_vectors import read_word_vectors

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
    has_images = config.model.identity.kind == "images"
    return Windows(
        corpus,
        split,
        vocabulary,
        num_frames=config.data.num_frames,
        num_reference_frames=config.data.num_seed_frames,
        image_size=config.data.image_size if has_images else None,
        among=None if has_images else frozenset(corpus.speakers_of(TRAIN)),
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
    if config.model.identity.kind != "images" and not is_known:
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


def word_vectors(config: Config, vocabulary: Vocabulary) -> np.ndarray | None:
    """(words, embedding_dim) float32 from the file that the config names, None where it names none."""
    text = config.model.text
    return read_word_vectors(text.vectors, vocabulary, text.embedding_dim) if text.vectors else None

"""Inputs of a run on a corpus with unusual splits."""

import dataclasses

import pytest

from ha2g_jax.config import settings as configs
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.methods.build import build
from ha2g_jax.train import inputs


@pytest.fixture
def config():
    return configs.debug(configs.paper("ted_expressive"))


def spec_of(config, corpus):
    """Build the networks of a config on a corpus."""
    return build(config, corpus.skeleton, len(corpus.vocabulary()), len(corpus.speakers_of("train")))


def divide(tiny_talk, path, **splits: str):
    """Write a corpus whose splits have one clip of each named speaker."""
    clip = Corpus.open(tiny_talk).clips("train")[0]
    with CorpusWriter(path, splits=tuple(splits), skeleton="ted_expressive", fps=15, metadata={}) as writer:
        for split, speaker in splits.items():
            if speaker:
                writer.add(split, encode_clip(dataclasses.replace(clip, speaker=speaker, id=split)))
    return Corpus.open(path)


def test_without_a_validation_split(config, tiny_talk, tmp_path):
    """A corpus of one recording cannot be split, so that a run has no validation."""
    for number, splits in enumerate(({"train": "ada"}, {"train": "ada", "val": ""})):
        corpus = divide(tiny_talk, tmp_path / str(number), **splits)
        assert inputs.open_validation(config, spec_of(config, corpus), corpus, corpus.vocabulary()) is None


def test_a_table_knows_the_speakers_of_training(config, tiny_talk, tmp_path):
    """With images any speaker can be used for validation; with a table only those that have a row."""
    corpus = divide(tiny_talk, tmp_path / "corpus", train="ada", val="ben", test="ada")
    with_images = inputs.open_validation(config, spec_of(config, corpus), corpus, corpus.vocabulary())
    assert with_images is not None
    assert len(with_images) > 0
    config.model.identity.kind = "speakers"
    spec = spec_of(config, corpus)
    assert inputs.open_validation(config, spec, corpus, corpus.vocabulary()) is None
    assert inputs.open_windows(config, spec, corpus, corpus.vocabulary(), "test").speakers() == {0}
    with pytest.raises(UserError, match="no clip of a speaker of training in split 'val'"):
        inputs.open_windows(config, spec, corpus, corpus.vocabulary(), "val")

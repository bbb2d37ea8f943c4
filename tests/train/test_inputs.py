"""Inputs of a run on a corpus with unusual splits."""

import dataclasses
import shutil

import jax
import numpy as np
import pytest
from fixtures.corpora import write_corpus

from ha2g_jax import cli
from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.config import presets
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import UNKNOWN, Vocabulary
from ha2g_jax.methods import build, variable_shapes
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train import inputs
from ha2g_jax.train.inputs import initial_variables


@pytest.fixture
def config():
    return presets.sized("ted_expressive", "debug")


def spec_of(config, corpus):
    """Build the networks of a config on a corpus."""
    return build(config, corpus.skeleton, len(corpus.vocabulary()), len(corpus.speakers_of("train")))


def divide(tiny_talk, path, **splits: str):
    """Write a corpus whose splits have one clip of each named speaker."""
    clip = Corpus.open(tiny_talk).clips("train")[0]
    clips = {
        split: [dataclasses.replace(clip, speaker=speaker, id=split)] if speaker else []
        for split, speaker in splits.items()
    }
    return Corpus.open(write_corpus(path, clips, skeleton="ted_expressive"))


def test_without_a_validation_split(config, tiny_talk, tmp_path):
    """A corpus of one recording cannot be split, so that a run has no validation."""
    for number, splits in enumerate(({"train": "ada"}, {"train": "ada", "val": ""})):
        corpus = divide(tiny_talk, tmp_path / str(number), **splits)
        assert inputs.open_validation(config, spec_of(config, corpus), corpus) is None


def test_with_validation_clips_shorter_than_a_window(config, tiny_talk, tmp_path):
    clip = Corpus.open(tiny_talk).clips("train")[0]
    clips = {"train": [clip], "val": [dataclasses.replace(clip, id="short", positions=clip.positions[:33])]}
    corpus = Corpus.open(write_corpus(tmp_path / "corpus", clips, skeleton="ted_expressive"))
    assert inputs.open_validation(config, spec_of(config, corpus), corpus) is None


def test_a_table_knows_the_speakers_of_training(config, tiny_talk, tmp_path):
    """With images any speaker can be used for validation; with a table only those that have a row."""
    corpus = divide(tiny_talk, tmp_path / "corpus", train="ada", val="ben", test="ada")
    with_images = inputs.open_validation(config, spec_of(config, corpus), corpus)
    assert with_images is not None
    assert len(with_images) > 0
    config.model.identity.kind = "speakers"
    spec = spec_of(config, corpus)
    assert inputs.open_validation(config, spec, corpus) is None
    windows = inputs.open_windows(config, spec, corpus, "test")
    assert {int(windows[index]["speaker"]) for index in range(len(windows))} == {0}
    with pytest.raises(UserError, match="no clip of a speaker of training in split 'val'"):
        inputs.open_windows(config, spec, corpus, "val")


WORDS = "params/text/embedding/embedding"


def spec_for(*words: str, kind="images", hidden_dim=128):
    """Return the vocabulary of some words and networks for it, by default of the demo's method and size."""
    config = model_folder.load("demo").config.copy_and_resolve_references()
    config.model.identity.kind, config.model.inferer.hidden_dim = kind, hidden_dim
    vocabulary = Vocabulary(words)
    return vocabulary, build(config, load_skeleton(config.skeleton), len(vocabulary), 3)


def start(vocabulary, spec):
    return weights.flatten(initial_variables("demo", spec, vocabulary))


def test_weights_of_an_encoder_that_the_model_does_not_have_are_refused():
    config = presets.sized("ted_expressive", "debug")
    config.model.audio.weights = "whisper-tiny.en"
    with pytest.raises(UserError, match=r"audio\.weights is read only with"):
        inputs.pretrained(config, build(config, load_skeleton(config.skeleton), 2, 0), Vocabulary(()))


def test_all_weights_are_those_of_the_model_and_words_keep_their_vectors():
    demo = model_folder.load("demo")
    known = demo.assets.vocabulary.words[5]
    found, before = start(*spec_for("qwyx", known)), weights.flatten(demo.variables)
    assert found.keys() == before.keys()
    assert all(np.array_equal(found[name], before[name]) for name in found if name != WORDS)
    np.testing.assert_array_equal(found[WORDS], before[WORDS][[0, 1, UNKNOWN, demo.assets.vocabulary.encode(known)]])


def test_a_table_of_speakers_starts_anew():
    """The demo has styles from images."""
    vocabulary, spec = spec_for("you", kind="speakers")
    missing = weights.flatten(variable_shapes(spec)).keys() - start(vocabulary, spec).keys()
    assert missing
    assert all("/identity/" in name for name in missing)


def test_a_model_that_does_not_fit_is_refused():
    with pytest.raises(UserError, match="has shape"):
        start(*spec_for(hidden_dim=32))


def test_a_run_starts_from_a_model(debug_model, tiny_talk, tmp_path, capsys):
    """With a learning rate of 0 all weights are those of the model at the end, except for vectors of other words."""
    config, assets = presets.parse("talk:debug", "seq2seq"), debug_model.assets
    shapes = variable_shapes(build(config, assets.skeleton, len(assets.vocabulary), 2))
    variables = jax.tree.map(lambda leaf: np.full(leaf.shape, 0.1, np.float32), shapes)
    source = model_folder.save(tmp_path / "m", config, dataclasses.replace(assets, speakers={}), variables)
    flags = ["--config=seq2seq:talk:debug", f"--workdir={tmp_path / 'run'}", f"--config.data.path={tiny_talk}"]
    flags += [f"--config.train.init_from={source}", "--config.train.learning_rate=0.0"]
    assert cli.main(["train", *flags]) == 0
    assert f"training starts from the weights of {source}" in capsys.readouterr().err
    before, after = (model_folder.load(path).variables["params"] for path in (source, tmp_path / "run"))
    del before["text"]["embedding"], after["text"]["embedding"]
    assert jax.tree.all(jax.tree.map(np.array_equal, before, after))

    shutil.rmtree(source)
    assert cli.main(["train", *flags]) == 0  # a run that has begun needs the model no more
    assert "training starts from" not in capsys.readouterr().err

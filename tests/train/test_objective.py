"""An objective follows its config, and settings that cannot be trained are refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.checkpoint import weights
from ha2g_jax.config import presets
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.methods.build import build as build_method
from ha2g_jax.methods.method import restore, subtract_mean
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.inputs import word_table
from ha2g_jax.train.objective import build_objective


def test_paper_config_gives_the_sizes_of_the_paper():
    config = configs.paper("ted_expressive")
    objective = build_objective(config, load_skeleton("ted_expressive"), 100, 24, steps_per_epoch=7)
    assert objective.spec.generator.audio.blocks == (3, 4, 6, 3)
    assert (objective.spec.generator.hidden_dim, objective.spec.generator.layers) == (300, 4)
    assert dict(objective.weights) == {
        "gan": 1.0,
        "huber": 200.0,
        "physical": 0.01,  # D18
        "style": 0.05,
        "kld": 0.1,
        "contrastive": 0.1,
    }
    assert objective.warmup_steps == 70


def test_every_weight_must_name_a_term(config, build):
    config.loss.ha2g.weights.smoothness = 1.0
    with pytest.raises(UserError, match="differ in smoothness"):
        build(config)


def test_every_term_must_have_a_weight(config, build):
    del config.loss.ha2g.weights["kld"]
    with pytest.raises(UserError, match="differ in kld"):
        build(config)


@pytest.mark.parametrize(
    ("section", "field", "value"),
    [
        ("loss.ha2g", "gan", "wgan"),
        ("model.identity", "kind", "video"),
        ("model.text", "receptive_field", "wide"),
        ("train", "schedule", "linear"),
        ("train", "dtype", "float16"),
    ],
)
def test_an_unknown_choice_is_named(config, build, section, field, value):
    part = config
    for name in section.split("."):
        part = part[name]
    part[field] = value
    with pytest.raises(UserError, match=rf"config.{section}.{field} is '{value}', expected one of"):
        build(config)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("ema", 1.0, "from 0 to below 1"),
        ("clip_norm", -0.5, "0 or more"),
        ("accumulate", 0, "a divisor of config.train.batch_size, 4"),
        ("accumulate", 3, "a divisor of config.train.batch_size, 4"),
    ],
)
def test_a_number_that_makes_no_sense_is_named(config, build, field, value, expected):
    config.train[field] = value
    with pytest.raises(UserError, match=rf"config.train.{field} is {value}, expected {expected}: set --config.train"):
        build(config)


def test_a_speaker_and_the_mirror_image_are_two_rows_of_the_table(config, build):
    assert build(config).spec.generator.identity.num_speakers == 5
    config.data.mirror = 0.5
    assert build(config).spec.generator.identity.num_speakers == 10


def test_word_vectors_start_every_table_of_words():
    config = presets.make("ted_gesture", "debug", "release", {"model.text.embedding_dim": 300})
    spec = build_method(config, load_skeleton("ted_gesture"), 11, 3)
    found = weights.flatten(word_table(spec, np.ones((11, 300), np.float32)))
    assert set(found) == {f"{part}text/embedding/embedding" for part in ("", "pose_1/", "pose_2/", "pose_3/")}


def test_restored_poses_are_the_unit_vectors_that_went_in(objective, make_batch):
    directions = jnp.asarray(make_batch(objective, 2)["directions"])
    poses = subtract_mean(objective.spec, directions)
    assert poses.shape == (2, 34, 27)
    np.testing.assert_allclose(restore(objective.spec, poses), directions, atol=1e-6)
    lengths = jnp.linalg.norm(restore(objective.spec, 2 * poses), axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)


def test_an_objective_is_a_static_argument(objective):
    count = jax.jit(lambda objective, x: x + objective.spec.num_frames, static_argnums=0)
    assert count(objective, 1) == 35

"""The networks of the public code: sizes of the description, what a level sees, and what an identity changes."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.config import presets
from ha2g_jax.errors import UserError
from ha2g_jax.methods import build, discriminator_shapes, variable_shapes
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.methods.ha2g import release
from ha2g_jax.skeleton import load_skeleton

WORDS, SPEAKERS, B = 10, 3, 4
# Parameters in the description, of a level by its width; without tables of words and speakers.
LEVELS = {
    "ted_gesture": {15: 7_089_863, 21: 7_101_569, 27: 7_113_275},
    "ted_expressive": {24: 7_107_422, 30: 7_119_128, 36: 7_130_834, 66: 7_189_364, 96: 7_247_894, 126: 7_306_424},
}
AUDIO = {"ted_gesture": 5_657_813, "ted_expressive": 5_658_110}
DISCRIMINATOR = {"ted_gesture": 253_950, "ted_expressive": 258_702}
TEXT = 1_454_432


def _spec(data, size="", method="release", **changes: Any):
    return build(presets.make(data, size, method, changes), load_skeleton(data), WORDS, SPEAKERS)


def _count(tree):
    return sum(leaf.size for leaf in jax.tree.leaves(tree))


@pytest.mark.parametrize("data", LEVELS)
def test_the_networks_have_the_sizes_of_the_description(data):
    spec = _spec(data)
    params = variable_shapes(spec)["params"]
    tables = 300 * WORDS + 16 * SPEAKERS
    widths = [len(channels) for channels in spec.generator.level_channels]
    assert {w: _count(params[f"pose_{h}"]) - tables for h, w in enumerate(widths, 1)} == LEVELS[data]
    assert _count([params["audio"], params["coordinator"]]) - 16 * SPEAKERS == AUDIO[data]
    assert _count(params["text"]) - 300 * WORDS == TEXT
    assert _count(discriminator_shapes(spec)["params"]) == DISCRIMINATOR[data]


@functools.cache
def _model(data):
    """A small model, random variables, and a batch."""
    spec = _spec(data, "debug")
    rng = np.random.default_rng(0)
    shapes = variable_shapes(spec)
    variables = {
        name: jax.tree.map(lambda x, least=least: rng.uniform(least, 0.6, x.shape).astype(np.float32), shapes[name])
        for name, least in (("params", -0.6), ("batch_stats", 0.1))
    }
    batch = {
        "mel": jnp.asarray(rng.uniform(-80, 0, (B, 128, 70)), jnp.float32),
        "words": jnp.asarray(rng.integers(0, WORDS, (B, 34))),
        "directions": jnp.asarray(rng.normal(size=(B, 34, spec.skeleton.num_bones, 3)), jnp.float32),
        "speaker": jnp.asarray([0, 1, 2, 1]),
    }
    return spec, variables, batch


@pytest.mark.parametrize("data", LEVELS)
def test_a_level_sees_the_seed_and_the_level_below(data):
    """After the seed, the head of TED-Expressive comes one channel late, and its last value in place of the bit."""
    spec, variables, _ = _model(data)
    model = spec.generator.bind(variables)
    below, channels = spec.generator.level_channels[:2]
    width, seed = len(channels), jnp.full((B, 4, spec.skeleton.pose_dim), 2.0)
    poses = jnp.broadcast_to(10.0 + jnp.asarray(below), (B, 34, len(below)))  # each value names its channel
    first, second = (np.asarray(model._known(level, found, seed, 34)) for level, found in ((0, []), (1, [poses])))
    assert (first[:, :4, :-1] == 2).all() and (first[:, :4, -1] == 1).all() and (first[:, 4:] == 0).all()
    assert (second[:, :4, :-1] == 2).all() and (second[:, :4, -1] == 1).all()
    expected = np.array([10.0 + channel if channel in below else 0.0 for channel in channels] + [0.0])
    if data == "ted_expressive":
        expected = np.concatenate([expected[: width - 15], [0.0], expected[width - 15 : width]])
    np.testing.assert_array_equal(second[0, 4:], np.broadcast_to(expected, (30, width + 1)))


def test_words_and_speakers_change_every_level():
    spec, variables, batch = _model("ted_gesture")

    @jax.jit
    def generate(words, speaker):
        features = ha2g.encode_speech(spec, variables, batch | {"words": words})
        style = ha2g.encode_identity(spec, variables, speaker)
        return spec.generator.apply(variables, features, style, jnp.zeros((B, 4, 27)), train=False, method="infer")

    poses = generate(batch["words"], batch["speaker"])
    for other in (generate(batch["words"] * 0, batch["speaker"]), generate(batch["words"], batch["speaker"][::-1])):
        assert all(np.abs(a - b).max() > 1e-4 for a, b in zip(poses, other, strict=True))


def test_the_other_identity_keeps_the_blend_and_draws_the_styles():
    spec, variables, batch = _model("ted_gesture")
    keys = {name: jax.random.key(index) for index, name in enumerate(ha2g.rngs)}
    outputs, constants, _ = jax.jit(lambda: release.run(spec, variables, batch, keys, train=True))()
    assert outputs.mean.shape == outputs.log_variance.shape == constants.f_id.shape == (B, 16)  # of the last level
    assert np.isfinite(outputs.log_variance).all() and len(outputs.features) == 3
    assert sorted(map(tuple, np.asarray(constants.f_id))) == sorted(map(tuple, np.asarray(constants.other_f_id)))
    assert not np.allclose(constants.f_id, outputs.mean)
    mean, log_variance = spec.generator.apply(variables, batch["speaker"], train=False, method="encode_identity")
    assert mean.shape == (B, spec.style_dim) and (np.asarray(log_variance[:, :16]) == -np.inf).all()


def test_settings_of_other_networks_are_refused():
    with pytest.raises(UserError, match=r"config\.model\."):
        _spec("ted_gesture", "debug", "release", **{"model.inferer.levels": (1, 3)})

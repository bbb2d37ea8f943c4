"""The generator: inputs of each level, and the blend of Eq. 3."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax import methods
from ha2g_jax.config import presets
from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.resnet_se import AudioEncoder, Features
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.skeleton import load_skeleton

B, N, M = 2, 10, 3
CHANNELS = ((0, 1, 4), (0, 1, 3, 4), (0, 1, 2, 3, 4, 5))
POSE_DIM = 6


def _model(channels=CHANNELS, num_seed_frames=M, dropout=0.0):
    return HA2G(
        audio=AudioEncoder(blocks=(1, 1, 1, 1), channels=(8, 8, 16, 32), stem_stride=(2, 1)),
        text=TextEncoder(vocabulary_size=5, embedding_dim=4, channels=4),
        identity=SpeakerIdentity(num_speakers=3),
        level_channels=channels,
        num_seed_frames=num_seed_frames,
        hidden_dim=5,
        layers=2,
        dropout=dropout,
    )


def _inputs(num_seed_frames=M, pose_dim=POSE_DIM, feature_dim=4):
    rng = np.random.default_rng(0)
    features = tuple(rng.normal(size=(B, N, feature_dim)).astype(np.float32) for _ in range(3))
    f_id = rng.normal(size=(B, 18)).astype(np.float32)
    seed = rng.normal(size=(B, num_seed_frames, pose_dim)).astype(np.float32)
    return features, f_id, seed


@functools.cache
def _inferrer(model, *sizes):
    """Return random variables and `infer`, compiled once for all tests of a model."""
    start = functools.partial(model.init, train=False, method=model.infer)
    shapes = jax.eval_shape(start, jax.random.key(0), *_inputs(*sizes))
    rng = np.random.default_rng(0)
    variables = jax.tree.map(lambda x: rng.uniform(-0.6, 0.6, x.shape).astype(np.float32), shapes)
    return variables, jax.jit(lambda *inputs: model.apply(variables, *inputs, train=False, method=model.infer))


def _infer(model, *inputs):
    return _inferrer(model, inputs[-1].shape[1])


def test_weights_of_the_audio_levels_sum_to_one(oracles):
    _, f_id, _ = _inputs()
    model = _model()
    variables = model.init(jax.random.key(0), f_id, method=model.coordinate)
    weights = np.asarray(model.apply(variables, f_id, method=model.coordinate))
    assert weights.shape == (B, 3, len(CHANNELS))
    oracles.assert_close(weights.sum(axis=1), np.ones((B, len(CHANNELS))), 1e-6)
    linear = jax.tree.map(np.asarray, variables["params"]["coordinator"]["linear"])
    scores = np.exp(f_id @ linear["kernel"] + linear["bias"]).reshape(B, 3, len(CHANNELS))
    oracles.assert_close(weights, scores / scores.sum(axis=1, keepdims=True))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"audio_levels": ("mid",)}, lambda c: (c[:, 1] == 1).all() and (c[:, [0, 2]] == 0).all()),
        ({"audio_levels": ("low", "high")}, lambda c: (c[:, 1] == 0).all() and (c[:, [0, 2]] > 0).all()),
        ({"is_tied": True}, lambda c: (c == c[..., :1]).all() and (c[0] != c[1]).all()),
        ({}, lambda c: (c > 0).all() and (c[..., 0] != c[..., 1]).any()),
    ],
)
def test_ablations_of_the_blend(changes, expected):
    """Rows of Tables 3 and 4: one level of the audio alone, or one blend for all levels of the motion."""
    model = _model().clone(**changes)
    variables, _ = _infer(model, *_inputs())
    f_id = jnp.asarray(_inputs()[1])
    blend = np.asarray(model.apply(variables, f_id, method="coordinate"))
    np.testing.assert_allclose(blend.sum(axis=1), 1, atol=1e-6)
    assert blend.shape == (B, 3, 3) and expected(blend)


def test_a_stage_is_the_equations(oracles):
    """p^1 to p^3 from the parts of the model: true seeds, then zeros or the level before; Eq. 3 and 4."""
    features, f_id, seed = _inputs()
    model = _model()
    variables, infer = _infer(model, features, f_id, seed)
    assert set(variables) == {"params"}, "the pose inferer must not depend on the batch"
    weights = np.asarray(model.apply(variables, f_id, method=model.coordinate))
    is_seed = np.broadcast_to((np.arange(N) < M)[None, :, None], (B, N, 1)).astype(np.float32)

    whole = np.zeros((B, N, POSE_DIM), np.float32)  # what the levels so far have computed, in the channels of a pose
    for level, poses in enumerate(infer(features, f_id, seed)):
        channels = list(CHANNELS[level])
        previous = np.concatenate([seed[..., channels], whole[:, M:, channels]], axis=1)
        audio = np.sum([weights[:, source, level, None, None] * features[source] for source in range(3)], axis=0)
        stage = model.bind(variables).stages[level]
        oracles.assert_close(poses, stage(*map(jnp.asarray, (previous, audio, is_seed)), train=False))
        linear = jax.tree.map(np.asarray, variables["params"][f"pose_{level + 1}"]["linear"])
        assert linear["kernel"].shape == (5 + previous.shape[-1] + 4, len(CHANNELS[level]))
        whole[..., list(CHANNELS[level])] = poses


@pytest.mark.parametrize("row", presets.TABLES["table4"])
def test_every_seed_channel_reaches_the_last_level_in_every_row_of_table_4(row):
    skeleton = load_skeleton("ted_expressive")
    spec = ha2g.build(presets.make("talk", "debug", changes=presets.TABLES["table4"][row]), skeleton, 5, 3)
    sizes = (spec.num_seed_frames, skeleton.pose_dim, 32)
    features, f_id, seed = _inputs(*sizes)
    _, infer = _inferrer(spec.generator, *sizes)
    last, pull_back = jax.vjp(lambda seed: infer(features, f_id, seed)[-1], seed)
    assert (np.abs(np.asarray(pull_back(last)[0])).max(axis=(0, 1)) > 0).all()


def test_without_a_coordinator_the_identity_reaches_the_poses_through_the_gru():
    features, f_id, seed = _inputs()
    features, seed = jax.tree.map(lambda x: np.repeat(x[:1], B, axis=0), (features, seed))  # styles alone differ
    variables, infer = _infer(model := _model().clone(has_coordinator=False), features, f_id, seed)
    blend = model.apply(variables, f_id, method=model.coordinate)
    np.testing.assert_array_equal(blend[0], blend[1])
    assert all(np.abs(poses[0] - poses[1]).max() > 1e-3 for poses in infer(features, f_id, seed))


def test_the_oracle_hears_the_words_in_place_of_the_high_level():
    config = presets.make("talk", "debug", changes={"model.text.kind": "oracle", "model.inferer.levels": (6,)})
    spec = methods.build(config, load_skeleton(config.skeleton), vocabulary_size=5, num_speakers=3)
    assert spec.inputs == ("mel", "words")
    model, rng = spec.generator, np.random.default_rng(0)
    mel = rng.uniform(-80, 0, (1, 128, 70)).astype(np.float32)
    speech = [{"mel": mel, "words": np.full((1, 34), word, np.int32)} for word in (1, 2)]
    start = functools.partial(model.init, train=False, method="encode_speech")
    shapes = jax.eval_shape(start, jax.random.key(0), speech[0])
    variables = jax.tree.map(lambda x: rng.uniform(0.01, 0.2, x.shape).astype(np.float32), shapes)
    encode = jax.jit(functools.partial(model.apply, train=False, method="encode_speech"))
    one, other = (encode(variables, each) for each in speech)
    np.testing.assert_array_equal(one.low, other.low)
    assert np.abs(one.high - other.high).max() > 0
    text = jax.jit(functools.partial(model.apply, train=False, method="encode_text"))(variables, speech[0]["words"])
    np.testing.assert_array_equal(one.high, text)


def test_the_control_of_the_contrastive_term_sees_the_text_of_another_window():
    config = presets.make("talk", "debug", changes={"model.inferer.levels": (6,)})
    spec = methods.build(config, load_skeleton(config.skeleton), vocabulary_size=5, num_speakers=3)
    rng = np.random.default_rng(0)
    poses, other = rng.normal(size=(2, 3, 34, 126)).astype(np.float32)
    text, *features = rng.normal(size=(4, 3, 34, 32)).astype(np.float32)
    f_id, other_f_id = rng.normal(size=(2, 3, 18)).astype(np.float32)
    settings = {name: value for name, value in config.loss.ha2g.items() if name not in ("weights", "gan")}

    @functools.partial(jax.jit, static_argnums=0)
    def contrastive(kind, text):
        outputs = ha2g.Outputs((poses,), Features(*features), text, f_id, f_id)
        constants = ha2g.Constants(other, f_id, other_f_id)
        chosen = ha2g.LossSettings(**settings)._replace(text=kind)
        return ha2g.terms(spec, chosen, outputs, constants, jnp.asarray(poses), jnp.zeros(())).contrastive

    other_text = float(contrastive("other", text))
    assert other_text == pytest.approx(float(contrastive("own", np.roll(text, 1, axis=0))), rel=1e-6)
    assert other_text != pytest.approx(float(contrastive("own", text)), rel=1e-3)

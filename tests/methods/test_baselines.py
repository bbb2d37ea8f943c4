"""What every baseline must do: sizes of the published comparison, one batch by heart, and the same step anywhere."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.config import presets
from ha2g_jax.errors import UserError
from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import generating_method_of, method_of
from ha2g_jax.methods.adversarial import Discriminator
from ha2g_jax.methods.autoencoder import PoseAutoencoder
from ha2g_jax.methods.joint_embedding import JointEmbedding
from ha2g_jax.methods.seq2seq import Seq2Seq
from ha2g_jax.methods.speech2gesture import PatchDiscriminator, Speech2Gesture
from ha2g_jax.methods.trimodal import Trimodal
from ha2g_jax.skeleton import normalize
from ha2g_jax.train import sharding
from ha2g_jax.train.objective import init_state
from ha2g_jax.train.step import step_keys, train_step, validation_step

SIZE = 16
# Short windows and few layers, which compile and run faster. Where each frame is normalised by its batch, what differs
# between two runs grows along the roll-out: a thousandfold at debug size, twentyfold with 64 values.
SMALL = {
    "seq2seq": {"model__inferer__hidden_dim": 64, "model__inferer__layers": 2},
    "speech2gesture": {
        "model__audio__spectrogram__channels": (4,),
        "model__inferer__layers": 1,
        "model__inferer__hidden_dim": 16,
    },
    "joint_embedding": {"data__num_frames": 17, "model__context__layers": 1, "model__text__layers": 1},
    "trimodal": {"data__num_frames": 17},
}
HAS_DROPOUT = {"seq2seq": ("inferer",), "joint_embedding": ("text", "inferer"), "trimodal": ("text", "inferer")}


@pytest.fixture(scope="module")
def make_plain(make_objective):
    """A function from a method's name to its objective under gradient descent and without dropout."""

    def make(method, **changes):
        changes |= {f"model__{part}__dropout": 0.0 for part in HAS_DROPOUT.get(method, ())}
        objective = make_objective(method, train__batch_size=SIZE, **SMALL[method], **changes)
        rates = {
            "generator_rate": optax.constant_schedule(1e-4),
            "discriminator_rate": optax.constant_schedule(1e-2),
        }
        objective = dataclasses.replace(objective, optimizer=optax.scale(-1.0), **rates)
        if method == "trimodal":
            discriminator = objective.spec.discriminator.clone(dropout=0.0)
            objective = dataclasses.replace(objective, spec=objective.spec._replace(discriminator=discriminator))
        return objective

    return make


@pytest.mark.parametrize("method", SMALL)
def test_eight_devices_take_the_step_of_one(method, make_plain, make_motion_batch):
    objective = make_plain(method)
    batch = jax.tree.map(np.asarray, make_motion_batch(objective, SIZE))
    start, ends = init_state(objective, jax.random.key(0)), []
    for devices in (jax.devices()[:1], jax.devices()):
        mesh = sharding.data_mesh(devices)
        step = jax.jit(functools.partial(train_step, objective))
        arguments = (sharding.replicate(mesh, start), sharding.shard_batch(mesh, batch), jax.random.key(1))
        ends.append(jax.device_get(step(*arguments)))
    (one, one_metrics), (eight, metrics) = ends
    for name, value in one_metrics.items():
        assert metrics[name] == pytest.approx(value, rel=1e-3), name
    trees = [jax.tree.map(np.asarray, (state.generator, state.discriminator)) for state in (one, eight, start)]
    leaves = zip(jax.tree.leaves_with_path(trees[0]), *map(jax.tree.leaves, trees[1:]), strict=True)
    for (path, theirs), ours, before in leaves:
        # Biases right before a BatchNorm move by rounding alone.
        tolerance = 1e-2 * np.abs(theirs - before).max() + 1e-6 * np.abs(theirs).max() + 1e-7
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance, err_msg=jax.tree_util.keystr(path))


# Rounding grows from layer to layer and from frame to frame: frames that are compared, and bounds of the differences of
# poses and of gradients.
NEAR = {"seq2seq": (12, 0.03, 0.1), "speech2gesture": (34, 0.1, 0.3), "joint_embedding": (17, 0.05, 0.3)}
NEAR["trimodal"] = (17, 0.05, 0.3)


@pytest.mark.parametrize("method", SMALL)
def test_half_precision_is_near_single_precision(method, make_plain, make_motion_batch, draw_state):
    objectives, found = [make_plain(method, train__dtype=dtype) for dtype in ("float32", "bfloat16")], []
    num_frames, of_poses, of_gradients = NEAR[method]
    state = draw_state(objectives[0])
    keys = step_keys(objectives[0].spec, jax.random.key(1), state.step)
    for objective in objectives:

        def loss(params, batch, objective=objective):
            variables = state.generator.variables | {"params": params}
            outputs, _, batch_stats = method_of(objective.spec).run(
                objective.spec, variables, batch, keys, train=True, compute=objective.compute
            )
            poses = outputs.poses[-1]
            return jnp.mean(jnp.square(poses[:, :num_frames])), (poses, batch_stats)

        found.append(jax.jit(jax.grad(loss, has_aux=True))(state.generator.params, make_motion_batch(objective, SIZE)))
    (gradient, (poses, _)), (half_gradient, (half_poses, batch_stats)) = found
    assert {leaf.dtype for leaf in jax.tree.leaves((half_poses, batch_stats, half_gradient))} == {np.dtype("float32")}
    assert 0 < np.abs(poses - half_poses)[:, :num_frames].max() < of_poses * np.abs(poses).max()
    distance = optax.tree.norm(jax.tree.map(jnp.subtract, gradient, half_gradient))
    assert distance < of_gradients * optax.tree.norm(gradient)


# Steps, windows, settings of an objective that is wide enough, the reconstruction, the share of it that is left after
# the last steps, and the weights of the terms.
LEARNT = {
    "seq2seq": (
        *(150, 4, {"model__inferer__hidden_dim": 16, "train__learning_rate": 1e-2}),
        *("mse", 0.03, {"mse": 250, "continuity": 0.1, "variance": 25}),
    ),
    "speech2gesture": (
        *(75, 4, SMALL["speech2gesture"] | {"model__inferer__hidden_dim": 32, "train__learning_rate": 1e-2}),
        *("l1", 0.1, {"l1": 100, "gan": 10}),
    ),
    "joint_embedding": (  # the decoder generates the whole motion from one latent
        *(150, 2, {"model__inferer__hidden_dim": 64, "train__learning_rate": 7e-3, "model__context__layers": 1}),
        *("l1", 0.15, {}),
    ),
    "trimodal": (100, 2, {"model__inferer__hidden_dim": 32, "train__learning_rate": 5e-3}, "huber", 0.1, {}),
}


@pytest.mark.parametrize("method", LEARNT)
def test_one_batch_is_learnt_by_heart(method, make_objective, make_motion_batch, draw_state):
    """With all terms, including the GAN term."""
    num_steps, size, changes, name, bound, weights = LEARNT[method]
    if method == "joint_embedding":
        changes = changes | {"data__num_frames": 17}  # short windows, as most of a step is their sound
    objective = make_objective(method, train__steps=num_steps, train__schedule="cosine", **changes)
    assert objective.warmup_steps == 0
    batch, state, history, metrics = make_motion_batch(objective, size), draw_state(objective), [], {}
    if method == "joint_embedding":  # two clips, each of which moves from one pose straight to another
        share = jnp.linspace(0, 1, objective.spec.num_frames)[None, :, None, None]
        first, last = batch["directions"][:, :1], batch["directions"][:, 8:9]
        batch["directions"] = normalize(first * (1 - share) + last * share)
    step = jax.jit(functools.partial(train_step, objective))
    for _ in range(num_steps):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics[f"loss/{name}"])
    # Twenty steps, so that both latents of Joint Embedding are among them.
    assert np.max(history[-20:] if method == "joint_embedding" else history[-1]) < bound * history[0]
    if weights:
        total = sum(weight * float(metrics[f"loss/{term}"]) for term, weight in weights.items())
        assert float(metrics["loss/total"]) == pytest.approx(total, rel=1e-4)
    if method == "joint_embedding":
        evaluated = jax.jit(functools.partial(validation_step, objective))(state, batch, jax.random.key(2))
        assert evaluated["loss/l1"] < 0.2 * history[0]


def test_an_identity_that_a_method_does_not_have_is_refused(make_objective):
    with pytest.raises(UserError, match=r"identity\.kind is 'speakers', expected one of none"):
        make_objective("seq2seq", model__identity__kind="speakers")


@pytest.mark.parametrize("method", SMALL)
def test_with_the_inputs_of_ha2g_sound_and_images_each_change_the_poses(method, make_objective, make_batch, draw_state):
    objective = make_objective(method, **presets.equal(method, "debug"))
    spec, variables = objective.spec, draw_state(objective).generator.variables
    assert (spec.inputs, spec.identity, spec.style_dim) == (("mel",), "images", 18)

    @jax.jit
    def generate(mel, images):
        functions = generating_method_of(spec)
        features = functions.encode_speech(spec, variables, {"mel": mel})
        style = functions.encode_identity(spec, variables, images)
        seed, noise = jnp.zeros((3, 4, 27)), jnp.zeros((3, 34, spec.noise_dim))
        return functions.sample(spec, variables, features, style, seed, noise)

    one, other = (make_batch(objective, 1, seed) for seed in (0, 1))
    mel, images = (np.concatenate([one[name]] * 3) for name in ("mel", "images"))
    mel[1], images[2] = other["mel"][0], other["images"][0]
    own, of_sound, of_images = generate(mel, images)
    assert own.shape == (34, 27)
    assert min(np.abs(changed - own).max() for changed in (of_sound, of_images)) > 1e-5 * np.abs(own).max()  # rounding


WORDS, SPEAKERS = 9, 3
COUNTS = {
    "seq2seq": (1_939_027, 1_978_726),
    "speech2gesture": (6_438_347, 6_476_462),
    "patches": (172_993, 198_337),
    "joint_embedding": (6_933_075, 6_970_200),
    "trimodal": (7_183_003, 7_376_152),
    "discriminator": (253_950, 258_702),
    # That of TED-Gesture has two more linear maps of 32 to 32.
    "autoencoder": (190_691 - 2 * (32 * 32 + 32), 226_214),
}


def networks(pose_dim):
    """Return the networks of the published comparison by name, with their inputs."""
    text = functools.partial(TextEncoder, WORDS, receptive_field="causal")
    seed, poses = jnp.zeros((1, 4, pose_dim)), jnp.zeros((1, 34, pose_dim))
    speech = {"audio": jnp.zeros((1, 36_267)), "words": jnp.zeros((1, 34), jnp.int32)}
    identity = SpeakerIdentity(SPEAKERS, feature_dim=16, has_hidden=True)
    return {
        "seq2seq": (Seq2Seq(WORDS, pose_dim), {"plain_words": jnp.zeros((1, 32), jnp.int32)}, None, seed),
        "speech2gesture": (Speech2Gesture(pose_dim), {"mel": jnp.zeros((1, 128, 70))}, None, seed),
        "patches": (PatchDiscriminator(), poses),
        "joint_embedding": (
            JointEmbedding(WaveformEncoder(), text(channels=200, layers=2), pose_dim),
            speech,
            None,
            seed,
        ),
        "trimodal": (Trimodal(WaveformEncoder(), text(), identity, pose_dim), speech, jnp.zeros(1, jnp.int32), seed),
        "discriminator": (Discriminator(), poses),
        "autoencoder": (PoseAutoencoder(pose_dim, {27: 32, 126: 128}[pose_dim]), poses),
    }


@pytest.mark.parametrize("name", COUNTS)
def test_has_as_many_parameters_as_the_published_comparison(name):
    """Without the rows of the tables of words and speakers."""
    for pose_dim, count in zip((27, 126), COUNTS[name], strict=True):
        network, *arguments = networks(pose_dim)[name]
        start = functools.partial(network.init, train=False)
        params = jax.eval_shape(start, jax.random.key(0), *arguments)["params"]
        for part, rows in (("text", WORDS), ("identity", SPEAKERS)):
            if part in params:
                assert params[part].pop("embedding")["embedding"].shape[0] == rows
        assert sum(leaf.size for leaf in jax.tree.leaves(params)) == count


@pytest.mark.parametrize("method", SMALL)
def test_a_single_clip_is_evaluated_as_one_of_a_batch(method, make_plain, make_motion_batch, draw_state):
    objective = make_plain(method)
    state, batch = draw_state(objective), make_motion_batch(objective, 3)
    single, key = jax.tree.map(lambda x: x[1:2], batch), jax.random.key(1)
    metrics = jax.eval_shape(functools.partial(validation_step, objective), state, single, key)
    assert set(metrics) == {f"loss/{name}" for name in (*method_of(objective.spec).Terms._fields, "total")}
    if method != "joint_embedding":  # whose latent is a sample
        keys, variables = step_keys(objective.spec, key, state.step), state.generator.variables
        run = functools.partial(method_of(objective.spec).run, objective.spec, variables, keys=keys, train=False)
        poses, alone = (jax.jit(run)(it).outputs.poses[-1] for it in (batch, single))
        np.testing.assert_allclose(alone, poses[1:2], rtol=1e-4, atol=1e-5)

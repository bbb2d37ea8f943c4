"""Joint Embedding: its loss, the coin that decides which latent is decoded, and overfitting of one batch."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.methods import joint_embedding
from ha2g_jax.methods.joint_embedding import l1
from ha2g_jax.skeleton import normalize
from ha2g_jax.train.step import step_keys, train_step, validation_step

STEPS = 150


@pytest.fixture(scope="module")
def objective(make_objective):
    """An objective wide enough to overfit one batch: the decoder generates the whole motion from one latent."""
    changes = {"model__inferer__hidden_dim": 64, "train__learning_rate": 7e-3, "train__schedule": "cosine"}
    changes |= {"model__context__layers": 1, "data__num_frames": 17}  # short windows, as most of a step is their sound
    return make_objective("joint_embedding", train__steps=STEPS, **changes)


@pytest.fixture(scope="module")
def state(objective, draw_state):
    return draw_state(objective)


@pytest.fixture(scope="module")
def run(objective, state):
    """The generator in training mode: (batch, keys) -> poses, and the batch statistics afterwards."""

    def run(batch, keys):
        outputs, _, batch_stats = joint_embedding.run(
            objective.spec, state.generator.variables, batch, keys, train=True
        )
        return outputs.poses[-1], batch_stats

    return jax.jit(run)


def keys_of(spec, from_speech):
    """Return the keys of a step whose coin falls on one side."""
    for number in range(64):
        keys = step_keys(spec, jax.random.key(number), jnp.int32(0))
        if bool(jax.random.bernoulli(keys["coin"])) == from_speech:
            return keys
    raise AssertionError("64 tosses on one side")


def test_l1_sums_the_windows_and_averages_inside_them():
    poses = jnp.array([[[1.0, 2.0], [0.0, 0.0]], [[-1.0, 0.0], [0.5, 0.5]]])
    targets = jnp.array([[[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
    assert float(l1(poses, targets)) == (1 + 2 + 0 + 1) / 4 + (1 + 0 + 0.5 + 0.5) / 4


def test_there_is_a_table_of_words_but_none_of_speakers_and_no_discriminator(objective, state, make_objective):
    assert objective.spec.discriminator is None and objective.spec.identity == ""
    assert state.generator.params["text"]["embedding"]["embedding"].shape[0] == 11
    with pytest.raises(UserError, match=r"identity.kind is 'speakers', expected one of none"):
        make_objective("joint_embedding", model__identity__kind="speakers")


@pytest.mark.parametrize("from_speech", [True, False])
def test_a_coin_decides_which_latent_is_decoded(from_speech, objective, state, run, make_motion_batch):
    batch, keys = make_motion_batch(objective, 3), keys_of(objective.spec, from_speech)
    late = jnp.roll(batch["directions"][:, objective.spec.num_seed_frames :], 5, axis=1)
    changed = {
        "audio": batch | {"audio": -batch["audio"]},
        "directions": batch | {"directions": batch["directions"].at[:, objective.spec.num_seed_frames :].set(late)},
    }
    poses, batch_stats = run(batch, keys)
    influences = {name for name, other in changed.items() if not np.array_equal(run(other, keys)[0], poses)}
    assert influences == {"audio" if from_speech else "directions"}
    # Both encoders run whichever way it falls.
    for part in ("context", "pose_encoder"):
        before, after = (jax.tree.leaves(stats[part]) for stats in (state.generator.batch_stats, batch_stats))
        assert all(not np.array_equal(one, other) for one, other in zip(before, after, strict=True))


def test_evaluation_samples_the_latent_of_the_speech(objective, state, make_motion_batch):
    """For a batch of one, whatever the coin."""
    evaluate = jax.jit(
        lambda batch, keys: joint_embedding.run(
            objective.spec, state.generator.variables, batch, keys, train=False
        ).outputs.poses[-1]
    )
    batch = make_motion_batch(objective, 1)
    late = jnp.roll(batch["directions"][:, objective.spec.num_seed_frames :], 5, axis=1)
    other = batch | {"directions": batch["directions"].at[:, objective.spec.num_seed_frames :].set(late)}
    sides = [evaluate(batch, keys_of(objective.spec, from_speech)) for from_speech in (True, False)]
    assert sides[0].shape == (1, objective.spec.num_frames, objective.spec.skeleton.pose_dim)
    assert not np.array_equal(*sides)  # each has its own noise
    np.testing.assert_array_equal(evaluate(other, keys_of(objective.spec, False)), sides[1])
    assert not np.array_equal(evaluate(batch | {"audio": -batch["audio"]}, keys_of(objective.spec, False)), sides[1])


def test_one_batch_is_learnt_by_heart(objective, state, make_motion_batch):
    """Two clips, each of which moves from one pose straight to another."""
    batch = make_motion_batch(objective, 2)
    share = jnp.linspace(0, 1, objective.spec.num_frames)[None, :, None, None]
    first, last = batch["directions"][:, :1], batch["directions"][:, 8:9]
    batch["directions"] = normalize(first * (1 - share) + last * share)
    step = jax.jit(functools.partial(train_step, objective))
    history = []
    for _ in range(STEPS):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics["loss/l1"])
    # Twenty steps, so that both latents are among them.
    assert np.max(history[-20:]) < 0.15 * history[0]
    evaluated = jax.jit(functools.partial(validation_step, objective))(state, batch, jax.random.key(2))
    assert evaluated["loss/l1"] < 0.2 * history[0]

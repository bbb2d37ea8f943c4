"""Attention Seq2Seq follows its equations, fits one batch, and makes the same step on several devices."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.methods import seq2seq
from ha2g_jax.methods.seq2seq import PoseDecoder, Seq2Seq, continuity, mse, variance
from ha2g_jax.train import sharding
from ha2g_jax.train.objective import init_state
from ha2g_jax.train.step import step_keys, train_step, validation_step

STEPS, SIZE = 150, 16
# Normalising each frame by its batch, in training, lets what differs between two runs grow along the roll-out: at
# debug size a thousandfold, at this one twentyfold.
WIDE = {"model__inferer__hidden_dim": 64, "model__inferer__layers": 2}


def test_terms_by_hand():
    """One clip, two values: one goes from 0 to 3 and 4, the other stays at -1; the true ones stay at 1 and -1."""
    poses, targets = jnp.array([[[0.0, -1.0], [3.0, -1.0], [4.0, -1.0]]]), jnp.array([[[1.0, -1.0]] * 3])
    assert float(mse(poses, targets)) == pytest.approx((1 + 4 + 9) / 6)
    assert float(continuity(poses)) == pytest.approx((3 + 1) / 6)
    assert float(variance(poses)) == pytest.approx(-(5 + np.sqrt(3)) / 6)


def test_variance_of_a_value_at_its_mean_has_a_gradient():
    poses = jnp.zeros((1, 3, 2)).at[:, :, 0].set(2.0)
    gradient = jax.grad(variance)(poses)
    np.testing.assert_allclose(gradient[..., 0], -1 / np.sqrt(3) / 6, rtol=1e-6)
    np.testing.assert_array_equal(gradient[..., 1], 0)


def test_an_identity_is_refused(make_objective):
    with pytest.raises(UserError, match=r"config\.model\.identity\.kind is 'speakers', expected one of none"):
        make_objective("seq2seq", model__identity__kind="speakers")


def test_the_word_table_has_rows_for_the_marks_of_start_and_end(make_objective):
    assert make_objective("seq2seq").spec.generator.num_words == 11 + 2


def test_one_batch_is_learnt_by_heart(make_objective, make_motion_batch, draw_state):
    changes = {"model__inferer__hidden_dim": 16, "train__learning_rate": 1e-2, "train__schedule": "cosine"}
    objective = make_objective("seq2seq", train__steps=STEPS, **changes)
    batch, state, history = make_motion_batch(objective, 4), draw_state(objective), []
    step = jax.jit(functools.partial(train_step, objective), donate_argnums=0)
    for _ in range(STEPS):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics)
    first, metrics = history[0], history[-1]
    assert metrics["loss/mse"] < 0.03 * first["loss/mse"]
    terms = {name: float(metrics[f"loss/{name}"]) for name in seq2seq.Terms._fields}
    total = 250 * terms["mse"] + 0.1 * terms["continuity"] + 25 * terms["variance"]
    assert float(metrics["loss/total"]) == pytest.approx(total, rel=1e-4)


@pytest.fixture(scope="module")
def make_plain(make_objective):
    """A function from changes to an objective of some width under gradient descent and without dropout."""

    def make(**changes):
        objective = make_objective("seq2seq", model__inferer__dropout=0.0, train__batch_size=SIZE, **WIDE, **changes)
        return dataclasses.replace(objective, generator_optimizer=optax.sgd(1e-4))

    return make


def test_evaluation_is_of_each_clip_by_itself(make_plain, make_motion_batch, draw_state):
    objective = make_plain()
    batch, state = make_motion_batch(objective, 3), draw_state(objective)
    keys = step_keys(objective.spec, jax.random.key(1), state.step)
    run = jax.jit(
        lambda batch: seq2seq.run(objective.spec, state.generator.variables, batch, keys, train=False).outputs.poses[-1]
    )
    single = jax.tree.map(lambda x: x[1:2], batch)
    np.testing.assert_allclose(run(single), run(batch)[1:2], rtol=1e-4, atol=1e-5)
    metrics = jax.jit(functools.partial(validation_step, objective))(state, single, jax.random.key(1))
    assert set(metrics) == {"loss/mse", "loss/continuity", "loss/variance", "loss/total"}
    assert np.isfinite(list(metrics.values())).all()


def test_eight_devices_take_the_step_of_one(make_plain, make_motion_batch):
    objective = make_plain()
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
    for (path, theirs), ours, before in zip(
        jax.tree.leaves_with_path(one.generator), jax.tree.leaves(eight.generator), jax.tree.leaves(start.generator)
    ):
        moved = np.abs(theirs - before).max()
        tolerance = 1e-2 * moved + 1e-6 * np.abs(theirs).max() + 1e-7
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance, err_msg=jax.tree_util.keystr(path))
        assert moved > 0, path


def test_half_precision_is_near_single_precision(make_plain, make_motion_batch, draw_state):
    objectives, found = [make_plain(train__dtype=dtype) for dtype in ("float32", "bfloat16")], []
    state = draw_state(objectives[0])
    keys = step_keys(objectives[0].spec, jax.random.key(1), state.step)
    for objective in objectives:

        def loss(params, batch, objective=objective):
            variables = state.generator.variables | {"params": params}
            outputs, _, batch_stats = seq2seq.run(
                objective.spec, variables, batch, keys, train=True, compute=objective.compute
            )
            return jnp.mean(jnp.square(outputs.poses[-1][:, :12])), (outputs.poses[-1], batch_stats)

        found.append(jax.jit(jax.grad(loss, has_aux=True))(state.generator.params, make_motion_batch(objective, SIZE)))
    (gradient, (poses, _)), (half_gradient, (half_poses, batch_stats)) = found
    assert {leaf.dtype for leaf in jax.tree.leaves((half_poses, batch_stats, half_gradient))} == {np.dtype("float32")}
    assert 0 < np.abs(poses - half_poses)[:, :12].max() < 0.03 * np.abs(poses).max()
    distance = optax.tree.norm(jax.tree.map(jnp.subtract, gradient, half_gradient))
    assert distance < 0.1 * optax.tree.norm(gradient)


NUM_WORDS, POSE_DIM, NUM_FRAMES, HIDDEN_DIM = 9, 3, 12, 4
WORDS = np.array([[7, 2, 5, 8, 0, 0], [7, 3, 2, 4, 6, 8], [7, 8, 0, 0, 0, 0]])


@pytest.fixture(scope="module")
def model():
    return Seq2Seq(NUM_WORDS, POSE_DIM, NUM_FRAMES, embedding_dim=5, hidden_dim=HIDDEN_DIM)


@pytest.fixture(scope="module")
def variables(model):
    """Generic values for every parameter and statistic."""
    start = functools.partial(model.init, train=False)
    shapes = jax.eval_shape(start, jax.random.key(0), {"plain_words": WORDS}, None, _seed(4))
    rng = np.random.default_rng(1)
    return {
        "params": jax.tree.map(lambda x: rng.normal(0, 0.6, x.shape).astype(np.float32), shapes["params"]),
        "batch_stats": jax.tree.map(lambda x: rng.uniform(0.3, 2, x.shape).astype(np.float32), shapes["batch_stats"]),
    }


def _seed(num_frames):
    return np.random.default_rng(2).normal(size=(len(WORDS), num_frames, POSE_DIM)).astype(np.float32)


def _run(model, variables, words, seed):
    inputs = {"plain_words": words}
    return np.asarray(jax.jit(lambda seed: model.apply(variables, inputs, None, seed, train=False)[-1])(seed))


@pytest.mark.parametrize(("pose_dim", "count"), [(27, 1_939_027), (126, 1_978_726)])
def test_has_as_many_parameters_as_the_published_comparison(pose_dim, count):
    model = Seq2Seq(NUM_WORDS, pose_dim)
    inputs, seed = {"plain_words": jnp.zeros((1, 32), jnp.int32)}, jnp.zeros((1, 4, pose_dim))
    variables = jax.eval_shape(lambda key: model.init(key, inputs, None, seed, train=False), jax.random.key(0))
    table = variables["params"]["text"]["embedding"]["embedding"]
    assert table.shape == (NUM_WORDS, 300)
    assert sum(leaf.size for leaf in jax.tree.leaves(variables["params"])) - table.size == count


def test_shapes_of_every_part():
    model = Seq2Seq(NUM_WORDS, 27)

    def parts(key):
        inputs, seed = {"plain_words": jnp.zeros((2, 32), jnp.int32)}, jnp.zeros((2, 4, 27))
        variables = model.init(key, inputs, None, seed, train=False)
        sentence = model.apply(variables, inputs, train=False, method=Seq2Seq.encode_speech)
        return sentence, model.apply(variables, sentence, seed, train=False, method=Seq2Seq.infer)

    sentence, poses = jax.eval_shape(parts, jax.random.key(0))
    assert sentence.words.shape == (2, 32, 200)
    assert sentence.states.shape == (2, 2, 200)
    assert [level.shape for level in poses] == [(2, 34, 27)]


def _sigmoid(x):
    return 1 / (1 + np.exp(-x))


def _cell(params, suffix, state, x):
    """Compute one step of a GRU in float64, for one clip."""
    (w_r, w_z, w_n), (u_r, u_z, u_n), (b_r, b_z, b_n), (c_r, c_z, c_n) = (
        np.split(np.asarray(params[name + suffix], np.float64), 3)
        for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    )
    reset = _sigmoid(w_r @ x + b_r + u_r @ state + c_r)
    update = _sigmoid(w_z @ x + b_z + u_z @ state + c_z)
    return (1 - update) * np.tanh(w_n @ x + b_n + reset * (u_n @ state + c_n)) + update * state


def _direction(params, suffix, inputs):
    states = [np.zeros(HIDDEN_DIM)]
    for x in inputs:
        states.append(_cell(params, suffix, states[-1], x))
    return states[1:]


def _numpy_sentence(params, words):
    """Return e (T, h) and the first two entries of the list of final states, for one sentence without its padding."""
    inputs, final = list(np.asarray(params["embedding"]["embedding"], np.float64)[words]), []
    for layer in range(2):
        forward = _direction(params["gru"], f"_l{layer}", inputs)
        backward = _direction(params["gru"], f"_l{layer}_reverse", inputs[::-1])[::-1]
        final += [forward[-1], backward[0]]
        inputs = [np.concatenate(pair) for pair in zip(forward, backward, strict=True)]
    forward, backward = np.split(np.stack(inputs), 2, axis=1)
    return forward + backward, final[:2]


def _numpy_step(variables, states, pose, words):
    """Compute one step of the decoder in evaluation; attention over all of `words`, with W [h ; e] as one product."""
    params, statistics = variables["params"]["decoder"], variables["batch_stats"]["decoder"]["norm"]
    kernel = np.concatenate(
        [params["attention_state"]["kernel"], variables["params"]["attention_words"]["kernel"]]
    ).astype(np.float64)
    scores = np.array(
        [
            params["attention_vector"]
            @ np.tanh(np.concatenate([states[-1], e]) @ kernel + params["attention_state"]["bias"])
            for e in words
        ]
    )
    weights = np.exp(scores) / np.exp(scores).sum()
    x = np.concatenate([pose, weights @ words]) @ params["linear_in"]["kernel"] + params["linear_in"]["bias"]
    x = (x - statistics["mean"]) / np.sqrt(statistics["variance"] + 1e-5)
    x = np.maximum(x * params["norm"]["scale"] + params["norm"]["bias"], 0)
    bottom = _cell(params["gru"], "_l0", states[0], x)
    top = _cell(params["gru"], "_l1", states[1], bottom)
    return [bottom, top], top @ params["linear_out"]["kernel"] + params["linear_out"]["bias"]


def test_equals_the_equations(model, variables, oracles):
    """Encoder, start of the decoder, attention also over the padding, and decoder over all frames, clip by clip."""
    seed = _seed(4)
    found = _run(model, variables, WORDS, seed)
    for row, words in enumerate(WORDS):
        encoded, states = _numpy_sentence(variables["params"]["text"], words[words != 0])
        padded = np.concatenate([encoded, np.zeros((len(words) - len(encoded), HIDDEN_DIM))])
        poses = [seed[row, 0].astype(np.float64)]
        for frame in range(1, NUM_FRAMES):
            previous = seed[row, frame - 1] if frame - 1 < 4 else poses[-1]
            states, pose = _numpy_step(variables, states, previous, padded)
            poses.append(pose)
        oracles.assert_close(found[row], np.stack(poses))
    assert np.abs(np.diff(found[:, 5:], axis=1)).max() > 0.01  # it does move


def test_what_follows_the_sentence_has_no_content(model, variables):
    other = jax.tree.map(np.copy, variables)
    other["params"]["text"]["embedding"]["embedding"][0] += 5  # the row of the padding
    np.testing.assert_array_equal(_run(model, other, WORDS, _seed(4)), _run(model, variables, WORDS, _seed(4)))


@pytest.mark.parametrize("num_seed_frames", [1, 4, 7])
def test_true_poses_are_fed_until_the_seed_ends(model, variables, num_seed_frames):
    seed = _seed(num_seed_frames)
    poses = _run(model, variables, WORDS, seed)
    assert poses.shape == (len(WORDS), NUM_FRAMES, POSE_DIM)
    np.testing.assert_array_equal(poses[:, 0], seed[:, 0])
    for frame in range(num_seed_frames):
        moved = seed.copy()
        moved[:, frame] += 1
        is_changed = np.any(_run(model, variables, WORDS, moved) != poses, axis=(0, 2))
        assert is_changed[0] == (frame == 0)
        assert not is_changed[1 : frame + 1].any()
        assert is_changed[frame + 1]


def test_statistics_move_at_every_frame_of_the_batch(model, variables):
    model = model.clone(dropout=0.0)
    seed = _seed(4)
    inputs = {"plain_words": WORDS}
    (poses,), updates = jax.jit(
        lambda variables: model.apply(variables, inputs, None, seed, train=True, mutable=["batch_stats"])
    )(variables)

    decoder = PoseDecoder(POSE_DIM, HIDDEN_DIM, layers=2, dropout=0.0)
    step = jax.jit(functools.partial(decoder.apply, train=True, mutable=["batch_stats"]))
    words, states = model.apply(variables, inputs, train=False, method=Seq2Seq.encode_speech)
    keys = words @ variables["params"]["attention_words"]["kernel"]
    statistics, states, pose = variables["batch_stats"]["decoder"], tuple(jnp.moveaxis(states, 1, 0)), seed[:, 0]
    for frame in range(1, NUM_FRAMES):
        previous = seed[:, frame - 1] if frame - 1 < 4 else pose
        own = {"params": variables["params"]["decoder"], "batch_stats": statistics}
        (states, pose), moved = step(own, states, previous, words, keys)
        statistics = moved["batch_stats"]
        np.testing.assert_allclose(poses[:, frame], pose, rtol=1e-4, atol=1e-5)
    found = updates["batch_stats"]["decoder"]
    jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-5), found, statistics)
    assert np.abs(found["norm"]["mean"] - variables["batch_stats"]["decoder"]["norm"]["mean"]).max() > 0.05


@pytest.mark.parametrize(("dropout", "is_different"), [(0.0, False), (0.5, True)])
def test_dropout_draws_anew_at_every_frame(model, variables, dropout, is_different):
    """A decoder without memory and inputs gives the same pose at every frame, except for dropout."""
    blind = jax.tree.map(np.copy, variables)
    decoder = blind["params"]["decoder"]
    decoder["linear_in"]["kernel"][:POSE_DIM] = 0
    for layer in range(2):
        decoder["gru"][f"weight_hh_l{layer}"][:] = 0
        decoder["gru"][f"bias_ih_l{layer}"][HIDDEN_DIM : 2 * HIDDEN_DIM] = -50  # an update gate that is shut
    inputs, rngs = {"plain_words": np.zeros_like(WORDS)}, {"dropout": jax.random.key(0)}
    run = functools.partial(model.clone(dropout=dropout).apply, train=True, mutable=["batch_stats"], rngs=rngs)
    poses = np.asarray(jax.jit(lambda seed: run(blind, inputs, None, seed)[0][-1])(_seed(4)))
    changes = np.abs(np.diff(poses[:, 1:], axis=1)).max(axis=(0, 2))
    assert (changes > 0.01).sum() >= 8 if is_different else np.all(changes < 1e-5)


def test_a_single_clip_is_as_in_a_batch(model, variables):
    both = _run(model, variables, WORDS, _seed(4))
    alone = _run(model, variables, WORDS[:1], _seed(4)[:1])
    np.testing.assert_allclose(alone, both[:1], rtol=1e-5, atol=1e-6)

"""Attention Seq2Seq follows its equations."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.methods.seq2seq import PoseDecoder, Seq2Seq, continuity, mse, variance


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


def test_the_word_table_has_rows_for_the_marks_of_start_and_end(make_objective):
    assert make_objective("seq2seq").spec.generator.num_words == 11 + 2


@pytest.mark.parametrize(("text", "audio"), [("tcn", "resnet_se"), ("none", "none")])
def test_a_sentence_is_either_of_words_or_of_sound(text, audio, make_objective):
    with pytest.raises(UserError, match="to hear the sound in place of the words"):
        make_objective("seq2seq", model__text__kind=text, model__audio__kind=audio)


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


@pytest.fixture(scope="module")
def run(model, variables):
    """Return the poses of WORDS after a seed."""
    return jax.jit(lambda seed: model.apply(variables, {"plain_words": WORDS}, None, seed, train=False)[-1])


def _numpy_sentence(oracles, params, words):
    """Return e (T, h) and the first two entries of the list of final states, for one sentence without its padding."""
    inputs, final = np.asarray(params["embedding"]["embedding"], np.float64)[None, words], []
    for layer in range(2):
        forward = oracles.numpy_gru(params["gru"], f"_l{layer}", inputs)
        backward = oracles.numpy_gru(params["gru"], f"_l{layer}_reverse", inputs[:, ::-1])[:, ::-1]
        final += [forward[0, -1], backward[0, 0]]
        inputs = np.concatenate([forward, backward], axis=-1)
    forward, backward = np.split(inputs[0], 2, axis=1)
    return forward + backward, final[:2]


def _numpy_step(oracles, variables, states, pose, words):
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
    bottom = oracles.numpy_gru_cell(params["gru"], "_l0", states[0], x)
    top = oracles.numpy_gru_cell(params["gru"], "_l1", states[1], bottom)
    return [bottom, top], top @ params["linear_out"]["kernel"] + params["linear_out"]["bias"]


def test_equals_the_equations(run, variables, oracles):
    """Encoder, start of the decoder, attention also over the padding, and decoder over all frames, clip by clip."""
    seed = _seed(4)
    found = np.asarray(run(seed))
    for row, words in enumerate(WORDS):
        encoded, states = _numpy_sentence(oracles, variables["params"]["text"], words[words != 0])
        padded = np.concatenate([encoded, np.zeros((len(words) - len(encoded), HIDDEN_DIM))])
        poses = [seed[row, 0].astype(np.float64)]
        for frame in range(1, NUM_FRAMES):
            previous = seed[row, frame - 1] if frame - 1 < 4 else poses[-1]
            states, pose = _numpy_step(oracles, variables, states, previous, padded)
            poses.append(pose)
        oracles.assert_close(found[row], np.stack(poses))
    assert np.abs(np.diff(found[:, 5:], axis=1)).max() > 0.01  # it does move


@pytest.mark.parametrize("num_seed_frames", [1, 4, 7])
def test_true_poses_are_fed_until_the_seed_ends(run, num_seed_frames):
    seed = _seed(num_seed_frames)
    poses = run(seed)
    assert poses.shape == (len(WORDS), NUM_FRAMES, POSE_DIM)
    np.testing.assert_array_equal(poses[:, 0], seed[:, 0])
    for frame in range(num_seed_frames):
        moved = seed.copy()
        moved[:, frame] += 1
        is_changed = np.any(run(moved) != poses, axis=(0, 2))
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

"""GRUs equal PyTorch's, and the gradient of the recurrence is that of its steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.gru import BiGRU, GRUCells
from ha2g_jax.layers.gru_cell import Gates, activate, float32, gru_cell
from ha2g_jax.layers.gru_scan import gru_scan


def test_equals_the_equations(oracles):
    x = np.random.default_rng(0).normal(size=(2, 6, 3)).astype(np.float32)
    module = BiGRU(hidden_dim=4, layers=2)
    variables = jax.jit(lambda key: module.init(key, x, train=False))(jax.random.key(0))

    inputs = x.astype(np.float64)
    for layer in range(2):
        forward = oracles.numpy_gru(variables["params"], f"_l{layer}", inputs)
        backward = oracles.numpy_gru(variables["params"], f"_l{layer}_reverse", inputs[:, ::-1])[:, ::-1]
        inputs = np.concatenate([forward, backward], axis=-1)
    forward, backward = np.split(inputs, 2, axis=-1)
    oracles.assert_close(module.apply(variables, x, train=False), forward + backward)


@pytest.mark.parametrize("has_ends", [False, True])
def test_a_single_sequence_equals_the_same_one_of_a_batch(has_ends, oracles):
    """A batch of one takes another program: a scan for each direction."""
    x = np.random.default_rng(3).normal(size=(2, 5, 3)).astype(np.float32)
    is_real = np.arange(5) < np.array([[4], [5]]) if has_ends else None
    gru = BiGRU(hidden_dim=4, layers=2)
    variables = jax.jit(lambda key: gru.init(key, x, train=False))(jax.random.key(0))
    run = jax.jit(lambda x, is_real: gru.apply(variables, x, is_real=is_real, train=False, method="states"))
    together, alone = run(x, is_real), run(x[:1], None if is_real is None else is_real[:1])
    oracles.assert_close(alone, jax.tree.map(lambda states: states[:1], together))


def test_sums_of_rounded_arrays_are_those_of_float32():
    """The gradient computes the gates again, from arrays that may be rounded where the forward pass had float32."""
    values = jax.random.normal(jax.random.key(0), (7, 2, 16)).astype(jnp.bfloat16)
    arguments = (Gates(*values[:3]), Gates(*values[3:6]), values[6, 0])
    for found, expected in zip(activate(*arguments), activate(*float32(arguments)), strict=True):
        np.testing.assert_array_equal(found, expected, strict=True)


def test_dropout_acts_between_layers_only():
    x = np.random.default_rng(0).normal(size=(1, 4, 3)).astype(np.float32)

    def trained_and_not(gru, **options):
        variables = jax.jit(lambda key: gru.init(key, x, train=False))(jax.random.key(2))
        trained = jax.jit(lambda: gru.apply(variables, x, train=True, **options))
        return np.asarray(trained()), np.asarray(jax.jit(lambda: gru.apply(variables, x, train=False))())

    np.testing.assert_array_equal(*trained_and_not(BiGRU(4, layers=1, dropout=0.9)))
    double = trained_and_not(BiGRU(4, layers=2, dropout=0.9), rngs={"dropout": jax.random.key(1)})
    assert not np.allclose(*double)


@pytest.mark.torch
def test_equals_pytorch_in_values_and_gradients(oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    hidden = 7
    theirs = torch.nn.GRU(5, hidden, num_layers=4, bidirectional=True, batch_first=True)

    def forward(x):
        both, _ = theirs(x)
        return both[..., :hidden] + both[..., hidden:]

    oracles.check(
        torch,
        BiGRU(hidden, layers=4),
        lambda of: oracles.gru(theirs, of),
        forward,
        torch.randn(3, 9, 5),
        channels_first=False,
    )


def test_steps_after_the_end_change_nothing_and_sequences_end_where_they_end(oracles):
    x = np.random.default_rng(0).normal(size=(3, 6, 3)).astype(np.float32)
    lengths = (6, 4, 1)
    is_real = np.arange(6)[None] < np.array(lengths)[:, None]
    module = BiGRU(hidden_dim=4, layers=2)
    variables = jax.jit(lambda key: module.init(key, x, train=False))(jax.random.key(0))
    run = jax.jit(lambda x: module.apply(variables, x, is_real=is_real, train=False, method="states"))

    found = run(x)
    for row, length in enumerate(lengths):
        inputs = x[row : row + 1, :length].astype(np.float64)
        for layer, (forward, backward) in enumerate(found):
            expected = oracles.numpy_gru(variables["params"], f"_l{layer}", inputs)
            expected_back = oracles.numpy_gru(variables["params"], f"_l{layer}_reverse", inputs[:, ::-1])[:, ::-1]
            oracles.assert_close((forward[row, :length], backward[row, :length]), (expected[0], expected_back[0]))
            oracles.assert_close((forward[row, -1], backward[row, 0]), (expected[0, -1], expected_back[0, 0]))
            np.testing.assert_array_equal(backward[row, length:], 0)
            inputs = np.concatenate([expected, expected_back], axis=-1)

    for layer, other in zip(found, run(np.where(is_real[..., None], x, 1e3)), strict=True):
        jax.tree.map(np.testing.assert_array_equal, layer, other)


def test_cells_make_the_steps_of_the_equations(oracles):
    x = np.random.default_rng(0).normal(size=(2, 5, 3)).astype(np.float32)
    module = GRUCells(hidden_dim=4, layers=2)
    states = (jnp.zeros((2, 4)), jnp.zeros((2, 4)))
    variables = jax.jit(lambda key: module.init(key, states, x[:, 0], train=False))(jax.random.key(0))
    step = jax.jit(lambda states, x: module.apply(variables, states, x, train=False))

    found = []
    for frame in np.swapaxes(x, 0, 1):
        states = step(states, frame)
        found.append(states[-1])
    expected = oracles.numpy_gru(variables["params"], "_l1", oracles.numpy_gru(variables["params"], "_l0", x))
    oracles.assert_close(np.stack(found, axis=1), expected)


@pytest.mark.parametrize("is_padded", [False, True])
def test_gradients_of_both_orders_are_those_of_the_steps(oracles, is_padded):
    rng = np.random.default_rng(0)
    draw = lambda *shape: Gates(*rng.normal(size=(3, *shape)).astype(np.float32))  # noqa: E731
    gates, kernels, bias = draw(4, 3, 5), draw(5, 5), rng.normal(size=5).astype(np.float32)
    is_real = np.arange(4)[:, None, None] < np.array([4, 2, 1])[:, None] if is_padded else np.ones((4, 3, 1), bool)

    def scanned(arguments):
        gates, kernels, bias = arguments
        (states,) = gru_scan((gates,), (kernels,), (bias,), (jnp.asarray(is_real),) if is_padded else None)
        return jnp.sum(jnp.sin(states))

    def stepped(arguments):
        (gates, kernels, bias), state, total = arguments, jnp.zeros((3, 5)), 0.0
        for number in range(4):
            after = gru_cell(state, Gates(*(gate[number] for gate in gates)), kernels, bias)
            state = jnp.where(is_real[number], after, state)
            total += jnp.sum(jnp.sin(state))
        return total

    def second(function):
        return jax.grad(lambda it: sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(jax.grad(function)(it))))

    arguments = (gates, kernels, bias)
    for of in (jax.grad, second):
        oracles.assert_close(jax.jit(of(scanned))(arguments), jax.jit(of(stepped))(arguments))

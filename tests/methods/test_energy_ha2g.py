"""The energy score is least for samples of the true distribution, and a network that it trains makes both of two."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.methods.energy_ha2g import energy_score, trajectory_distance, velocity_distance

A = 0.3  # radius of the two motions that are equally likely


def motions(sides):
    """Two bones that lean to one side of x, +1 or -1, or to none, and wave: (B, 34, 6)."""
    time = np.arange(34)[None, :, None] / 15
    poses = np.zeros((len(sides), 34, 6))
    poses[..., [0, 3]] = A * np.asarray(sides)[:, None, None]
    poses[..., [1, 4]] = 0.1 * np.asarray(sides)[:, None, None] * np.sin(6 * time)
    return jnp.asarray(poses, jnp.float32)


@pytest.mark.parametrize("distance", [trajectory_distance, velocity_distance])
def test_the_score_is_least_for_the_true_distribution(distance):
    random = np.random.default_rng(0)
    signs = random.choice([-1.0, 1.0], (3, 4000))
    guesses = {"true": signs[:2], "mean": np.zeros((2, 4000)), "one": np.ones((2, 4000)), "wide": 1.5 * signs[:2]}
    scores = {
        name: float(energy_score(distance, *([motions(side)] for side in (*pair, signs[2]))))
        for name, pair in guesses.items()
    }
    assert all(scores["true"] < 0.9 * score for name, score in scores.items() if name != "true"), scores


def test_distances_of_equal_motions_have_a_bounded_gradient():
    poses = motions([1.0, -1.0])
    for distance in (trajectory_distance, velocity_distance):
        sum_of = jax.value_and_grad(lambda x, distance=distance: jnp.sum(distance(x, poses)))
        value, gradient = jax.jit(sum_of)(poses)
        assert value < 0.01 and not np.asarray(gradient).any()
    far = np.asarray(trajectory_distance(motions([1.0]), motions([-1.0])))
    assert far == pytest.approx(2 * A, rel=0.06)  # of the bones' mean, whatever the number of frames
    levels = energy_score(
        trajectory_distance, [poses, poses[..., :3]], [poses, poses[..., :3]], [-poses, -poses[..., :3]]
    )
    assert float(levels) == pytest.approx(4 * A, rel=0.1)  # the sum over levels


def test_a_network_that_is_trained_by_it_makes_both_motions():
    """Regression gives the mean of the two, 0."""
    keys = jax.random.split(jax.random.key(0), 3)
    params = {"in": jax.random.normal(keys[0], (4, 32)), "out": 0.1 * jax.random.normal(keys[1], (32, 34 * 6))}

    def generate(params, noise):
        return (jnp.tanh(noise @ params["in"]) @ params["out"]).reshape(-1, 34, 6)

    def loss(params, key):
        noise_key, side_key = jax.random.split(key)
        noise = jax.random.normal(noise_key, (2, 128, 4))
        is_right = jax.random.bernoulli(side_key, shape=(128,))[:, None, None]
        targets = jnp.where(is_right, motions([1.0]), motions([-1.0]))
        one, other = ([generate(params, half)] for half in noise)
        return energy_score(trajectory_distance, one, other, [targets]) + energy_score(
            velocity_distance, one, other, [targets]
        )

    optimizer = optax.adam(3e-3)

    def step(carry, key):
        params, state = carry
        updates, state = optimizer.update(jax.grad(loss)(params, key), state)
        return (optax.apply_updates(params, updates), state), None

    train = jax.jit(functools.partial(jax.lax.scan, step))
    (params, _), _ = train((params, optimizer.init(params)), jax.random.split(keys[2], 600))
    sides = np.asarray(generate(params, jax.random.normal(jax.random.key(9), (2000, 4))))[..., 0].mean(axis=1)
    assert np.mean(sides > 0) == pytest.approx(0.5, abs=0.1)
    assert np.mean(np.abs(np.abs(sides) - A) < 0.1) > 0.75

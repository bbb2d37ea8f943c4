"""Initial values are functions of the key with the distributions of PyTorch's layers."""

import jax
import numpy as np
import pytest
from scipy import stats

from ha2g_jax.layers import initializers

SHAPE = (3, 3, 40, 50)
DISTRIBUTIONS = {
    "uniform": (initializers.uniform(0.2), stats.uniform(-0.2, 0.4)),
    "normal": (initializers.normal(0.3), stats.norm(0, 0.3)),
    "linear": (initializers.LINEAR, stats.uniform(-(360**-0.5), 2 * 360**-0.5)),
    "half of linear": (initializers.linear(0.5**0.5), stats.uniform(-(720**-0.5), 2 * 720**-0.5)),
    "resnet": (initializers.RESNET, stats.norm(0, (2 / 450) ** 0.5)),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_values_have_their_distribution(name):
    draw, distribution = DISTRIBUTIONS[name]
    values = draw(jax.random.key(0), SHAPE)
    assert values.dtype == np.float32
    assert stats.kstest(np.ravel(values), distribution.cdf).pvalue > 0.01


def test_values_depend_on_the_key_alone():
    one, again, other = (initializers.LINEAR(jax.random.key(seed), (4, 5)) for seed in (0, 0, 1))
    compiled = jax.jit(lambda key: initializers.LINEAR(key, (4, 5)))(jax.random.key(0))
    np.testing.assert_array_equal(one, again)
    np.testing.assert_array_equal(one, compiled)
    assert not np.isclose(one, other).any()


@pytest.mark.parametrize("kind", ["rbg", "unsafe_rbg"])
def test_keys_of_other_generators_give_values_too(kind):
    """TPUs often have `JAX_DEFAULT_PRNG_IMPL=rbg`, whose keys have four words."""
    first, second = (initializers.LINEAR(key, (4, 5)) for key in jax.random.split(jax.random.key(0, impl=kind)))
    assert not np.isclose(first, second).any()

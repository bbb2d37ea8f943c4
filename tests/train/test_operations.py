"""Operations of products and convolutions are counted as often as they run."""

import jax
import jax.numpy as jnp

from ha2g_jax.layers.conv import conv
from ha2g_jax.train.operations import count_operations

X, KERNEL = jnp.ones((4, 16, 10, 8)), jnp.ones((3, 3, 8, 32))


def count(function, *arguments) -> int:
    return count_operations(jax.jit(function).trace(*arguments).jaxpr.jaxpr)


def test_a_product_of_batches():
    assert count(lambda a, b: jnp.einsum("bij,bjk->bik", a, b), jnp.ones((5, 2, 3)), jnp.ones((5, 3, 7))) == 420


def test_a_loop_counts_every_step():
    def chain(matrices):
        return jax.lax.scan(lambda x, matrix: (x @ matrix, None), jnp.ones((2, 3)), matrices)[0]

    assert count(chain, jnp.ones((7, 3, 3))) == 7 * 2 * 2 * 3 * 3


def test_a_branch_counts_once():
    def either(flag, x):
        return jax.lax.cond(flag, lambda x: x @ x, lambda x: x @ x @ x, x)

    assert count(either, True, jnp.ones((3, 3))) == 2 * 2 * 27


def test_a_convolution_and_its_gradients_take_the_same():
    """Products with the zeros between the rows of a gradient with stride are left out."""
    for stride in (1, 2):

        def total(x, kernel, stride=stride):
            return jnp.sum(conv(x, kernel, (stride, stride), 1))

        once = 2 * (4 * 16 * 10 // stride**2) * 32 * 9 * 8
        assert count(total, X, KERNEL) == once
        assert count(jax.grad(total, (0, 1)), X, KERNEL) == 3 * once

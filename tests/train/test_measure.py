"""Operations of products and convolutions are counted as often as they run."""

import gzip
import json
import pathlib

import jax
import jax.numpy as jnp

from ha2g_jax.layers.conv import conv
from ha2g_jax.train.measure import Profile, count_operations

X, KERNEL = jnp.ones((4, 16, 10, 8)), jnp.ones((3, 3, 8, 32))


def count(function, *arguments) -> int:
    return count_operations(jax.jit(function).trace(*arguments).jaxpr.jaxpr)


def test_products_are_counted_in_each_step_of_a_loop_and_in_one_branch():
    def chain(matrices):
        return jax.lax.scan(lambda x, matrix: (x @ matrix, None), jnp.ones((2, 3)), matrices)[0]

    def either(flag, x):
        return jax.lax.cond(flag, lambda x: x @ x, lambda x: x @ x @ x, x)

    assert count(lambda a, b: jnp.einsum("bij,bjk->bik", a, b), jnp.ones((5, 2, 3)), jnp.ones((5, 3, 7))) == 420
    assert count(chain, jnp.ones((7, 3, 3))) == 7 * 2 * 2 * 3 * 3
    assert count(either, True, jnp.ones((3, 3))) == 2 * 2 * 27


def test_a_convolution_and_its_gradients_take_the_same():
    """Products with the zeros between the rows of a gradient with stride are left out."""
    for stride in (1, 2):

        def total(x, kernel, stride=stride):
            return jnp.sum(conv(x, kernel, (stride, stride), 1))

        once = 2 * (4 * 16 * 10 // stride**2) * 32 * 9 * 8
        assert count(total, X, KERNEL) == once
        assert count(jax.grad(total, (0, 1)), X, KERNEL) == 3 * once


@jax.jit
def work(x: jax.Array) -> jax.Array:
    return jnp.tanh(x @ x)


def run(profile: Profile, steps: int) -> None:
    x = jnp.ones((32, 32))
    for number in range(100, 100 + steps):
        with profile.step(number):
            x = work(x)
    profile.close()


def traces(folder: pathlib.Path) -> list[pathlib.Path]:
    return list(folder.rglob("perfetto_trace.json.gz"))


def traced_steps(path: pathlib.Path) -> list[int]:
    """Return the numbers of the steps in a trace."""
    events = json.loads(gzip.decompress(path.read_bytes()))["traceEvents"]
    return sorted(int(event["args"]["step_num"]) for event in events if event.get("name") == "train")


def test_the_trace_has_the_steps_asked_for_and_says_where_it_is(tmp_path, capsys):
    run(Profile(tmp_path / "profile", first=2, steps=3), 8)
    (path,) = traces(tmp_path)
    assert traced_steps(path) == [102, 103, 104]
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and str(path) in said and "ui.perfetto.dev" in said


def test_a_run_that_ends_early_gives_its_trace_or_says_that_there_is_none(tmp_path, capsys):
    run(Profile(tmp_path / "some", first=1, steps=5), 3)
    assert traced_steps(traces(tmp_path)[0]) == [101, 102]
    capsys.readouterr()
    run(Profile(tmp_path / "none", first=3), 2)
    assert traces(tmp_path / "none") == []
    assert "no trace" in capsys.readouterr().err

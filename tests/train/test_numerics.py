"""Settings of precision, average and learning rates: what each changes and what it does not change."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.methods.adversarial import discriminate
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.train.objective import init_state
from ha2g_jax.train.step import step_keys, train_step

PRODUCTS = ("dot_general", "conv_general_dilated")


def products(jaxpr):
    """Return the dtypes of the operands of every matrix product and convolution, also in inner functions."""
    for equation in jaxpr.eqns:
        if equation.primitive.name in PRODUCTS:
            yield from (str(operand.aval.dtype) for operand in equation.invars)
        for inner in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")):
            if hasattr(inner, "eqns") or hasattr(inner, "jaxpr"):
                yield from products(getattr(inner, "jaxpr", inner))


@pytest.mark.parametrize(("kind", "accumulate"), [("speakers", 1), ("images", 2)])
def test_every_product_of_the_networks_is_in_bfloat16(config, build, make_batch, kind, accumulate):
    config.model.identity.kind = kind
    config.train.update({"dtype": "bfloat16", "accumulate": accumulate})
    objective = build(config)
    state = jax.eval_shape(functools.partial(init_state, objective), jax.random.key(0))

    def run(state, batch, key):
        keys = step_keys(objective.spec, key, state.step)
        variables = state.generator.variables
        outputs, pull_back, _ = jax.vjp(
            lambda params: ha2g.run(
                objective.spec, variables | {"params": params}, batch, keys, compute=objective.compute
            )[:2],
            variables["params"],
            has_aux=True,
        )
        logits, back = jax.vjp(
            lambda poses: discriminate(
                objective.spec, state.discriminator.variables, poses, key, compute=objective.compute
            )[0],
            outputs.poses[-1],
        )
        return outputs, logits, pull_back(outputs), back(logits)

    jaxpr, shapes = jax.make_jaxpr(run, return_shape=True)(state, make_batch(objective, 4), jax.random.key(1))
    found = list(products(jaxpr.jaxpr))
    assert len(found) > 200
    assert set(found) == {"bfloat16"}
    assert {leaf.dtype for leaf in jax.tree.leaves(shapes)} == {np.dtype(np.float32)}


@pytest.fixture(scope="module")
def switched(make_config, build, state, batch):
    """A step with all these settings: (compiled, state before, state after, metrics)."""
    config = make_config()
    config.train.update({"dtype": "bfloat16", "ema": 0.5, "clip_norm": 0.1, "schedule": "cosine", "steps": 8})
    objective = build(config, steps_per_epoch=2)
    start = state.replace(
        generator=state.generator.replace(opt_state=objective.generator_optimizer.init(state.generator.params)),
        discriminator=state.discriminator.replace(
            opt_state=objective.discriminator_optimizer.init(state.discriminator.params)
        ),
        average=jax.tree.map(lambda x: x + 1, state.generator.variables),
    )
    before = jax.tree.map(np.asarray, start)
    step = jax.jit(functools.partial(train_step, objective), donate_argnums=0)
    compiled = step.lower(start, batch, jax.random.key(1)).compile()
    after, metrics = compiled(jax.tree.map(jnp.array, before), batch, jax.random.key(1))
    return compiled, before, after, metrics


def test_bfloat16_changes_the_terms_by_little(switched, step, state, batch):
    *_, metrics = switched
    _, expected = step(state, batch, jax.random.key(1))
    for name, value in expected.items():
        if name.startswith("loss/"):
            assert metrics[name] == pytest.approx(float(value), rel=0.02), name
    for name in ("grad_norm/generator", "grad_norm/discriminator"):
        assert metrics[name] == pytest.approx(float(expected[name]), rel=0.1), name


def test_the_state_stays_float32_and_is_updated_in_place(switched):
    compiled, before, after, _ = switched
    assert jax.tree.map(lambda x: x.dtype, after) == jax.tree.map(lambda x: x.dtype, before)
    floats = {leaf.dtype for leaf in jax.tree.leaves(after) if jnp.issubdtype(leaf.dtype, jnp.floating)}
    assert floats == {np.dtype(np.float32)}
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(before))
    assert compiled.memory_analysis().alias_size_in_bytes == size


def test_the_average_moves_towards_the_new_variables(switched):
    _, before, after, _ = switched
    assert before.step == 2
    kept = (1 + 2) / (10 + 2)  # less than 0.5
    variables = jax.device_get(after.generator.variables)
    expected = jax.tree.map(lambda old, new: kept * old + (1 - kept) * new, before.average, variables)
    for moved, value in zip(jax.tree.leaves(after.average), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(moved, value, rtol=1e-5, atol=1e-6)
    assert after.model is after.average


def test_both_rates_are_on_the_schedule_of_the_run(switched):
    *_, metrics = switched
    expected = 5e-4 * (1 + np.cos(np.pi * 2 / 8)) / 2
    assert metrics["learning_rate/generator"] == pytest.approx(expected)
    assert metrics["learning_rate/discriminator"] == pytest.approx(expected / 5)

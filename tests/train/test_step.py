"""One step: what it shares, draws, rounds and leaves alone; and a hundred of them learn a batch by heart."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.config import presets
from ha2g_jax.data.corpus import TRAIN
from ha2g_jax.methods import adversarial, method_of
from ha2g_jax.methods.ha2g.method import Terms
from ha2g_jax.methods.method import subtract_mean, total
from ha2g_jax.methods.networks import apply
from ha2g_jax.train import inputs
from ha2g_jax.train import step as steps
from ha2g_jax.train.objective import build_objective, init_state


def max_difference(first, second):
    return max(
        jax.tree.leaves(jax.tree.map(lambda a, b: float(np.max(np.abs(np.asarray(a) - np.asarray(b)))), first, second))
    )


def equal(first, second):
    return jax.tree.all(jax.tree.map(np.array_equal, first, second))


def two_pass_step(objective, state, batch, key):
    """Do the usual alternation: a forward pass to train the discriminator, another to train the generator."""
    keys = steps.step_keys(objective.spec, key, state.step)
    targets = subtract_mean(objective.spec, batch["directions"])
    fake = method_of(objective.spec).run(objective.spec, state.generator.variables, batch, keys).outputs.poses[-1]
    real_key, fake_key = jax.random.split(keys["discriminator"])
    discriminate = functools.partial(apply, objective.spec.discriminator, train=True, compute=objective.compute)

    def descend(network, gradient, rate):
        updates, _ = objective.optimizer.update(gradient, network.opt_state)
        return optax.apply_updates(network.params, optax.tree.scale(rate(state.step), updates))

    def discriminator_loss(params):
        variables = state.discriminator.variables | {"params": params}
        real_logits, batch_stats = discriminate(variables, real_key, targets)
        fake_logits, _ = discriminate(variables | {"batch_stats": batch_stats}, fake_key, fake)
        return adversarial.gan_discriminator(real_logits, fake_logits)

    gradient = jax.grad(discriminator_loss)(state.discriminator.params)
    params = descend(state.discriminator, gradient, objective.discriminator_rate)
    discriminator = state.discriminator.replace(params=params)

    def generator_loss(params):
        variables = state.generator.variables | {"params": params}
        outputs, constants, _ = method_of(objective.spec).run(objective.spec, variables, batch, keys)
        fake_logits, _ = discriminate(discriminator.variables, keys["gan"], outputs.poses[-1])
        gan = adversarial.gan_generator(fake_logits)
        terms = method_of(objective.spec).terms(objective.spec, objective.settings, outputs, constants, targets, gan)
        return total(objective.weights, terms)

    gradient = jax.grad(generator_loss)(state.generator.params)
    return descend(state.generator, gradient, objective.generator_rate), discriminator.params


def test_shared_forward_equals_the_two_pass_alternation(objective, step, state, batch):
    key = jax.random.key(1)
    after, metrics = step(state, batch, key)
    generator, discriminator = jax.jit(functools.partial(two_pass_step, objective))(state, batch, key)
    for before, ours, theirs in (
        (state.generator.params, after.generator.params, generator),
        (state.discriminator.params, after.discriminator.params, discriminator),
    ):
        moved = max_difference(before, theirs)
        assert moved > 1e-4
        assert max_difference(ours, theirs) < 1e-4 * moved
    for before, network in ((state.generator, after.generator), (state.discriminator, after.discriminator)):
        moved = jax.tree.map(lambda a, b: not np.array_equal(a, b), before.batch_stats, network.batch_stats)
        assert jax.tree.all(moved)
    assert {name for name in metrics if name.startswith("loss/")} == {
        f"loss/{name}" for name in (*Terms._fields, "total", "discriminator")
    }


def test_adversary_waits_for_the_end_of_warmup(objective, step, state, batch):
    states = [state.replace(step=jnp.int32(0))]
    for count in range(3):
        after, metrics = step(states[-1], batch, jax.random.key(1))
        states.append(after)
        weights = objective.weights._asdict() | ({} if count >= objective.warmup_steps else {"gan": 0.0})
        expected = sum(weight * float(metrics[f"loss/{name}"]) for name, weight in weights.items())
        assert metrics["loss/total"] == pytest.approx(expected, rel=1e-5)
    discriminators = [state.discriminator for state in states]
    assert max_difference(discriminators[0], discriminators[2]) == 0
    assert max_difference(discriminators[2].params, discriminators[3].params) > 0
    assert max_difference(states[0].generator.params, states[1].generator.params) > 0
    assert states[3].step == 3


def test_the_ratio_of_gradients_is_0_during_warm_up_alone(step, state, batch):
    ratios = [
        step(state.replace(step=jnp.int32(number)), batch, jax.random.key(1))[1]["gradient_ratio/gan"]
        for number in (0, 1, 2, 3)
    ]
    assert [float(ratio) > 0 for ratio in ratios] == [False, False, True, True]


def test_chance_comes_from_the_key_and_the_step_alone(step, state, batch):
    first, again = (step(state, batch, jax.random.key(1))[1] for _ in range(2))
    assert first == again
    for start, seed in ((state, 2), (state.replace(step=state.step + 1), 1)):
        assert step(start, batch, jax.random.key(seed))[1]["loss/style"] != first["loss/style"]


def test_silence_without_words_trains(step, state, batch):
    silence = {"mel": np.full_like(batch["mel"], -80), "words": np.zeros_like(batch["words"])}
    after, metrics = step(state, batch | silence, jax.random.key(1))
    assert all(jnp.isfinite(value) for value in metrics.values())
    assert jax.tree.all(jax.tree.map(lambda x: bool(np.isfinite(x).all()), after.generator.params))


@pytest.mark.parametrize("is_warm", [True, False])
def test_a_step_that_is_not_finite_leaves_the_state_as_it_was(step, state, batch, is_warm):
    before = state if is_warm else state.replace(step=jnp.int32(0))
    broken = batch | {"directions": np.where(np.arange(3)[:, None, None, None] == 1, np.nan, batch["directions"])}
    after, metrics = step(before, broken, jax.random.key(1))
    assert not jnp.isfinite(metrics["loss/huber"])
    assert not jnp.isfinite(metrics["loss/discriminator"])
    assert jnp.isfinite(metrics["loss/contrastive"])
    assert not after.is_finite
    assert equal(after.replace(is_finite=before.is_finite), before)
    later, metrics = step(after, batch, jax.random.key(1))
    assert equal(later, after)
    assert metrics == step(before, batch, jax.random.key(1))[1]


def test_a_discriminator_that_is_not_finite_counts_in_warmup_too(step, state, batch):
    last = state.discriminator.params["linear_2"]
    infinite = {"kernel": jnp.full_like(last["kernel"], jnp.inf), "bias": last["bias"]}
    params = {**state.discriminator.params, "linear_2": infinite}
    broken = state.replace(step=jnp.int32(0), discriminator=state.discriminator.replace(params=params))
    after, metrics = step(broken, batch, jax.random.key(1))
    assert not jnp.isfinite(metrics["loss/discriminator"])
    assert not after.is_finite
    assert equal(after.replace(is_finite=broken.is_finite), broken)


def test_validation_uses_the_mean_identity(objective, state, batch):
    validate = jax.jit(functools.partial(steps.validation_step, objective))
    first, second = (validate(state, batch, jax.random.key(seed)) for seed in (1, 2))
    assert first.keys() == {f"loss/{name}" for name in (*Terms._fields, "total")}
    for name in ("huber", "physical", "kld", "contrastive", "gan"):
        assert first[f"loss/{name}"] == second[f"loss/{name}"]


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
        keys = steps.step_keys(objective.spec, key, state.step)
        discriminate = functools.partial(apply, objective.spec.discriminator, train=True, compute=objective.compute)
        (outputs, *_), pull_back = steps.run_generator(objective, state.generator, batch, keys)
        logits, back = jax.vjp(
            lambda poses: discriminate(state.discriminator.variables, key, poses)[0],
            outputs.poses[-1],
        )
        return outputs, logits, pull_back(outputs), back(logits)

    jaxpr, shapes = jax.make_jaxpr(run, return_shape=True)(state, make_batch(objective, 4), jax.random.key(1))
    found = list(products(jaxpr.jaxpr))
    assert len(found) > 200
    assert set(found) == {"bfloat16"}
    assert {leaf.dtype for leaf in jax.tree.leaves(shapes)} == {np.dtype(np.float32)}


@pytest.fixture(scope="module")
def switched(make_objective, draw_state, make_motion_batch):
    """A step of Trimodal, which compiles in a third of the time, with all these settings.

    (compiled, state before, state after, metrics)
    """
    settings = {"dtype": "bfloat16", "ema": 0.5, "clip_norm": 0.1, "schedule": "cosine", "steps": 8}
    objective = make_objective("trimodal", **{f"train__{name}": value for name, value in settings.items()})
    objective = dataclasses.replace(objective, warmup_steps=2)
    batch, state = make_motion_batch(objective, 3), draw_state(objective)
    start = state.replace(
        step=jnp.int32(2),
        generator=state.generator.replace(opt_state=objective.optimizer.init(state.generator.params)),
        discriminator=state.discriminator.replace(opt_state=objective.optimizer.init(state.discriminator.params)),
        average=jax.tree.map(lambda x: x + 1, state.generator.variables),
    )
    before = jax.tree.map(np.asarray, start)
    step = jax.jit(functools.partial(steps.train_step, objective), donate_argnums=0)
    compiled = step.lower(start, batch, jax.random.key(1)).compile()
    after, metrics = compiled(jax.tree.map(jnp.array, before), batch, jax.random.key(1))
    return compiled, before, after, metrics


def test_bfloat16_changes_the_terms_by_little(objective, step, state, batch):
    half = dataclasses.replace(objective, compute=objective.compute._replace(dtype=jnp.dtype("bfloat16")))
    _, metrics = jax.jit(functools.partial(steps.train_step, half))(state, batch, jax.random.key(1))
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


def test_the_statistics_of_the_average_become_those_of_its_own_parameters(make_objective, draw_state, make_batch):
    objective = make_objective("autoencoder", train__ema=0.999)
    state, batch, key = draw_state(objective), make_batch(objective, 64), jax.random.key(0)
    average = {**state.average, "params": jax.tree.map(lambda x: 1.5 * x, state.average["params"])}
    state = state.replace(average=average)

    @functools.partial(jax.jit, static_argnums=1)
    def poses(average, train):
        run = method_of(objective.spec).run
        return run(objective.spec, average, batch, {"dropout": key}, train=train).outputs.poses[-1]

    def output(train):
        return poses(state.average, train)

    settle = jax.jit(functools.partial(steps.settle_average, objective))
    before, distance = state, max_difference(output(False), output(True))
    for _ in range(100):
        state = settle(state, batch, key)
    assert max_difference(output(False), output(True)) < 0.1 * distance
    assert equal(state.average["params"], average["params"]) and equal(state.generator, before.generator)

    failed = before.replace(is_finite=jnp.zeros((), bool))
    assert equal(settle(failed, batch, key), failed)


def test_both_rates_are_on_the_schedule_of_the_run(switched):
    *_, metrics = switched
    expected = 5e-4 * (1 + np.cos(np.pi * 2 / 8)) / 2
    assert metrics["learning_rate/generator"] == pytest.approx(expected)
    assert metrics["learning_rate/discriminator"] == pytest.approx(expected / 5)


def test_one_batch_is_learnt_by_heart_in_100_steps(tiny_talk, draw_state):
    config = presets.sized("ted_expressive", "debug")
    config.model.identity.kind = "speakers"
    config.model.inferer.levels = (6,)
    config.data.path = str(tiny_talk)
    config.train.batch_size = 2
    config.train.update({"steps": 100, "learning_rate": 1e-2, "schedule": "cosine"})
    # The physical term holds joints at their mean angles, and the Huber term at 2 %. The style term holds the poses
    # away from those with the other identity, and the Huber term at 5 %.
    config.loss.ha2g.weights.update({"physical": 0.0, "style": 0.0})
    corpus = inputs.open_corpus(config)
    vocabulary, speakers = corpus.vocabulary(), corpus.speakers_of(TRAIN)
    objective = build_objective(config, corpus.skeleton, len(vocabulary), len(speakers))
    windows = inputs.open_windows(config, objective.spec, corpus, TRAIN)
    examples = [windows[index] for index in range(config.train.batch_size)]
    batch = {name: np.stack([example[name] for example in examples]) for name in examples[0]}

    assert objective.warmup_steps == 0
    step = jax.jit(functools.partial(steps.train_step, objective), donate_argnums=0)
    state, history = draw_state(objective), []
    for _ in range(config.train.steps):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics["loss/huber"])
    assert history[-1] < 0.01 * history[0]

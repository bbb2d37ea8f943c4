"""One training step of any method: the generator runs forward once, and its output trains both networks.

The output, detached, first feeds the update of the discriminator. Then the gradient of the objective with
respect to the output is taken through the updated discriminator and pulled back through the generator. This
equals the alternation of two separate updates with the same dropout keys at half the forward cost.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ha2g_jax.checkpoint.state import Network, TrainState
from ha2g_jax.methods import adversarial
from ha2g_jax.methods.build import method_of
from ha2g_jax.methods.forward import discriminate
from ha2g_jax.methods.method import Batch, Spec, subtract_mean
from ha2g_jax.train.objective import Objective
from ha2g_jax.train.terms import Metrics, loss_terms, output_gradient, total


def train_step(objective: Objective, state: TrainState, batch: Batch, key: jax.Array) -> tuple[TrainState, Metrics]:
    """Update the discriminator, then the generator.

    The BatchNorm statistics of the generator are updated once with this batch. Those of the discriminator are updated
    with the real and then with the generated poses of its own update; the pass that carries the gradient of the
    generator normalises by the statistics of its batch and updates nothing. During warm-up (`objective.warmup_steps`)
    the GAN term has weight 0 and the discriminator does not change.

    If a loss or the norm of a gradient is not finite (also those of the discriminator during warm-up), the state keeps
    its values from before the step, the step number included, except that `is_finite` becomes False. The same call
    would then give the same metrics, and all later steps leave the state unchanged.

    `objective.compute.num_parts` changes the memory of a step but not the update: statistics and candidates are always
    those of the whole batch. Only the dropout masks of the parts are drawn differently from those of the whole batch.

    With `objective.average_decay` D the average changes after t steps as

        average <- d average + (1 - d) generator,   d = min(D, (1 + t) / (10 + t))

    so that it starts from the initial variables and their weight soon vanishes.

    Args:
        objective: static.
        state: state before the step.
        batch: arrays by name: the speech inputs in `objective.spec.training_inputs`, such as "mel" (B, 128, 70) and
            "words" (B, N); "directions" (B, N, bones, 3), "speaker" (B,) and, where identities come from images,
            "images" (B, M, S, S, 3) uint8.
        key: key of the run; the step number is folded in.

    Returns:
        The state after the step, and scalars: "loss/<term>" (unweighted), "loss/total" (weighted),
        "grad_norm/generator" (before clipping) and "learning_rate/generator"; with a discriminator also
        "loss/discriminator", "grad_norm/discriminator", "learning_rate/discriminator" and "gradient_ratio/gan": the
        norm of the weighted gradient of the GAN term with respect to the poses of the last level, divided by that of
        the reconstruction term; 0 during warm-up.
    """
    spec = objective.spec
    keys = step_keys(spec, key, state.step)
    targets = subtract_mean(spec, batch["directions"])
    is_warm = state.step >= objective.warmup_steps

    outputs, pull_back, (generator_stats, aux) = run_generator(objective, state.generator, batch, keys)
    discriminator, discriminator_metrics = state.discriminator, {}
    if discriminator is not None:
        discriminator, discriminator_metrics = _update_discriminator(
            objective,
            discriminator,
            state.step,
            targets,
            jax.lax.stop_gradient(outputs.poses[-1]),
            keys["discriminator"],
        )
        discriminator = _where(is_warm, discriminator, state.discriminator)

    cotangent, metrics = output_gradient(objective, discriminator, outputs, aux, targets, keys["gan"], is_warm)
    (gradient,) = pull_back(cotangent)
    generator = _update(state.generator, gradient, objective.generator_optimizer, state.step)
    generator = generator.replace(batch_stats=generator_stats)

    metrics |= {"grad_norm/generator": optax.tree.norm(gradient)} | discriminator_metrics
    is_finite = state.is_finite & jnp.isfinite(jnp.stack(list(metrics.values()))).all()
    average = _move_average(objective, state, generator)
    after = TrainState(state.step + 1, generator, discriminator, average, is_finite)
    rates = {"generator": objective.generator_rate}
    if discriminator is not None:
        rates["discriminator"] = objective.discriminator_rate
    metrics |= {f"learning_rate/{name}": jnp.asarray(rate(state.step), jnp.float32) for name, rate in rates.items()}
    return _where(is_finite, after, state).replace(is_finite=is_finite), metrics


def validation_step(objective: Objective, state: TrainState, batch: Batch, key: jax.Array) -> Metrics:
    """Return the terms of the objective for `state.model` in evaluation mode, with the mean of each identity.

    Args:
        objective, state, batch: as in `train_step`.
        key: key of all noise, such as the permutation of the identities of the style term. It is not a function of the
            step here, so that validations of one run differ by the networks alone.

    Returns:
        "loss/<term>" (unweighted) and "loss/total" (weighted, with the GAN term also during warm-up).
    """
    spec, keys = objective.spec, step_keys(objective.spec, key, jnp.zeros((), jnp.int32))
    targets = subtract_mean(spec, batch["directions"])
    outputs, (_, aux) = method_of(spec).run(spec, state.model, batch, keys, train=False, compute=objective.compute)
    terms = loss_terms(objective, state.discriminator, outputs, aux, targets, keys["gan"], train=False)
    return {f"loss/{name}": term for name, term in terms.items()} | {"loss/total": total(objective, terms)}


def step_keys(spec: Spec, key: jax.Array, step: jax.Array) -> dict[str, jax.Array]:
    """Return the keys of one step, one for each random stream of the method and of the adversarial loss.

    Args:
        spec: networks and sizes.
        key: key of the run.
        step: number of the step, which is folded into the key.
    """
    uses = (*method_of(spec).keys, "discriminator", "gan")
    return dict(zip(uses, jax.random.split(jax.random.fold_in(key, step), len(uses)), strict=True))


def run_generator(
    objective: Objective, generator: Network, batch: Batch, keys: dict[str, jax.Array]
) -> tuple[Any, Callable[[Any], tuple[Any]], tuple[Any, Any]]:
    """Run the generator in training mode, ready to be differentiated.

    Args:
        objective: static.
        generator: network whose parameters the result is differentiated by.
        batch: arrays as in `train_step`.
        keys: keys of `step_keys`.

    Returns:
        (outputs, pull_back, (batch statistics after the run, aux)) with outputs and aux as of `Method.run`; `pull_back`
        takes the gradient with respect to the outputs to (the gradient with respect to the parameters,).
    """
    spec, compute = objective.spec, objective.compute

    def run(params: Any) -> tuple[Any, Any]:
        variables = generator.variables | {"params": params}
        return method_of(spec).run(spec, variables, batch, keys, train=True, compute=compute)

    return jax.vjp(run, generator.params, has_aux=True)


def _update_discriminator(
    objective: Objective, network: Network, step: jax.Array, real: jax.Array, fake: jax.Array, key: jax.Array
) -> tuple[Network, Metrics]:
    real_key, fake_key = jax.random.split(key)
    logits = functools.partial(discriminate, objective.spec, compute=objective.compute)

    def loss(params):
        variables = network.variables | {"params": params}
        real_logits, batch_stats = logits(variables, real, real_key)
        fake_logits, batch_stats = logits(variables | {"batch_stats": batch_stats}, fake, fake_key)
        return adversarial.gan_discriminator(real_logits, fake_logits, kind=objective.gan), batch_stats

    (value, batch_stats), gradient = jax.value_and_grad(loss, has_aux=True)(network.params)
    updated = _update(network, gradient, objective.discriminator_optimizer, step).replace(batch_stats=batch_stats)
    return updated, {"loss/discriminator": value, "grad_norm/discriminator": optax.tree.norm(gradient)}


def _update(network: Network, gradient: Any, optimizer: optax.GradientTransformation, step: jax.Array) -> Network:
    update = optax.with_extra_args_support(optimizer).update
    updates, opt_state = update(gradient, network.opt_state, network.params, step=step)
    return network.replace(params=optax.apply_updates(network.params, updates), opt_state=opt_state)


def _move_average(objective: Objective, state: TrainState, generator: Network) -> Any:
    if state.average is None:
        return None
    kept = jnp.minimum(objective.average_decay, (1 + state.step) / (10 + state.step))
    return jax.tree.map(lambda old, new: kept * old + (1 - kept) * new, state.average, generator.variables)


def _where(condition: jax.Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda new, old: jnp.where(condition, new, old), new, old)

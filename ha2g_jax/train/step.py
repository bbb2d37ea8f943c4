"""One training step of any method: the generator runs forward once, and its output trains both networks."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ha2g_jax.checkpoint.state import Network, TrainState
from ha2g_jax.methods import adversarial, method_of
from ha2g_jax.methods.method import Batch, Run, Spec, subtract_mean, total
from ha2g_jax.methods.networks import apply
from ha2g_jax.train.objective import Objective

Metrics = dict[str, jax.Array]

_MIN_NORM = 1e-12  # lower bound of a gradient's norm that another is divided by


def train_step(objective: Objective, state: TrainState, batch: Batch, key: jax.Array) -> tuple[TrainState, Metrics]:
    """Update the discriminator, then the generator:

    1. the generator runs forward once;
    2. the discriminator is updated with the true poses and, detached, the generated ones;
    3. the gradient of the objective with respect to the generated poses is taken through the updated discriminator;
    4. that gradient is pulled back through the generator, which is updated.

    This equals two separate updates with the same dropout keys, at half the forward cost.

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

    so that it starts from the initial variables and their weight soon vanishes; see also `settle_average`.

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
    has_gan = state.step >= objective.warmup_steps
    rates = {"generator": jnp.asarray(objective.generator_rate(state.step), jnp.float32)}

    run, pull_back = run_generator(objective, state.generator, batch, keys)
    discriminator, discriminator_metrics = state.discriminator, {}
    if discriminator is not None:
        rates["discriminator"] = jnp.asarray(objective.discriminator_rate(state.step), jnp.float32)
        discriminator, discriminator_metrics = _update_discriminator(
            objective,
            discriminator,
            rates["discriminator"],
            targets,
            jax.lax.stop_gradient(run.outputs.poses[-1]),
            keys["discriminator"],
        )
        discriminator = optax.tree.where(has_gan, discriminator, state.discriminator)

    cotangent, metrics = output_gradient(objective, discriminator, run, targets, keys["gan"], has_gan)
    (gradient,) = pull_back(cotangent)
    generator = _update(state.generator, gradient, objective.optimizer, rates["generator"])
    generator = generator.replace(batch_stats=run.batch_stats)

    metrics |= {"grad_norm/generator": optax.tree.norm(gradient)} | discriminator_metrics
    is_finite = state.is_finite & jnp.isfinite(jnp.stack(list(metrics.values()))).all()
    average = _move_average(objective, state, generator)
    after = TrainState(state.step + 1, generator, discriminator, average, is_finite)
    metrics |= {f"learning_rate/{name}": rate for name, rate in rates.items()}
    return optax.tree.where(is_finite, after, state).replace(is_finite=is_finite), metrics


def settle_average(objective: Objective, state: TrainState, batch: Batch, key: jax.Array) -> TrainState:
    """Update the BatchNorm statistics of the average by running its own parameters on a batch.

    A running mean of the statistics fits the parameters of past steps, not their average. The statistics of the average
    have to be measured with its own parameters (Izmailov et al. 2018, section 3.2).

    Args:
        objective, state, batch, key: as for `train_step`; the state has an average.

    Returns:
        The state with the updated statistics; unchanged if `state.is_finite` is False.
    """
    keys = step_keys(objective.spec, key, state.step)
    run = method_of(objective.spec).run(objective.spec, state.average, batch, keys, compute=objective.compute)
    settled = state.average | {"batch_stats": run.batch_stats}
    return state.replace(average=optax.tree.where(state.is_finite, settled, state.average))


def validation_step(objective: Objective, state: TrainState, batch: Batch, key: jax.Array) -> Metrics:
    """Return the terms of the objective for `state.model` in evaluation mode, with the mean of each identity.

    All noise, such as the permutation of the identities in the style term, is the same at every step, so that
    validations of one run differ only by the networks.

    Returns:
        "loss/<term>" (unweighted) and "loss/total" (weighted, with the GAN term also during warm-up).
    """
    spec, keys = objective.spec, step_keys(objective.spec, key, jnp.zeros((), jnp.int32))
    targets = subtract_mean(spec, batch["directions"])
    run = method_of(spec).run(spec, state.model, batch, keys, train=False, compute=objective.compute)
    terms = loss_terms(objective, state.discriminator, run, targets, keys["gan"], train=False)
    return _loss_metrics(terms, total(objective.weights, terms))


def step_keys(spec: Spec, key: jax.Array, step: jax.Array) -> dict[str, jax.Array]:
    """Fold the number of a step into the key of the run, and return a key for each random stream of the method and of
    the adversarial loss.
    """
    uses = (*method_of(spec).rngs, "discriminator", "gan")
    return dict(zip(uses, jax.random.split(jax.random.fold_in(key, step), len(uses)), strict=True))


def run_generator(
    objective: Objective, generator: Network, batch: Batch, keys: dict[str, jax.Array]
) -> tuple[Run[Any, Any], Callable[[Any], tuple[Any]]]:
    """Run the generator in training mode, ready to be differentiated; the keys are those of `step_keys`.

    Returns:
        The run, and a function that takes the gradient with respect to its outputs to (that of the parameters,).
    """
    spec, compute = objective.spec, objective.compute

    def run(params: Any) -> tuple[Any, Run[Any, Any]]:
        variables = generator.variables | {"params": params}
        result = method_of(spec).run(spec, variables, batch, keys, train=True, compute=compute)
        return result.outputs, result

    _, pull_back, result = jax.vjp(run, generator.params, has_aux=True)
    return result, pull_back


def loss_terms(
    objective: Objective,
    discriminator: Network | None,
    run: Run[Any, Any],
    targets: jax.Array,
    key: jax.Array,
    *,
    train: bool,
) -> Any:
    """Return the unweighted terms of the objective, `Method.Terms`, of a run of the generator.

    The targets are the true poses (B, N, pose_dim), mean-subtracted. The discriminator, None for a method without one,
    runs in training mode if `train`, with the key for its dropout.
    """
    outputs, constants, _ = run
    gan = None if discriminator is None else _gan_term(objective, discriminator, outputs.poses[-1], key, train=train)
    return method_of(objective.spec).terms(objective.spec, objective.settings, outputs, constants, targets, gan)


def output_gradient(
    objective: Objective,
    discriminator: Network | None,
    run: Run[Any, Any],
    targets: jax.Array,
    key: jax.Array,
    has_gan: jax.Array,
) -> tuple[Any, Metrics]:
    """Return the gradient of the objective with respect to the outputs of the generator, and the metrics of its terms.

    The gradient of the GAN term is taken by itself and chained, so that its norm can be compared with that of the
    reconstruction. The GAN term counts if `has_gan` () is true. The other arguments are those of `loss_terms`, in
    training mode.

    Returns:
        The gradient, as `outputs`, and the metrics "loss/<term>", "loss/total" and, with a discriminator,
        "gradient_ratio/gan" of `train_step`.
    """
    spec, weights, method = objective.spec, objective.weights, method_of(objective.spec)
    outputs, constants, _ = run
    gan = gan_gradient = None
    if discriminator is not None:
        weights = weights._replace(gan=jnp.where(has_gan, weights.gan, 0.0))
        gan, gan_gradient = jax.value_and_grad(_gan_term, argnums=2)(
            objective, discriminator, outputs.poses[-1], key, train=True
        )

    def objective_of(outputs: Any) -> tuple[jax.Array, Any]:
        terms = method.terms(spec, objective.settings, outputs, constants, targets, gan)
        return total(weights, terms), terms

    (value, terms), gradient = jax.value_and_grad(objective_of, has_aux=True)(outputs)
    metrics = _loss_metrics(terms, value)
    if discriminator is None:
        return gradient, metrics

    *coarse, last = gradient.poses
    whole = gradient._replace(poses=(*coarse, last + weights.gan * gan_gradient))

    def reconstruction(poses: jax.Array) -> jax.Array:
        changed = outputs._replace(poses=(*outputs.poses[:-1], poses))
        return getattr(objective_of(changed)[1], method.reconstruction_term)

    norm = getattr(weights, method.reconstruction_term) * optax.tree.norm(jax.grad(reconstruction)(outputs.poses[-1]))
    ratio = weights.gan * optax.tree.norm(gan_gradient) / jnp.maximum(norm, _MIN_NORM)
    return whole, metrics | {"gradient_ratio/gan": ratio}


def _loss_metrics(terms: Any, total: jax.Array) -> Metrics:
    return {f"loss/{name}": term for name, term in terms._asdict().items()} | {"loss/total": total}


def _gan_term(
    objective: Objective, discriminator: Network, poses: jax.Array, key: jax.Array, *, train: bool
) -> jax.Array:
    network, compute = objective.spec.discriminator, objective.compute
    logits, _ = apply(network, discriminator.variables, key, poses, train=train, compute=compute)
    return adversarial.gan_generator(logits, kind=objective.gan)


def _update_discriminator(
    objective: Objective, network: Network, rate: jax.Array, real: jax.Array, fake: jax.Array, key: jax.Array
) -> tuple[Network, Metrics]:
    real_key, fake_key = jax.random.split(key)
    logits = functools.partial(apply, objective.spec.discriminator, train=True, compute=objective.compute)

    def loss(params):
        variables = network.variables | {"params": params}
        real_logits, batch_stats = logits(variables, real_key, real)
        fake_logits, batch_stats = logits(variables | {"batch_stats": batch_stats}, fake_key, fake)
        return adversarial.gan_discriminator(real_logits, fake_logits, kind=objective.gan), batch_stats

    (value, batch_stats), gradient = jax.value_and_grad(loss, has_aux=True)(network.params)
    updated = _update(network, gradient, objective.optimizer, rate).replace(batch_stats=batch_stats)
    return updated, {"loss/discriminator": value, "grad_norm/discriminator": optax.tree.norm(gradient)}


def _update(network: Network, gradient: Any, optimizer: optax.GradientTransformation, rate: jax.Array) -> Network:
    updates, opt_state = optimizer.update(gradient, network.opt_state, network.params)
    params = optax.apply_updates(network.params, optax.tree.scale(rate, updates))
    return network.replace(params=params, opt_state=opt_state)


def _move_average(objective: Objective, state: TrainState, generator: Network) -> Any:
    if state.average is None:
        return None
    kept = jnp.minimum(objective.average_decay, (1 + state.step) / (10 + state.step))
    return jax.tree.map(lambda old, new: kept * old + (1 - kept) * new, state.average, generator.variables)

"""The terms of an objective, their weighted sum, and its gradient with respect to the outputs of the generator."""

from typing import Any

import jax
import jax.numpy as jnp
import optax

from ha2g_jax.checkpoint.state import Network
from ha2g_jax.methods import adversarial
from ha2g_jax.methods.build import method_of
from ha2g_jax.methods.forward import discriminate
from ha2g_jax.train.objective import Objective

Metrics = dict[str, jax.Array]

_MIN_NORM = 1e-12  # least norm of a gradient that another is divided by


def loss_terms(
    objective: Objective,
    discriminator: Network | None,
    outputs: Any,
    aux: Any,
    targets: jax.Array,
    key: jax.Array,
    *,
    train: bool,
) -> dict[str, jax.Array]:
    """Return the unweighted terms of the method's objective, the adversarial one included where it has one.

    Args:
        objective: static.
        discriminator: network of the adversarial loss, None for a method without one.
        outputs, aux: results of `run_generator` or of `Method.run`.
        targets: (B, N, pose_dim) true poses, mean-subtracted.
        key: key of the dropout of the discriminator.
        train: whether the discriminator runs in training mode.

    Returns:
        A () term for each name in `objective.weights`.
    """
    terms = _own_terms(objective, outputs, aux, targets)
    if discriminator is not None:
        terms["gan"] = _gan_term(objective, discriminator, outputs.poses[-1], key, train=train)
    return terms


def output_gradient(
    objective: Objective,
    discriminator: Network | None,
    outputs: Any,
    aux: Any,
    targets: jax.Array,
    key: jax.Array,
    is_warm: jax.Array,
) -> tuple[Any, Metrics]:
    """Return the gradient of the objective with respect to the outputs of the generator, and the metrics of its terms.

    The gradient of the GAN term is taken by itself, so that its norm can be compared with that of the reconstruction.

    Args:
        objective, discriminator, outputs, aux, targets, key: as in `loss_terms`, in training mode.
        is_warm: () bool, whether the warm-up is over, so that the GAN term counts.

    Returns:
        The gradient, as `outputs`, and the metrics "loss/<term>", "loss/total" and, with a discriminator,
        "gradient_ratio/gan" of `train_step`.
    """
    weights = dict(objective.weights)
    name = method_of(objective.spec).reconstruction_term

    def own_total(outputs: Any) -> tuple[jax.Array, Metrics]:
        terms = _own_terms(objective, outputs, aux, targets)
        return total(objective, terms), terms

    (whole, terms), gradient = jax.value_and_grad(own_total, has_aux=True)(outputs)
    ratios = {}
    if discriminator is not None:
        *coarse, poses = outputs.poses
        weight = jnp.where(is_warm, weights["gan"], 0.0)
        terms["gan"], pull = jax.value_and_grad(_gan_term, argnums=2)(objective, discriminator, poses, key, train=True)

        def reconstruction(poses: jax.Array) -> jax.Array:
            return _own_terms(objective, outputs._replace(poses=(*coarse, poses)), aux, targets)[name]

        norm = weights[name] * optax.tree.norm(jax.grad(reconstruction)(poses))
        ratios["gradient_ratio/gan"] = weight * optax.tree.norm(pull) / jnp.maximum(norm, _MIN_NORM)
        whole += weight * terms["gan"]
        gradient = gradient._replace(poses=(*gradient.poses[:-1], gradient.poses[-1] + weight * pull))
    return gradient, {f"loss/{name}": term for name, term in terms.items()} | {"loss/total": whole} | ratios


def total(objective: Objective, terms: Metrics) -> jax.Array:
    """Return the weighted sum of terms, each by its name in `objective.weights`."""
    weights = dict(objective.weights)
    return sum((weights[name] * term for name, term in terms.items()), jnp.zeros(()))


def _own_terms(objective: Objective, outputs: Any, aux: Any, targets: jax.Array) -> Metrics:
    terms = method_of(objective.spec).terms(objective.spec, objective.settings, outputs, aux, targets)
    if odd := sorted(terms.keys() ^ (dict(objective.weights).keys() - {"gan"})):
        raise ValueError(f"`terms` of {objective.spec.method} and its `term_names` differ in {', '.join(odd)}")
    return terms


def _gan_term(
    objective: Objective, discriminator: Network, poses: jax.Array, key: jax.Array, *, train: bool
) -> jax.Array:
    variables, compute = discriminator.variables, objective.compute
    logits, _ = discriminate(objective.spec, variables, poses, key, train=train, compute=compute)
    return adversarial.gan_generator(logits, kind=objective.gan)

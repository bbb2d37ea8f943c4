"""One training step: the generator runs forward once, its output trains both networks.

The output, detached, first feeds the update of the discriminator. Then the gradient of the objective with
respect to the output is taken through the updated discriminator and pulled back through the generator. This
equals the alternation of two separate updates with the same dropout keys at half the forward cost.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn

from ha2g_jax import losses
from ha2g_jax.skeleton import joint_angles
from ha2g_jax.train.state import Network, TrainState
from ha2g_jax.train.task import Task, restore, split_levels, subtract_mean

Batch = dict[str, jax.Array]
Metrics = dict[str, jax.Array]


class Outputs(NamedTuple):
    """What the objective is differentiated by.

    Attributes:
        poses: H arrays (B, N, d^h), mean-subtracted.
        features: low, mid and high audio features, each (B, N, 32).
        text: (B, N, 32) text features.
        mean, log_variance: (B, 18) of the identity.
    """

    poses: tuple[jax.Array, ...]
    features: tuple[jax.Array, jax.Array, jax.Array]
    text: jax.Array
    mean: jax.Array
    log_variance: jax.Array


class Contrast(NamedTuple):
    """The same speech with another identity of the batch; no gradient flows through it.

    Attributes:
        poses: (B, N, pose_dim) of the last level.
        f_id: (B, 18) identity of `Outputs.poses`.
        other_f_id: (B, 18) identity of `poses`.
    """

    poses: jax.Array
    f_id: jax.Array
    other_f_id: jax.Array


def train_step(task: Task, state: TrainState, batch: Batch, key: jax.Array) -> tuple[TrainState, Metrics]:
    """Updates the discriminator, then the generator.

    BatchNorm: the generator's statistics take in this batch once. The discriminator's take in the real and
    then the generated poses of its own update; the pass that carries the generator's gradient normalises by
    its batch like them but leaves no trace. During warm-up (`task.warmup_steps`) the GAN term has weight 0
    and the discriminator stays as it is.

    Args:
        task: static.
        state: before the step.
        batch: "mel" (B, 128, 70), "words" (B, N), "directions" (B, N, bones, 3) and "speaker" (B,) or
            "frames" (B, M, S, S, 3).
        key: of the run; the step number is folded in.

    Returns:
        The state after the step, and scalars: "loss/<term>" (unweighted), "loss/total" (weighted),
        "loss/discriminator", "grad_norm/generator", "grad_norm/discriminator".
    """
    keys = step_keys(key, state.step)
    targets = subtract_mean(task, batch["directions"])
    is_warm = state.step >= task.warmup_steps

    outputs, pull_back, (generator_stats, contrast) = jax.vjp(
        lambda params: generate(task, state.generator.replace(params=params), batch, keys),
        state.generator.params,
        has_aux=True,
    )

    discriminator, discriminator_metrics = _update_discriminator(
        task, state.discriminator, targets, jax.lax.stop_gradient(outputs.poses[-1]), keys["discriminator"]
    )
    discriminator = jax.tree.map(lambda new, old: jnp.where(is_warm, new, old), discriminator, state.discriminator)

    def objective(outputs):
        fake_logits, _ = discriminate(task, discriminator, outputs.poses[-1], keys["gan"])
        terms = loss_terms(task, outputs, contrast, fake_logits, targets)
        return _total(task, terms, is_warm), terms

    (total, terms), cotangent = jax.value_and_grad(objective, has_aux=True)(outputs)
    (gradient,) = pull_back(cotangent)
    generator = _update(state.generator, gradient, task.generator_optimizer).replace(batch_stats=generator_stats)

    metrics = {f"loss/{name}": term for name, term in terms.items()}
    metrics |= {"loss/total": total, "grad_norm/generator": optax.tree.norm(gradient)} | discriminator_metrics
    return TrainState(state.step + 1, generator, discriminator), metrics


def validation_step(task: Task, state: TrainState, batch: Batch, key: jax.Array) -> Metrics:
    """The terms of the objective in evaluation mode, with the mean identity instead of a sample.

    Args:
        task, state, batch: as in `train_step`.
        key: permutes the identities of the style term.

    Returns:
        "loss/<term>" and "loss/total", the latter with all weights at once.
    """
    keys = step_keys(key, state.step)
    targets = subtract_mean(task, batch["directions"])
    outputs, (_, contrast) = generate(task, state.generator, batch, keys, train=False)
    fake_logits, _ = discriminate(task, state.discriminator, outputs.poses[-1], keys["gan"], train=False)
    terms = loss_terms(task, outputs, contrast, fake_logits, targets)
    return {f"loss/{name}": term for name, term in terms.items()} | {"loss/total": _total(task, terms, True)}


def step_keys(key: jax.Array, step: jax.Array) -> dict[str, jax.Array]:
    """The keys of one step, one for each use of chance."""
    uses = ("dropout", "identity", "permutation", "discriminator", "gan")
    return dict(zip(uses, jax.random.split(jax.random.fold_in(key, step), len(uses)), strict=True))


def generate(
    task: Task, network: Network, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Outputs, tuple[Any, Contrast]]:
    """The generator on one batch, for its own identities and, in the same run, for a permutation of them.

    Audio, text and identity are encoded once. The two identities of a clip lie side by side on the batch axis
    of the pose inferer, so that a batch split over devices stays where it is.

    Returns:
        The outputs, and (batch statistics after the run, the run with the other identities).
    """
    num_clips = batch["mel"].shape[0]
    poses = subtract_mean(task, batch["directions"])
    seed = poses[:, : task.num_seed_frames]

    def run(model):
        features = model.encode_audio(batch["mel"], train=train)
        text = model.encode_text(batch["words"], train=train)
        mean, log_variance = model.encode_identity(batch[task.identity_input], train=train)
        f_id = mean
        if train:
            f_id = mean + jnp.exp(0.5 * log_variance) * jax.random.normal(keys["identity"], mean.shape)
        # A turn of the batch: a permutation in which no clip, unless alone, keeps its own identity.
        turn = jax.random.randint(keys["permutation"], (), 1, max(num_clips, 2))
        other_f_id = jax.lax.stop_gradient(jnp.roll(f_id, turn, axis=0))
        both = jnp.stack([f_id, other_f_id], axis=1).reshape(2 * num_clips, -1)
        twice = [jnp.repeat(array, 2, axis=0) for array in (*features, seed)]
        levels = model.infer(tuple(twice[:3]), both, twice[3], train=train)
        pairs = [level.reshape(num_clips, 2, *level.shape[1:]) for level in levels]
        outputs = Outputs(tuple(pair[:, 0] for pair in pairs), tuple(features), text, mean, log_variance)
        return outputs, Contrast(pairs[-1][:, 1], f_id, other_f_id)

    (outputs, contrast), batch_stats = _apply(task.generator, network, keys["dropout"], train, method=run)
    return outputs, (batch_stats, contrast)


def discriminate(
    task: Task, network: Network, poses: jax.Array, key: jax.Array, *, train: bool = True
) -> tuple[jax.Array, Any]:
    """Logits (B,) of poses (B, N, pose_dim), and the batch statistics after this pass."""
    return _apply(task.discriminator, network, key, train, poses, train=train)


def loss_terms(
    task: Task, outputs: Outputs, contrast: Contrast, fake_logits: jax.Array, targets: jax.Array
) -> dict[str, jax.Array]:
    """The unweighted terms of Eq. 9; `targets` are (B, N, pose_dim), mean-subtracted."""
    skeleton, settings = task.skeleton, task.losses
    angles = joint_angles(skeleton, restore(task, outputs.poses[-1])) / jnp.pi
    return {
        "gan": losses.gan_generator(fake_logits, kind=settings.gan),
        "huber": losses.huber(outputs.poses, split_levels(task, targets), settings.huber_delta),
        "physical": losses.physical(angles, jnp.asarray(skeleton.angle_mean), jnp.asarray(skeleton.angle_variance)),
        "style": losses.style(outputs.poses[-1], *contrast, delta=settings.huber_delta, clip=settings.style_clip),
        "kld": losses.kld(outputs.mean, outputs.log_variance),
        "contrastive": losses.contrastive(outputs.text, *outputs.features, temperature=settings.temperature),
    }


def _apply(
    module: nn.Module, network: Network, key: jax.Array, update: bool, *args: Any, **kwargs: Any
) -> tuple[Any, Any]:
    """Result and batch statistics; those of `network` unless they are to `update`."""
    mutable = ["batch_stats"] if update else []
    result, updates = module.apply(network.variables, *args, mutable=mutable, rngs={"dropout": key}, **kwargs)
    return result, updates.get("batch_stats", network.batch_stats)


def _total(task: Task, terms: dict[str, jax.Array], is_warm: jax.Array | bool) -> jax.Array:
    weights: dict[str, float | jax.Array] = dict(task.losses.weights)
    assert weights.keys() == terms.keys()
    weights["gan"] = jnp.where(is_warm, weights["gan"], 0.0)
    return sum((weights[name] * term for name, term in terms.items()), jnp.zeros(()))


def _update_discriminator(
    task: Task, network: Network, real: jax.Array, fake: jax.Array, key: jax.Array
) -> tuple[Network, Metrics]:
    real_key, fake_key = jax.random.split(key)

    def objective(params):
        real_logits, batch_stats = discriminate(task, network.replace(params=params), real, real_key)
        after_real = network.replace(params=params, batch_stats=batch_stats)
        fake_logits, batch_stats = discriminate(task, after_real, fake, fake_key)
        return losses.gan_discriminator(real_logits, fake_logits), batch_stats

    (loss, batch_stats), gradient = jax.value_and_grad(objective, has_aux=True)(network.params)
    updated = _update(network, gradient, task.discriminator_optimizer).replace(batch_stats=batch_stats)
    return updated, {"loss/discriminator": loss, "grad_norm/discriminator": optax.tree.norm(gradient)}


def _update(network: Network, gradient: Any, optimizer: optax.GradientTransformation) -> Network:
    updates, opt_state = optimizer.update(gradient, network.opt_state, network.params)
    return network.replace(params=optax.apply_updates(network.params, updates), opt_state=opt_state)

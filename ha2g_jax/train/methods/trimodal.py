"""Trimodal (Yoon et al. 2020): speech, words and speaker to poses, with an adversary and a style that diverges."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ha2g_jax import losses, models
from ha2g_jax.config import Config
from ha2g_jax.losses.trimodal import kld, style
from ha2g_jax.models.baselines.trimodal import Trimodal
from ha2g_jax.models.baselines.waveform import WaveformEncoder
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.choices import choice
from ha2g_jax.train.forward import Batch, Variables, apply
from ha2g_jax.train.methods.encoders import speaker_table, text_encoder
from ha2g_jax.train.task import Method, Networks, Task, subtract_mean

TERMS = ("gan", "huber", "style", "kld")


class Outputs(NamedTuple):
    """What the objective is differentiated by.

    Attributes:
        poses: one level, (B, N, pose_dim), mean-subtracted.
        mean, log_variance: (B, 16) of the style.
    """

    poses: tuple[jax.Array]
    mean: jax.Array
    log_variance: jax.Array


class Contrast(NamedTuple):
    """The same speech in the style of another speaker of the batch; no gradient flows through it.

    Attributes:
        poses: (B, N, pose_dim).
        z: (B, 16) style of `Outputs.poses`.
        other_z: (B, 16) style of `poses`.
    """

    poses: jax.Array
    z: jax.Array
    other_z: jax.Array


def inputs(config: Config) -> tuple[str, ...]:
    """What a training example has of the speech."""
    del config
    return Trimodal.inputs


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Networks:
    """The networks of `config.model`; the discriminator is HA2G's with more layers.

    Raises:
        UserError: an unknown choice.
    """
    choice("model.identity.kind", config.model.identity.kind, ("speakers",))
    inferer, discriminator = config.model.inferer, config.model.discriminator
    generator = Trimodal(
        audio=WaveformEncoder(feature_dim=config.model.audio.feature_dim),
        text=text_encoder(config, vocabulary_size),
        identity=speaker_table(config, num_speakers, has_hidden=True),
        pose_dim=skeleton.pose_dim,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )
    return Networks(generator, models.Discriminator(hidden_dim=discriminator.hidden_dim, layers=discriminator.layers))


def run(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Outputs, tuple[Any, Contrast]]:
    """The generator on one batch, for its own speakers and, in the same run, for a permutation of them.

    Each of the two has its own sample of the style, so that they differ even where a speaker stays in place.

    Args:
        task: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: as in `train_step`.
        keys: "dropout", "identity" and "permutation".
        train: False is evaluation mode, with the mean of each style instead of a sample.

    Returns:
        The outputs, and (batch statistics after the run, the run with the other styles).
    """
    speech = {name: batch[name] for name in task.inputs}
    (heard, (mean, log_variance)), batch_stats = apply(
        task, task.generator, variables, keys["dropout"], speech, batch["speaker"], train=train, method=_encode
    )
    order = jax.random.permutation(keys["permutation"], len(mean))
    z, other_z = mean, mean[order]
    if train:
        noise = jax.random.normal(keys["identity"], (2, *mean.shape))
        deviation = jnp.exp(0.5 * log_variance)
        z, other_z = z + deviation * noise[0], other_z + deviation[order] * noise[1]
    other_z = jax.lax.stop_gradient(other_z)

    # The two of a clip lie side by side on the batch axis, so that a batch split over devices stays where it is.
    seed = subtract_mean(task, batch["directions"])[:, : task.num_seed_frames]
    styles = jnp.stack([z, other_z], axis=1).reshape(2 * len(z), -1)
    twice = jnp.repeat(heard, 2, axis=0), styles, jnp.repeat(seed, 2, axis=0)
    (poses,), _ = apply(task, task.generator, variables, keys["dropout"], *twice, train=train, method="infer")
    pairs = poses.reshape(len(z), 2, *poses.shape[1:])
    return Outputs((pairs[:, 0],), mean, log_variance), (batch_stats, Contrast(pairs[:, 1], z, other_z))


def _encode(model: Trimodal, speech: dict[str, jax.Array], speaker: jax.Array, *, train: bool) -> Any:
    return model.listen(speech, train=train), model.encode_identity(speaker, train=train)


def loss_terms(task: Task, outputs: Outputs, contrast: Contrast, targets: jax.Array) -> dict[str, jax.Array]:
    """The unweighted terms but the adversarial one; `targets` are (B, N, pose_dim), mean-subtracted."""
    (poses,), settings = outputs.poses, task.losses
    return {
        "huber": losses.huber((poses,), (targets,), settings.huber_delta),
        "style": style(poses, *contrast, clip=settings.style_clip),
        "kld": kld(outputs.mean, outputs.log_variance),
    }


METHOD = Method(terms=TERMS, inputs=inputs, build=build, run=run, loss_terms=loss_terms)

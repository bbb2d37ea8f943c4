"""Joint Embedding (Ahuja and Morency 2019): speech and poses take turns at one decoder."""

from typing import Any

import jax
import jax.numpy as jnp

from ha2g_jax.config import Config
from ha2g_jax.losses.joint_embedding import l1
from ha2g_jax.models.baselines.joint_embedding import JointEmbedding, sample
from ha2g_jax.models.baselines.waveform import WaveformEncoder
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.choices import choice
from ha2g_jax.train.forward import Batch, Poses, Variables, apply
from ha2g_jax.train.methods.encoders import text_encoder
from ha2g_jax.train.task import Method, Networks, Task, subtract_mean

TERMS = ("l1",)


def inputs(config: Config) -> tuple[str, ...]:
    """What a training example has of the speech."""
    del config
    return JointEmbedding.inputs


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Networks:
    """The networks of `config.model`.

    Raises:
        UserError: an unknown choice.
    """
    del num_speakers
    choice("model.identity.kind", config.model.identity.kind, ("none",))
    context, inferer = config.model.context, config.model.inferer
    generator = JointEmbedding(
        audio=WaveformEncoder(feature_dim=config.model.audio.feature_dim),
        text=text_encoder(config, vocabulary_size),
        pose_dim=skeleton.pose_dim,
        num_frames=config.data.num_frames,
        context_dim=context.hidden_dim,
        context_layers=context.layers,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )
    return Networks(generator, None)


def run(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Poses, tuple[Any, None]]:
    """The poses of the latent of the speech or, in training, by the toss of a fair coin, of the true poses.

    There is one toss a batch. Both encoders run, so that both have the statistics of every batch. The latent of the
    speech is always a sample, in evaluation too, that of the poses never.

    Args:
        task: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: as in `train_step`.
        keys: "dropout", "identity" for the sample and "permutation" for the coin.
        train: False is evaluation mode, with the latent of the speech.

    Returns:
        The outputs, and (batch statistics after the run, None).
    """
    speech = {name: batch[name] for name in task.inputs}
    poses = subtract_mean(task, batch["directions"])
    seed = poses[:, : task.num_seed_frames]
    noise = jax.random.normal(keys["identity"], (len(poses), task.generator.latent_dim))
    from_speech = jax.random.bernoulli(keys["permutation"]) if train else jnp.ones((), bool)
    clips = (speech, poses, seed, noise, from_speech)
    decoded, batch_stats = apply(
        task, task.generator, variables, keys["dropout"], *clips, train=train, method=_encode_and_decode
    )
    return Poses((decoded,)), (batch_stats, None)


def _encode_and_decode(
    model: JointEmbedding,
    speech: dict[str, jax.Array],
    poses: jax.Array,
    seed: jax.Array,
    noise: jax.Array,
    from_speech: jax.Array,
    *,
    train: bool,
) -> jax.Array:
    latent, _ = model.encode_pose(poses, train=train)
    latent = jnp.where(from_speech, sample(model.listen(speech, train=train), noise), latent)
    return model.decode(latent, seed, train=train)


def loss_terms(task: Task, outputs: Poses, aux: None, targets: jax.Array) -> dict[str, jax.Array]:
    """The one term; `targets` are (B, N, pose_dim), mean-subtracted."""
    del task, aux
    return {"l1": l1(outputs.poses[-1], targets)}


METHOD = Method(terms=TERMS, inputs=inputs, build=build, run=run, loss_terms=loss_terms)

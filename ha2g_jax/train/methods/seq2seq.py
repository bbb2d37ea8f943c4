"""Attention Seq2Seq (Yoon et al., ICRA 2019): the words of a window to poses, without sound."""

from typing import Any, NamedTuple

import jax

from ha2g_jax.config import Config
from ha2g_jax.losses.seq2seq import continuity, mse, variance
from ha2g_jax.models.baselines.seq2seq import Seq2Seq
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.choices import choice
from ha2g_jax.train.forward import Batch, Variables, apply
from ha2g_jax.train.task import Method, Networks, Task, speech_arguments

TERMS = ("mse", "continuity", "variance")
# The marks of a sentence's start and end, which follow the words of the vocabulary.
_NUM_MARKS = 2


class Outputs(NamedTuple):
    """What the objective is differentiated by: one level of poses (B, N, pose_dim), mean-subtracted."""

    poses: tuple[jax.Array]


def inputs(config: Config) -> tuple[str, ...]:
    """What a training example has of the speech."""
    del config
    return Seq2Seq.inputs


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Networks:
    """The network of `config.model`; there is no discriminator.

    Raises:
        UserError: an unknown choice.
    """
    del num_speakers
    choice("model.identity.kind", config.model.identity.kind, ("none",))
    inferer = config.model.inferer
    generator = Seq2Seq(
        num_words=vocabulary_size + _NUM_MARKS,
        pose_dim=skeleton.pose_dim,
        num_frames=config.data.num_frames,
        embedding_dim=config.model.text.embedding_dim,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )
    return Networks(generator, None)


def run(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Outputs, tuple[Any, None]]:
    """The roll-out on one batch, which takes the true poses of the seed and no later ones, in training too.

    Args:
        task: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: as in `train_step`.
        keys: "dropout".
        train: False is evaluation mode.

    Returns:
        The outputs, and (batch statistics after the run, None).
    """
    arguments = speech_arguments(task, batch)
    poses, batch_stats = apply(task, task.generator, variables, keys["dropout"], *arguments, train=train)
    return Outputs(poses), (batch_stats, None)


def loss_terms(task: Task, outputs: Outputs, aux: None, targets: jax.Array) -> dict[str, jax.Array]:
    """The unweighted terms; `targets` are (B, N, pose_dim), mean-subtracted."""
    del task, aux
    (poses,) = outputs.poses
    return {"mse": mse(poses, targets), "continuity": continuity(poses), "variance": variance(poses)}


METHOD = Method(terms=TERMS, inputs=inputs, build=build, run=run, loss_terms=loss_terms)

"""Attention Seq2Seq (Yoon et al., ICRA 2019): the words of a window to poses, without sound.

In the published comparison a cubic per channel replaced the first 12 frames of each window of a long recording. Here
the borders of all methods are treated alike, see `motion.windows`.
"""

import jax

from ha2g_jax.config import Config
from ha2g_jax.losses.seq2seq import continuity, mse, variance
from ha2g_jax.models.baselines.seq2seq import Seq2Seq
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.choices import choice
from ha2g_jax.train.forward import Poses, run_generator
from ha2g_jax.train.task import Method, Networks, Task

TERMS = ("mse", "continuity", "variance")
# The marks of a sentence's start and end, which follow the words of the vocabulary.
_NUM_MARKS = 2


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


def loss_terms(task: Task, outputs: Poses, aux: None, targets: jax.Array) -> dict[str, jax.Array]:
    """The unweighted terms; `targets` are (B, N, pose_dim), mean-subtracted."""
    del task, aux
    (poses,) = outputs.poses
    return {"mse": mse(poses, targets), "continuity": continuity(poses), "variance": variance(poses)}


METHOD = Method(terms=TERMS, inputs=inputs, build=build, run=run_generator, loss_terms=loss_terms)

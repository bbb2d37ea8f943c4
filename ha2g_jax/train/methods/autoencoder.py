"""The pose auto-encoder of the Frechet gesture distance (HA2G, Table 9), trained like any other method.

The paper says nothing of its training. Ours: mean L1 of the poses and of their velocities, and a small cosine term,
between restored vectors, as angles are everywhere here; selected on the validation split.
"""

from typing import Any

import jax

from ha2g_jax import models
from ha2g_jax.config import Config
from ha2g_jax.losses import autoencoder as losses
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.forward import Batch, Poses, Variables, apply
from ha2g_jax.train.task import Method, Networks, Task, restore, subtract_mean


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Networks:
    """The auto-encoder of a skeleton; it has no settings, as values of different ones cannot be compared."""
    del config, vocabulary_size, num_speakers
    return Networks(models.PoseAutoencoder(skeleton.pose_dim, models.LATENT_DIMS[skeleton.name]), None)


def run(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool
) -> tuple[Poses, tuple[Any, None]]:
    """The windows of a batch through the auto-encoder."""
    poses = subtract_mean(task, batch["directions"])
    poses, batch_stats = apply(task, task.generator, variables, keys["dropout"], poses, train=train)
    return Poses((poses,)), (batch_stats, None)


def loss_terms(task: Task, outputs: Poses, aux: None, targets: jax.Array) -> dict[str, jax.Array]:
    """The unweighted terms; `targets` are (B, 34, pose_dim), mean-subtracted."""
    del aux
    (poses,) = outputs.poses
    return {
        "reconstruction": losses.reconstruction(poses, targets),
        "velocity": losses.velocity(poses, targets),
        "cosine": losses.cosine(restore(task, poses), restore(task, targets)),
    }


METHOD = Method(
    terms=("reconstruction", "velocity", "cosine"),
    inputs=lambda config: (),
    build=build,
    run=run,
    loss_terms=loss_terms,
    arguments=lambda task, batch: (subtract_mean(task, batch["directions"]),),
)

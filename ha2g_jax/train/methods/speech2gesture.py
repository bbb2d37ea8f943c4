"""Speech2Gesture (Ginosar et al., CVPR 2019): a spectrogram to poses, with a discriminator of motion.

`LEGACY` is the method as the authors of HA2G compared with it: frequency lies where time belongs, and the
discriminator sees differences of differences.
"""

import functools

import jax

from ha2g_jax.config import Config
from ha2g_jax.losses.speech2gesture import l1
from ha2g_jax.models.baselines.speech2gesture import PatchDiscriminator, Speech2Gesture
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.choices import choice
from ha2g_jax.train.forward import Poses, run_generator
from ha2g_jax.train.task import Method, Networks, Task

TERMS = ("gan", "l1")


def inputs(config: Config) -> tuple[str, ...]:
    """What a training example has of the speech."""
    del config
    return Speech2Gesture.inputs


def build(
    config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int, *, legacy: bool = False
) -> Networks:
    """The networks of `config.model`; `legacy` ones have as many parameters, but other inputs.

    Raises:
        UserError: an unknown choice.
    """
    del vocabulary_size, num_speakers
    choice("model.identity.kind", config.model.identity.kind, ("none",))
    generator = Speech2Gesture(
        pose_dim=skeleton.pose_dim,
        num_frames=config.data.num_frames,
        audio_channels=tuple(config.model.audio.channels),
        channels=config.model.inferer.hidden_dim,
        downs=config.model.inferer.layers,
        swapped_axes=legacy,
    )
    channels = config.model.discriminator.hidden_dim
    return Networks(generator, PatchDiscriminator(channels, differences=2 if legacy else 1))


def loss_terms(task: Task, outputs: Poses, aux: None, targets: jax.Array) -> dict[str, jax.Array]:
    """The terms but the adversarial one; `targets` are (B, N, pose_dim), mean-subtracted."""
    del task, aux
    return {"l1": l1(outputs.poses[-1], targets)}


METHOD = Method(terms=TERMS, inputs=inputs, build=build, run=run_generator, loss_terms=loss_terms)
LEGACY = METHOD._replace(build=functools.partial(build, legacy=True))

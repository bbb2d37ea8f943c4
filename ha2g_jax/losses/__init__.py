"""The terms of the objectives, each unweighted: arrays in, one scalar out; a file for each method that has its own."""

from ha2g_jax.losses.adversarial import GAN_KINDS, gan_discriminator, gan_generator
from ha2g_jax.losses.ha2g import AUDIO_LEVELS, contrastive, huber, kld, physical, style

__all__ = [
    "AUDIO_LEVELS",
    "GAN_KINDS",
    "contrastive",
    "gan_discriminator",
    "gan_generator",
    "huber",
    "kld",
    "physical",
    "style",
]

"""Joint Embedding (Ahuja and Morency 2019), a baseline of Table 1: speech and poses in one latent space.

DATA is one of talk, ted_expressive, ted_gesture, bvh and video; a size may follow, as in talk:small.

ha2g train --config joint_embedding:DATA --workdir runs/joint [--config.data.path=CORPUS]
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(data: str = "talk") -> Config:
    return presets.parse(data, "joint_embedding")

"""The pose auto-encoder (Table 9) that the Frechet gesture distance is measured with.

DATA is one of talk, ted_expressive, ted_gesture, bvh and video; a size may follow, as in talk:small.

ha2g train --config autoencoder:DATA --workdir runs/autoencoder [--config.data.path=CORPUS]
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(data: str = "talk") -> Config:
    return presets.parse(data, "autoencoder")

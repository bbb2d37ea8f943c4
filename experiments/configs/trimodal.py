"""Trimodal (Yoon et al. 2020), a baseline of Table 1: audio, words and the speaker to poses.

DATA is one of talk, ted_expressive, ted_gesture, bvh and video; a size may follow, as in talk:small.

ha2g train --config trimodal:DATA --workdir runs/trimodal [--config.data.path=CORPUS]
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(data: str = "talk") -> Config:
    return presets.parse(data, "trimodal")

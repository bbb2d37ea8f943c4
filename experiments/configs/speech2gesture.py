"""Speech2Gesture (Ginosar et al. 2019), a baseline of Table 1: a spectrogram to poses, by convolutions.

DATA is one of talk, ted_expressive, ted_gesture, bvh and video; a size may follow, as in talk:small.

ha2g train --config speech2gesture:DATA --workdir runs/speech2gesture [--config.data.path=CORPUS]
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(data: str = "talk") -> Config:
    return presets.parse(data, "speech2gesture")

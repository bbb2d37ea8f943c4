"""HA2G on motion capture with fingers: a folder made by ha2g data import-bvh or import-smplx.

ha2g data import-bvh RECORDINGS corpora/mocap && ha2g data split corpora/mocap corpora/mocap_split
ha2g train --config bvh --workdir runs/mocap --config.data.path=corpora/mocap_split
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(size: str = "paper") -> Config:
    return presets.make("bvh", size)

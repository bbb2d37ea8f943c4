"""HA2G on Talk with the last stage of the pose inferer alone: a config of runs whose subject is not the network.

Half as long to trace and to compile as the preset talk, with images and a discriminator all the same.
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(size: str) -> Config:
    """Return the config at `size`."""
    return presets.make("talk", size, changes={"model.inferer.levels": (6,)})

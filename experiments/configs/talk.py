"""HA2G on the Talk corpus, which is made on first use.

ha2g train --config talk:small --workdir runs/talk
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(size: str = "paper") -> Config:
    return presets.make("talk", size)

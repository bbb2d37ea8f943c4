"""HA2G on the Talk corpus, which is made on first use.

ha2g train --config experiments/configs/talk.py:small --workdir runs/talk
"""

from ha2g_jax import config as configs


def get_config(size: str = "paper"):
    config = configs.SIZES[size or "paper"](configs.paper("ted_expressive"))
    config.data.path = "talk"
    return config

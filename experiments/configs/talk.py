"""A config of your own: HA2G on the Talk corpus, as the preset talk:SIZE; copy the file and change settings.

ha2g train --config experiments/configs/talk.py:small --workdir runs/talk

`ha2g train --help` lists all settings. The kinds of data, methods and rows of tables are in `ha2g_jax.config.presets`.
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(size: str = "paper") -> Config:
    changes = {
        # "train.steps": 20_000,
        # "loss.ha2g.weights.physical": 0.1,
    }
    return presets.make("talk", size, method="ha2g", changes=changes)

"""HA2G on TED-Expressive (43 joints, six levels), as in the paper.

ha2g data import-ted LMDB corpora/ted  # the folder that holds train, val and test, or lmdb_train, ...
ha2g train --config ted_expressive --workdir runs/ted --config.data.path=corpora/ted
"""

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config


def get_config(size: str = "paper") -> Config:
    return presets.make("ted_expressive", size)

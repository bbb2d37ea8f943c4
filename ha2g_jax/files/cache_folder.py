"""Cache folder of things that are made once: the Talk corpus, the environment of the pose estimator."""

import os
import pathlib


def cache_folder() -> pathlib.Path:
    """Return $HA2G_CACHE, by default ~/.cache/ha2g-jax; the folder may not exist."""
    cache = os.environ.get("HA2G_CACHE")
    return pathlib.Path(cache) if cache else pathlib.Path.home() / ".cache" / "ha2g-jax"

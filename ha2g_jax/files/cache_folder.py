"""Cache folder of things that are made once: the Talk corpus, the environment of the pose estimator."""

import os
import pathlib


def cache_folder() -> pathlib.Path:
    """Return $HA2G_CACHE, or else $XDG_CACHE_HOME/ha2g-jax, or else ~/.cache/ha2g-jax; the folder may not exist."""
    if cache := os.environ.get("HA2G_CACHE"):
        return pathlib.Path(cache)
    shared = pathlib.Path(os.environ.get("XDG_CACHE_HOME", ""))
    # The specification of XDG says that a path that is not absolute is ignored.
    return (shared if shared.is_absolute() else pathlib.Path.home() / ".cache") / "ha2g-jax"

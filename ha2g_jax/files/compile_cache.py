"""Cache of compiled programs, so that a command compiles nothing that an earlier command has compiled."""

import contextlib
import os

from ha2g_jax.errors import UserError
from ha2g_jax.files.cache_folder import cache_folder

MAX_BYTES = 2 << 30
_MIN_SECONDS = 0.3  # programs that compile faster are not worth a file


def keep_programs() -> None:
    """Let JAX keep compiled programs in the cache folder of this user; call this before JAX is imported.

    The programs that were not used for the longest time are deleted when all together take more than `MAX_BYTES`.
    Processes may use the folder at the same time. Nothing is kept if HA2G_COMPILE_CACHE is 0 or the folder cannot be
    written; JAX's own variable JAX_COMPILATION_CACHE_DIR takes precedence.
    """
    if os.environ.get("HA2G_COMPILE_CACHE") == "0" or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    with contextlib.suppress(OSError, UserError):  # a read-only home, or none
        folder = cache_folder() / "programs"
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
            os.environ["JAX_COMPILATION_CACHE_MAX_SIZE"] = str(MAX_BYTES)
            os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = str(_MIN_SECONDS)

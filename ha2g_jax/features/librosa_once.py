"""Import of parts of librosa by one process at a time."""

import contextlib
import functools
import importlib
import warnings
from typing import Any

import filelock

from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import cache_folder


@functools.cache
def librosa(part: str) -> Any:
    """Import one module of librosa, such as "filters" or "core.spectrum", and return it.

    When a module is first imported in an environment, numba compiles functions and caches them on disk, which takes
    nearly half a minute for "onset". Processes that do so at the same time, such as workers, can corrupt this cache,
    and then every process that calls these functions ends with a segmentation fault.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError, UserError):  # a read-only home, or none
            cache_folder().mkdir(parents=True, exist_ok=True)
            stack.enter_context(filelock.FileLock(cache_folder() / "librosa.lock"))
        with warnings.catch_warnings():
            # Its downloader, which nothing here calls, would ask for the progress bars of notebooks.
            warnings.filterwarnings("ignore", "IProgress not found")
            return importlib.import_module(f"librosa.{part}")

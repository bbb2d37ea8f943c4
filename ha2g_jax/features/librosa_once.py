"""Import of librosa by one process at a time."""

import contextlib
import functools
from typing import Any

import filelock

from ha2g_jax.files.cache_folder import cache_folder


@functools.cache
def librosa() -> Any:
    """Import librosa with all submodules that this package uses, and return the module.

    When librosa is first imported in an environment, numba compiles functions and caches them on disk. Processes that
    do so at the same time, such as workers, can corrupt this cache, and then every process that calls these functions
    ends with a segmentation fault.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # the cache folder is not writable, such as a read-only home
            cache_folder().mkdir(parents=True, exist_ok=True)
            stack.enter_context(filelock.FileLock(cache_folder() / "librosa.lock"))
        import librosa
        import librosa.onset

        return librosa

"""librosa, whose parts are imported by one process at a time."""

import contextlib
import functools
from typing import Any

import filelock

from ha2g_jax.files.cache_folder import cache_folder


@functools.cache
def librosa() -> Any:
    """The module librosa, with all that this package uses of it.

    librosa has numba compile functions when its parts are first imported in an environment, and store them for the next
    time. Processes that do so at once, such as workers, can leave a store of mixed-up programs, and then every process
    that calls these is ended by a segmentation fault.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # no place to write: a home that is read-only
            cache_folder().mkdir(parents=True, exist_ok=True)
            stack.enter_context(filelock.FileLock(cache_folder() / "librosa.lock"))
        import librosa
        import librosa.onset

        return librosa

"""The cache folder, for things that are made once, such as the Talk corpus, and for programs that JAX has compiled."""

import contextlib
import os
import pathlib
import sys
from collections.abc import Iterator

import filelock

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown

_MAX_BYTES = 2 << 30
_MIN_SECONDS = 0.3  # programs that compile faster are not worth a file


def cache_folder() -> pathlib.Path:
    """Return $HA2G_CACHE, or else $XDG_CACHE_HOME/ha2g-jax, or else ~/.cache/ha2g-jax; the folder may not exist.

    Raises:
        UserError: no variable is set, and this user has no home folder.
    """
    if cache := os.environ.get("HA2G_CACHE"):
        return pathlib.Path(cache)
    shared = pathlib.Path(os.environ.get("XDG_CACHE_HOME", ""))
    if shared.is_absolute():  # the specification of XDG says that another path is ignored
        return shared / "ha2g-jax"
    try:
        return pathlib.Path.home() / ".cache" / "ha2g-jax"
    except RuntimeError as error:
        raise UserError("this user has no home folder; set HA2G_CACHE to a folder that can be written") from error


@contextlib.contextmanager
def one_maker(path: pathlib.Path) -> Iterator[None]:
    """Let one process at a time make a file or folder in the cache folder; others wait and say so.

    The lock, which ends with its process, is beside it.

    Raises:
        UserError: the cache folder cannot be written.
    """
    lock = filelock.FileLock(path.with_name(f"{path.name}.lock"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            sys.stderr.write(f"ha2g: another process makes {shown(path)}; waiting for it\n")
            lock.acquire()
    except OSError as error:
        raise UserError(
            f"cannot write {shown(path)} ({reason(error).lower()}); set HA2G_CACHE to another folder"
        ) from error
    try:
        yield
    finally:
        lock.release()


def keep_programs() -> None:
    """Let JAX keep compiled programs in the cache folder of this user; call this before JAX is imported.

    The least recently used programs are deleted when all together take more than `_MAX_BYTES`.
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
            os.environ["JAX_COMPILATION_CACHE_MAX_SIZE"] = str(_MAX_BYTES)
            os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = str(_MIN_SECONDS)

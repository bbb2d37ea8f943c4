"""Cache folder of things that are made once: the Talk corpus, the environment of the pose estimator."""

import contextlib
import os
import pathlib
import sys
from collections.abc import Iterator

import filelock

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown


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
    """Let one process at a time make something in the cache folder; another one waits and says so.

    Args:
        path: file or folder to make; the lock, which ends with its process, is beside it.

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

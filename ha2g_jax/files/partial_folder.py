"""Folders that get their names when they are complete; the next process removes what a killed one has left."""

import contextlib
import pathlib
import re
import secrets
import shutil
from collections.abc import Iterator

import filelock

_TOKEN_BYTES = 4


@contextlib.contextmanager
def partial_folder(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Provide a new folder beside `path` to write to and to rename to `path`; what is left of it at the end is removed.

    A lock, which ends with this process however it ends, tells other processes that the folder is in use. Folders for
    the same `path` whose process is dead are removed first.

    Args:
        path: folder to make, whose parent exists.

    Yields:
        The folder, which only this user can read.

    Raises:
        OSError: the folder cannot be made.
    """
    _remove_dead(path)
    folder = path.with_name(f".{path.name}-{secrets.token_hex(_TOKEN_BYTES)}")
    lock = filelock.FileLock(_lock_of(folder))
    try:
        with contextlib.suppress(OSError):  # a file system without locks: nobody removes the folder for us
            lock.acquire(timeout=0)
        folder.mkdir(0o700)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        lock.release()
        with contextlib.suppress(OSError):
            _lock_of(folder).unlink(missing_ok=True)


def _lock_of(folder: pathlib.Path) -> pathlib.Path:
    return folder.with_name(f"{folder.name}.lock")


def _remove_dead(path: pathlib.Path) -> None:
    """Remove the folders for `path` that no living process has locked, and their locks."""
    name = re.compile(rf"(\.{re.escape(path.name)}-[0-9a-f]{{{2 * _TOKEN_BYTES}}})\.lock")
    found = [match[1] for other in path.parent.iterdir() if (match := name.fullmatch(other.name))]
    for folder in map(path.with_name, found):
        # Timeout: its process lives. OSError: another user's, or the folder is being removed by another process.
        with contextlib.suppress(filelock.Timeout, OSError), filelock.FileLock(_lock_of(folder), timeout=0):
            shutil.rmtree(folder, ignore_errors=True)
            _lock_of(folder).unlink(missing_ok=True)

"""Files that are either whole or not there."""

import contextlib
import errno
import os
import pathlib
from collections.abc import Iterator

from ha2g_jax.errors import UserError


@contextlib.contextmanager
def whole_file(path: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """A temporary name beside `path`, with its suffix, that becomes `path` when the block ends without an exception.

    Whatever stops the block, Ctrl-C included, leaves nothing behind and an older file at `path` as it was. Missing
    folders are made.

    Raises:
        UserError: the place cannot be written, or is full.
    """
    path = pathlib.Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    new_folders = [folder for folder in path.parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder")
        temporary.touch()
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise UserError(
            f"cannot write {path} ({(error.strerror or str(error)).lower()}); choose another place, or make room"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
        with contextlib.suppress(OSError):  # a folder that is not empty stays
            for folder in new_folders:
                folder.rmdir()

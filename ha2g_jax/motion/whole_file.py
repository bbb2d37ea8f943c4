"""Files that are either whole or not there."""

import contextlib
import os
import pathlib
from collections.abc import Iterator

from ha2g_jax.errors import UserError


@contextlib.contextmanager
def whole_file(path: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """A temporary name beside `path`, with its suffix, that becomes `path` when the block ends without an exception.

    Whatever stops the block, Ctrl-C included, leaves nothing behind and an older file at `path` as it was. A missing
    folder is made.

    Raises:
        UserError: the folder cannot be made or written.
    """
    path = pathlib.Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
    except OSError as error:
        raise UserError(
            f"cannot write {path} ({(error.strerror or str(error)).lower()}); choose another place with --out"
        ) from error
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)

"""Writing of the files of a workdir, whose errors say that the same command continues."""

import contextlib
import pathlib
from collections.abc import Iterator

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown


@contextlib.contextmanager
def writing(path: pathlib.Path) -> Iterator[None]:
    """Turn a failure to write a file or folder, such as a full disk, into a `UserError` that names the path."""
    try:
        yield
    except OSError as error:
        raise UserError(
            f"{shown(path)} cannot be written ({error.strerror or error}): correct this, then the same command "
            "continues"
        ) from error


@contextlib.contextmanager
def replacing(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Provide a temporary path that replaces a file at the end; if writing fails, the file stays as it was.

    Args:
        path: path of the file.

    Raises:
        UserError: the file cannot be written, for example because the disk is full.
    """
    temporary = path.with_name(f"{path.name}.new")
    with writing(path):
        try:
            yield temporary
            temporary.replace(path)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()

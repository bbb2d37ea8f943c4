"""Atomic writing of files."""

import contextlib
import errno
import os
import pathlib
import zlib
from collections.abc import Iterable, Iterator

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown

_MAX_STEM = 200  # bytes; most file systems allow 255 for a whole name


def check_file(path: str | pathlib.Path) -> None:
    """Check that a path names a file and not a folder, before work whose result will be written to it.

    Raises:
        UserError: the path is that of a folder.
    """
    path = pathlib.Path(path)
    if not path.name or path.is_dir():
        raise UserError(f"cannot write {shown(path)} (is a folder); give the path of a file")


def check_kept(
    results: Iterable[pathlib.Path],
    inputs: Iterable[pathlib.Path | None],
    *,
    what: str = "result",
    option: str = "--out",
) -> None:
    """Check that no result would overwrite a file that is read, before the work.

    Args:
        results: paths of the files that are written.
        inputs: paths of the files that are read; None stands for an input that was not given.
        what: name of a result in the message.
        option: option that names the results.

    Raises:
        UserError: a result would overwrite one of the inputs.
    """
    kept = {os.path.realpath(path): path for path in inputs if path is not None}
    for path in results:
        if (resolved := os.path.realpath(path)) in kept:
            raise UserError(f"the {what} would overwrite {shown(kept[resolved])}; choose another path with {option}")


@contextlib.contextmanager
def whole_file(path: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """Provide a temporary path, which is renamed to `path` when the context ends without an exception.

    If the context is left in any other way, Ctrl-C included, nothing is left behind and an older file at `path` stays.
    Missing folders are made.

    Args:
        path: path of the file to write.

    Yields:
        The temporary path, beside `path` and with the same suffix.

    Raises:
        UserError: the file cannot be written, or the disk is full.
    """
    path = pathlib.Path(path)
    if not path.name:
        check_file(path)
    if path.is_symlink():  # its target is written, and the link stays
        path = pathlib.Path(os.path.realpath(path))
    temporary = path.with_name(f".{_short(path.stem)}.{os.getpid()}{path.suffix}")
    new_folders: list[pathlib.Path] = []
    try:
        new_folders += [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder")
        temporary.touch()
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise UserError(
            f"cannot write {shown(path)} ({reason(error).lower()}); use another folder or free disk space"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
        with contextlib.suppress(OSError):  # a folder that is not empty is kept
            for folder in new_folders:
                folder.rmdir()


def _short(stem: str) -> str:
    """Return a stem, or its checksum if the name of the temporary file would be too long."""
    encoded = os.fsencode(stem)
    return stem if len(encoded) <= _MAX_STEM else f"{zlib.crc32(encoded):08x}"

"""Atomic writing of files and folders, processing of several files, and checks of their paths."""

import contextlib
import errno
import os
import pathlib
import re
import secrets
import shutil
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence

import filelock
from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, resolved, shown
from ha2g_jax.progress import progress_bar

_MAX_NAME = 200  # bytes; most file systems allow 255 for a whole name
_TOKEN_BYTES = 4
_ADVICE = "use another folder or free disk space"


def do_each(desc: str, works: Sequence[tuple[pathlib.Path, Callable[[], object]]]) -> None:
    """Process each file, with a progress bar; a failure is reported on stderr and the other files are still processed.

    Raises:
        UserError: at the end, if a file failed.
    """
    failed = 0
    with progress_bar(desc, len(works), "file") as bar:
        for path, work in works:
            try:
                work()
            except UserError as error:
                failed += 1
                tqdm.write(f"{shown(path)} failed: {error}", file=sys.stderr)
            bar.update()
    if failed:
        raise UserError(f"{failed} of {len(works)} files failed, for the reasons above")


def check_file(path: str | pathlib.Path) -> None:
    """Check that a path names a file and not a folder, before work whose result will be written to it.

    Raises:
        UserError: the path is that of a folder.
    """
    path = pathlib.Path(path)
    if not path.name or path.is_dir():
        raise UserError(f"cannot write {shown(path)} (is a folder); give the path of a file")


def check_out(path: str | pathlib.Path) -> None:
    """Check that a path can be that of a file or a folder, before a result is written to it or to a name like it.

    Raises:
        UserError: the path is empty, "-", or that of a pipe or a device.
    """
    if not str(path):  # as --out "$NAME" of a name that is not set
        raise UserError("the path of the result is empty; give that of a file or folder")
    path = pathlib.Path(path)
    if str(path) == "-" or (path.exists() and not path.is_file() and not path.is_dir()):
        raise UserError(f"cannot write to {shown(path)}; give the path of a file or folder, not of a pipe or a device")


def check_kept(
    results: Iterable[pathlib.Path],
    inputs: Iterable[pathlib.Path | None],
    *,
    what: str = "result",
    option: str = "--out",
) -> None:
    """Check that no result would overwrite a file that is read, before the work.

    None stands for an input that was not given; the message names the result and the option that names its path.

    Raises:
        UserError: a result would overwrite one of the inputs.
    """
    kept = {resolved(path): path for path in inputs if path is not None}
    for path in results:
        if found := kept.get(resolved(path)):
            raise UserError(f"the {what} would overwrite {shown(found)}; choose another path with {option}")


def check_new(folder: str | pathlib.Path) -> None:
    """Check that a folder can be made, before work whose result will be written to it.

    Raises:
        UserError: there is something at the path that is not an empty folder.
    """
    folder = pathlib.Path(folder)
    is_empty = folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir())
    if os.path.lexists(folder) and not is_empty:
        raise UserError(f"{shown(folder)} exists already; choose another folder or remove it")


@contextlib.contextmanager
def writing(path: str | pathlib.Path, advice: str = _ADVICE) -> Iterator[None]:
    """Turn a failure to write, such as a full disk, into a `UserError` that names the path."""
    try:
        yield
    except OSError as error:
        raise UserError(f"cannot write {shown(path)} ({reason(error).lower()}); {advice}") from error


@contextlib.contextmanager
def whole_file(path: str | pathlib.Path, advice: str = _ADVICE) -> Iterator[pathlib.Path]:
    """Provide a temporary path, which is renamed to `path` when the context ends without an exception.

    If the context is left in any other way, Ctrl-C included, nothing is left behind and an older file at `path` stays.
    Missing folders are made. The temporary path is beside `path` and has its suffix.

    Raises:
        UserError: the file cannot be written, or the disk is full.
    """
    path = pathlib.Path(path)
    if not path.name:
        check_file(path)
    with writing(path, advice):  # its name may be too long
        if path.is_symlink():  # its target is written, and the link stays
            path = resolved(path)
    temporary = path.with_name(f".{_short(path.stem)}.{os.getpid()}{path.suffix}")
    with writing(path, advice), _parents(path):
        if path.exists() and not path.is_file():
            raise OSError(errno.EINVAL, "is a folder" if path.is_dir() else "is a device or a pipe")
        try:
            temporary.touch()
            yield temporary
            temporary.replace(path)
        except UserError as error:  # of a writer that was given the temporary path
            if shown(temporary) not in str(error):
                raise
            raise UserError(str(error).replace(shown(temporary), shown(path))) from error.__cause__ or error
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()


def write_text(path: str | pathlib.Path, text: str, advice: str = _ADVICE) -> None:
    """Write a text in UTF-8 atomically, see `whole_file`.

    Raises:
        UserError: the file cannot be written, or the disk is full.
    """
    with whole_file(path, advice) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextlib.contextmanager
def whole_folder(path: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """Provide a new folder, which is renamed to `path` when the context ends without an exception.

    If the context is left in any other way, nothing is left behind; the remains of a process that was killed are
    removed by the next one. Missing parent folders are made.

    Raises:
        UserError: there is something at `path` that is not an empty folder, or the folder cannot be written.
    """
    path = pathlib.Path(path).absolute()
    with writing(path), _parents(path):
        check_new(path)
        with temporary_folder(path) as folder:
            yield folder
            folder.chmod(0o755)
            check_new(path)  # another process may have made it meanwhile
            folder.rename(path)


@contextlib.contextmanager
def temporary_folder(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Provide a new folder beside `path` that only this user can read; if it still exists at the end, it is removed.

    A lock, which ends with this process however it ends, tells other processes that the folder is in use. Folders for
    the same `path` whose process is dead are removed first.

    Raises:
        OSError: the folder cannot be made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_dead(path)
    folder = path.with_name(f".{_short(path.name)}-{secrets.token_hex(_TOKEN_BYTES)}")
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


@contextlib.contextmanager
def _parents(path: pathlib.Path) -> Iterator[None]:
    """Make the parent folders of a path; those that are empty at the end are removed again."""
    new: list[pathlib.Path] = []
    try:
        new += [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        with contextlib.suppress(OSError):  # a folder that is not empty is kept
            for folder in new:
                folder.rmdir()


def _short(name: str) -> str:
    """Return a name, or its checksum if the name of the temporary file would be too long."""
    encoded = os.fsencode(name)
    return name if len(encoded) <= _MAX_NAME else f"{zlib.crc32(encoded):08x}"


def _lock_of(folder: pathlib.Path) -> pathlib.Path:
    return folder.with_name(f"{folder.name}.lock")


def _remove_dead(path: pathlib.Path) -> None:
    """Remove the folders for `path` that no living process has locked, and their locks."""
    name = re.compile(rf"(\.{re.escape(_short(path.name))}-[0-9a-f]{{{2 * _TOKEN_BYTES}}})\.lock")
    found = [match[1] for other in path.parent.iterdir() if (match := name.fullmatch(other.name))]
    for folder in map(path.with_name, found):
        # Timeout: its process lives. OSError: another user's, or the folder is being removed by another process.
        with contextlib.suppress(filelock.Timeout, OSError), filelock.FileLock(_lock_of(folder), timeout=0):
            shutil.rmtree(folder, ignore_errors=True)
            _lock_of(folder).unlink(missing_ok=True)

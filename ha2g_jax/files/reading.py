"""Reading of third-party files: their exceptions become one-line errors, and sizes are checked first.

Files that this package has written itself are read plainly.
"""

import codecs
import contextlib
import hashlib
import io
import json
import os
import pathlib
import stat
import struct
import threading
import unicodedata
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from typing import IO, Any

from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_JSON_DEPTH, MAX_NAME_LENGTH

# Exceptions that parsers raise for damaged or hostile content; UnicodeError is a ValueError, OverflowError an
# ArithmeticError.
_OF_CONTENT = (ValueError, ArithmeticError, RecursionError, EOFError, struct.error, zlib.error)

_MAX_CONTENTS = 1 << 20  # bytes in the table of contents of a zip file, enough for thousands of files
_CHUNK = 1 << 18
_HEAD = 256  # bytes at the beginning of a file, by which `why_not_there` knows what it is
_UNFINISHED = (".part", ".partial", ".crdownload", ".download", ".opdownload", ".filepart", ".!ut", ".aria2")

_lock = threading.Lock()
_kept: list[int] = []  # the standard error while it is replaced, once for each context that is open


def folded(name: str) -> str:
    """Return a name in the form in which names of files are compared: composed characters in lower case.

    A file from macOS may have an é of two characters.
    """
    return unicodedata.normalize("NFC", name).lower()


def shown(path: str | os.PathLike) -> str:
    """Return a path as printable text: bytes that are not UTF-8 and control characters are escaped, and the middle of a
    very long path is left out.
    """
    try:
        text = os.fsencode(path).decode("utf-8", errors="backslashreplace")
    except UnicodeEncodeError:  # half a pair of surrogates, which JSON may have
        text = os.fspath(path)
    text = "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text)
    if len(text) <= MAX_NAME_LENGTH:
        return text
    return f"{text[: MAX_NAME_LENGTH // 2]}...{text[-MAX_NAME_LENGTH // 2 :]}"


def files_below(folder: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield the files in a folder and its subfolders, in no order.

    Links to folders are followed, as data often lies on another disk; a folder that is reached twice is read once.
    """
    seen = set[str]()
    for path, folders, names in os.walk(folder, followlinks=True):
        real = os.path.realpath(path)
        if real in seen:
            folders.clear()
            continue
        seen.add(real)
        folders.sort()
        yield from (pathlib.Path(path, name) for name in names)


def resolved(path: str | os.PathLike) -> pathlib.Path:
    """Return a path as an absolute one without links; a link to itself stays, and is an error when it is read."""
    return pathlib.Path(os.path.realpath(path))


def why_not_there(path: str | os.PathLike) -> str:
    """Return why a path does not hold the actual file yet, and what to do; "" if it does.

    It may be a pointer of Git LFS or git-annex, an unfinished download, a web page that was saved instead of a file, or
    an empty file. Only the beginning of a regular file is read, so that a pipe keeps its content.
    """
    path = pathlib.Path(path)
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except (OSError, ValueError):  # the reader says why
        return ""
    if head.startswith(b"version https://git-lfs.github.com/spec/"):
        return "is a pointer of Git LFS, not the file: run git lfs pull"
    if head.startswith(b"/annex/objects/"):
        return "is a pointer of git-annex, not the file: run git annex get"
    if path.suffix.lower() in _UNFINISHED:
        return "is an unfinished download: wait until it is complete, or download it again"
    if not head:
        return "is an empty file: copy or download it again"
    is_page = head.removeprefix(codecs.BOM_UTF8).lstrip().lower().startswith((b"<!doctype html", b"<html"))
    if is_page and path.suffix.lower() not in (".html", ".htm"):
        return "is a web page, not the file: open it in a browser, which shows why, and download the file itself"
    return ""


def check_there(path: str | os.PathLike) -> None:
    """Check that a path, if it exists, holds the actual file, see `why_not_there`.

    Raises:
        UserError: it does not.
    """
    if why := why_not_there(path):
        raise UserError(f"{shown(path)} {why}")


@contextlib.contextmanager
def reading(path: str | os.PathLike, expected: str, *also: type[Exception]) -> Iterator[None]:
    """Turn the exceptions of a reader, and those in `also`, into a `UserError` that names the file.

    `expected` is the kind of file with its article: "a BVH file".

    Raises:
        UserError: the file is missing or unreadable, has not arrived yet, its content is not as expected, or memory
            did not suffice. A `UserError` of the reader itself passes unchanged.
    """
    check_there(path)
    try:
        yield
    except MemoryError as error:
        raise UserError(f"{shown(path)} needs more memory than there is; expected {expected} of usual size") from error
    except OSError as error:
        raise UserError(f"cannot read {shown(path)} ({reason(error)}); expected {expected}") from error
    except (*_OF_CONTENT, *also) as error:
        raise UserError(f"{shown(path)} is not {expected} ({reason(error)})") from error


@contextlib.contextmanager
def naming(path: str | os.PathLike) -> Iterator[None]:
    """Prefix the message of a `UserError` with the path of a file."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error


def reason(error: BaseException) -> str:
    """Return the message of an exception of a parser or of the system in one short line."""
    if isinstance(error, RecursionError):
        return "nested too deep"
    text = str(getattr(error, "strerror", None) or error)  # of OSError, and of the errors of FFmpeg
    text = " ".join(text.split()) or type(error).__name__
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return text if len(text) <= 200 else f"{text[:200]}..."


def check_regular(path: str | os.PathLike, expected: str) -> None:
    """Check that there is a regular file, because reading a pipe or a device may never end.

    Raises:
        UserError: there is nothing, a folder, a pipe or a device at the path, or its folder is unreadable.
    """
    try:
        mode = pathlib.Path(path).stat().st_mode
    except FileNotFoundError:
        raise UserError(f"no file at {shown(path)}; expected {expected}") from None
    except OSError as error:
        raise UserError(f"cannot read {shown(path)} ({reason(error)}); expected {expected}") from error
    except ValueError as error:
        raise UserError(f"{shown(path)} cannot be a path ({reason(error)}); expected {expected}") from error
    if stat.S_ISDIR(mode):
        raise UserError(f"a folder at {shown(path)}; expected {expected}")
    if not stat.S_ISREG(mode):
        raise UserError(f"{shown(path)} is not a file but a pipe or a device; expected {expected}")


def check_utf8(path: str | os.PathLike) -> None:
    """Check that a path is UTF-8, as the libraries that read and write corpora need it.

    Raises:
        UserError: the path has bytes that are not UTF-8.
    """
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError as error:
        raise UserError(f"the path {shown(path)} is not UTF-8, which corpora need; rename it") from error


def read_bytes(path: str | os.PathLike, expected: str, max_bytes: int) -> bytes:
    """Read a whole file or pipe that must not be larger than `max_bytes`.

    This is checked while reading, because the size that a system reports may be 0 or old.

    Raises:
        UserError: the file is missing, a folder, unreadable or too large.
    """
    with reading(path, expected), pathlib.Path(path).open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise UserError(f"{shown(path)} has more than {max_bytes} bytes, which is too large for {expected}")
    return content


def file_sha256(path: str | os.PathLike) -> str:
    """Return the SHA-256 of a file in hexadecimal digits, without reading it into memory at once."""
    with pathlib.Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_json(path: str | os.PathLike, expected: str, max_bytes: int) -> Any:
    """Read a JSON document of limited size and depth; see `read_bytes` for the arguments.

    Raises:
        UserError: the file is missing, unreadable, too large, not JSON in UTF-8, or nested too deep.
    """
    content = read_bytes(path, expected, max_bytes)
    with reading(path, expected):
        return parse_json(content)


def parse_json(text: str | bytes) -> Any:
    """Parse JSON, in UTF-8 if bytes, whose values are nested at most `MAX_JSON_DEPTH` deep.

    Raises:
        ValueError: the text is not JSON, or is nested too deep.
    """
    if isinstance(text, bytes):
        text = text.decode("utf-8-sig")
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None
    layer, depth = _groups([value]), 1
    while layer:
        if depth > MAX_JSON_DEPTH:
            raise ValueError("nested too deep")
        layer = [inner for outer in layer for inner in _groups(outer.values() if type(outer) is dict else outer)]
        depth += 1
    return value


def _groups(values: Iterable[Any]) -> list[Any]:
    # Only objects and lists, because a file may have millions of numbers.
    return [value for value in values if type(value) is dict or type(value) is list]


class SmallReads(io.BufferedReader):
    """Reader that refuses large reads, because zipfile would turn a table of contents of any size into objects."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > _MAX_CONTENTS:
            raise zipfile.BadZipFile(f"a table of contents of {size} bytes")
        return super().read(size)


def read_exactly(file: IO[bytes], count: int) -> memoryview:
    """Read bytes of a file, such as one in a zip file, in small parts; the caller has checked that their number is
    plausible.

    Raises:
        EOFError: the file ends early.
    """
    data = memoryview(bytearray(count))
    position = 0
    while position < count:
        chunk = file.read(min(_CHUNK, count - position))
        if not chunk:
            raise EOFError("it ends early")
        data[position : position + len(chunk)] = chunk
        position += len(chunk)
    return data


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Discard what is written to the standard error of the process, by any of its threads, in this context.

    Contexts of several threads may overlap; the last one that is left restores the standard error.
    """
    with _lock:
        try:
            kept = _kept[0] if _kept else os.dup(2)
        except OSError:  # it is closed
            kept = None
        if kept is not None:
            if not _kept:
                with pathlib.Path(os.devnull).open("wb") as nothing:
                    os.dup2(nothing.fileno(), 2)
            _kept.append(kept)
    try:
        yield
    finally:
        with _lock:
            if kept is not None:
                _kept.pop()
                if not _kept:
                    os.dup2(kept, 2)
                    os.close(kept)

"""Reads of zip files of unknown origin that stay small, whatever sizes the file states."""

import io
import zipfile
from typing import IO

MAX_CONTENTS = 1 << 20  # bytes in the table of contents of a zip file, enough for thousands of files
_CHUNK = 1 << 18


class SmallReads(io.BufferedReader):
    """Reader that refuses large reads, because zipfile would read a table of contents of any size into objects."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > MAX_CONTENTS:
            raise zipfile.BadZipFile(f"a table of contents of {size} bytes")
        return super().read(size)


def read_exactly(file: IO[bytes], count: int) -> memoryview:
    """Read bytes of a file in small parts.

    Args:
        file: file, which may be part of a zip file.
        count: number of bytes; the caller has compared it with what the file can have.

    Returns:
        The bytes.

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

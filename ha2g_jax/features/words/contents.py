"""Reader of text files of unknown origin, with a limit of the size and detection of the encoding."""

import codecs
import logging
import pathlib

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, reading, shown
from ha2g_jax.limits import MAX_TRANSCRIPT_BYTES, MAX_TRANSCRIPT_LINES

_EXPECTED = "a transcript"

_BYTE_ORDER_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_CONTROLS = {*map(chr, range(32)), "\x7f", "\ufffe"} - set("\t\n\r\f\v")

_logger = logging.getLogger(__name__)


def read_text(path: pathlib.Path) -> str:
    """Read a text file in UTF-8, UTF-16 with a byte order mark, or else Windows-1252.

    Args:
        path: path of the file.

    Returns:
        The text with line ends as \\n.

    Raises:
        UserError: the file does not exist, is empty, too large, or not text.
    """
    check_regular(path, _EXPECTED)  # reading a pipe would wait for ever
    with reading(path, _EXPECTED), path.open("rb") as file:
        data = file.read(MAX_TRANSCRIPT_BYTES + 1)
    if not data:
        raise UserError(f"{shown(path)} is an empty file; expected a transcript")
    if len(data) > MAX_TRANSCRIPT_BYTES:
        size = f"{MAX_TRANSCRIPT_BYTES >> 20} MiB"
        raise UserError(f"{shown(path)} is larger than {size}; expected the transcript of one recording")
    text = _decode(data, path).replace("\r\n", "\n").replace("\r", "\n")
    if text.count("\n") > MAX_TRANSCRIPT_LINES:
        raise UserError(f"{shown(path)} has more than {MAX_TRANSCRIPT_LINES} lines; expected a transcript")
    if not _CONTROLS.isdisjoint(text):
        raise UserError(f"{shown(path)} has binary data; expected a transcript")
    if not text.strip():
        raise UserError(f"{shown(path)} has nothing but white space; expected a transcript")
    return text


def _decode(data: bytes, path: pathlib.Path) -> str:
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise UserError(f"{shown(path)} is not valid {encoding} text ({error.reason}); save it as UTF-8") from error
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError as error:
        raise UserError(f"{shown(path)} is not text in UTF-8, UTF-16 or Windows-1252; save it as UTF-8") from error
    _logger.warning("%s is not UTF-8; read as Windows-1252", shown(path))
    return text

"""Reader of text files of unknown origin, with a limit of the size and detection of the encoding."""

import codecs
import logging
import pathlib

from ha2g_jax.errors import UserError

# A TextGrid of an hour with every phone, in UTF-16, is smaller.
MAX_BYTES = 16 << 20

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
        UserError: the file does not exist, is empty, larger than 16 MiB, or not text.
    """
    try:
        if path.exists() and not path.is_file():  # reading a pipe would wait for ever
            raise UserError(f"{path} is not a file; give the path of a transcript")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}); give the path of a transcript") from error
    if not data:
        raise UserError(f"{path} is an empty file; expected a transcript")
    if len(data) > MAX_BYTES:
        raise UserError(f"{path} is larger than {MAX_BYTES >> 20} MiB; expected the transcript of one recording")
    text = _decode(data, path).replace("\r\n", "\n").replace("\r", "\n")
    if not _CONTROLS.isdisjoint(text):
        raise UserError(f"{path} has binary data; expected a transcript")
    if not text.strip():
        raise UserError(f"{path} has nothing but white space; expected a transcript")
    return text


def _decode(data: bytes, path: pathlib.Path) -> str:
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise UserError(f"{path} is not valid {encoding} text ({error.reason}); save it as UTF-8") from error
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError as error:
        raise UserError(f"{path} is not text in UTF-8, UTF-16 or Windows-1252; save it as UTF-8") from error
    _logger.warning("%s is not UTF-8; read as Windows-1252", path)
    return text

"""Reader of transcripts in whatever encoding a program wrote; an encoding that is not certain is refused."""

import codecs
import logging
import pathlib
import re
import string

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, reading, shown
from ha2g_jax.limits import MAX_TRANSCRIPT_BYTES, MAX_TRANSCRIPT_LINES

# The mark of UTF-32 begins with that of UTF-16.
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_CONTROLS = {*map(chr, range(32)), *map(chr, range(127, 160)), "\ufffe"} - set("\t\n\r\f\v\x85")
_logger = logging.getLogger(__name__)

# The letters beyond ASCII of each language of Western Europe: French, German, Spanish, Portuguese, Italian, Dutch,
# Danish and Norwegian, Swedish and Finnish.
_ALPHABETS = ("àâæçéèêëîïôœùûüÿ", "äöüßé", "áéíñóúü", "áâãàçéêíóôõúü", "àèéìíîòóù", "áéèëïíóöü", "æøåéóòô", "åäöéüšž")
_AROUND_WORDS = "“”„‘’‚«»‹›¿¡…–—•·©®™°€£§♪"
_FOREIGN_WORD = re.compile(r"[^\W_]*[^\x00-\x7f\s][^\s]*")
# Letters of Mac OS Roman whose bytes occur in no word of Windows-1252.
_ONLY_MAC = re.compile(rb"[\x80-\x81\x83\x86-\x90\x98-\x99\x9b-\x9d]")
# A dash between letters of Windows-1252 may be a letter of Mac OS Roman.
_DASH_OR_LETTER = re.compile(rb"[A-Za-z][\x96\x97][A-Za-z]")


def read_text(path: pathlib.Path, expected: str = "a transcript") -> str:
    """Read a text file, which is called `expected` in messages, with line ends as \\n.

    It is in UTF-8, in UTF-16 with or without a byte order mark, in UTF-32 with one, or in Windows-1252 or Mac OS Roman
    if all its words are spelled with the letters of one language of Western Europe. Text that a program has encoded
    twice (`cafÃ©`) is repaired.

    Raises:
        UserError: the file cannot be read, is too large, or is in another encoding.
    """
    check_regular(path, expected)  # reading a pipe would wait for ever
    with reading(path, expected), path.open("rb") as file:
        data = file.read(MAX_TRANSCRIPT_BYTES + 1)
    if len(data) > MAX_TRANSCRIPT_BYTES:
        size = f"{MAX_TRANSCRIPT_BYTES >> 20} MiB"
        raise UserError(f"{shown(path)} is larger than {size}; expected the transcript of one recording")
    if data.startswith(b"ooBinaryFile"):
        raise UserError(f"{shown(path)} is a binary file of Praat; save it from Praat as text file")
    text = _decode(data, path).replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a\0")  # ends of files in DOS
    if text.count("\n") > MAX_TRANSCRIPT_LINES:
        raise UserError(f"{shown(path)} has more than {MAX_TRANSCRIPT_LINES} lines; expected a transcript")
    if not _CONTROLS.isdisjoint(text):
        raise UserError(f"{shown(path)} has binary data; expected a transcript")
    if "\ufffd" in text:
        raise UserError(f"{shown(path)} has lost letters (U+FFFD); export the transcript again, as UTF-8")
    if not text.strip():
        raise UserError(f"{shown(path)} has nothing but white space; expected a transcript")
    return text


def _decode(data: bytes, path: pathlib.Path) -> str:
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and len(data) > 1 and data[:2].count(0) == 1:  # transcripts begin with a letter of ASCII
        encoding = "utf-16-le" if data[1] == 0 else "utf-16-be"
    try:
        return _once(data.decode(encoding))
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise UserError(f"{shown(path)} is not valid {encoding} text ({error.reason}); save it as UTF-8") from error
    for encoding, name in (("cp1252", "Windows-1252"), ("mac_roman", "Mac OS Roman")):
        text = data.decode(encoding, errors="replace")
        is_known = not _DASH_OR_LETTER.search(data) if encoding == "cp1252" else _ONLY_MAC.search(data)
        if is_known and _is_western(text):
            _logger.warning("%s is not UTF-8; read as %s", shown(path), name)
            return text
    raise UserError(f"{shown(path)} is text in an encoding that cannot be known; save it as UTF-8")


def _once(text: str) -> str:
    """Undo a second encoding, of UTF-8 that was read as Windows-1252."""
    try:
        return text if text.isascii() else text.encode("cp1252").decode("utf-8")
    except ValueError:
        return text


def _is_western(text: str) -> bool:
    """Return whether all letters beyond ASCII belong to one language, each in a word with others and in its case."""
    letters: set[str] = set()
    for word in {match.strip(_AROUND_WORDS + string.punctuation) for match in _FOREIGN_WORD.findall(text)}:
        for part in re.split(r"[\x00-@\[-`{-\x7f’–—]+", word):
            foreign = {letter for letter in part.lower() if letter > "\x7f"}
            if foreign and (len(part) > 1 and part.lower().strip("".join(foreign)) == ""):
                return False
            if not (part.islower() or part.isupper() or (part[:1].isupper() and part[1:].islower()) or not foreign):
                return False
            letters |= foreign
    return any(letters <= set(alphabet) for alphabet in _ALPHABETS)

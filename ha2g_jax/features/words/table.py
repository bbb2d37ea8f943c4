"""Parser of tables with the columns start, end and word, separated by tabs or commas."""

import csv
import pathlib
from collections.abc import Iterator

from ha2g_jax.errors import UserError
from ha2g_jax.features.words.timing import Stretch
from ha2g_jax.files.reading import shown

_NAMES = {
    "start": ("start", "begin", "onset", "start_time", "start time", "xmin", "tmin"),
    "end": ("end", "stop", "offset", "end_time", "end time", "xmax", "tmax"),
    "text": ("word", "text", "token", "label"),
}
_MAX_LINE = 1 << 16


def parse_table(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse a table of words.

    The first line names the columns start, end and word (or text); without such a line the columns are start, end,
    word. Times are seconds. If the third column is called `text` and all times are integers, as in Whisper's tables,
    they are milliseconds.

    Args:
        text: contents of the file.
        path: path of the file, to name it in an error message.

    Returns:
        One stretch per row.

    Raises:
        UserError: a row lacks a column, or a time is not a number.
    """
    rows, name = _rows(text, path), shown(path)
    number, header = next(rows, (0, None))
    if header is None:
        raise UserError(f"{name} has no rows; expected start, end and word in each")
    names = [field.strip().lower() for field in header]
    columns = {key: next((names.index(name) for name in known if name in names), -1) for key, known in _NAMES.items()}
    may_be_milliseconds = columns["text"] >= 0 and names[columns["text"]] == "text"
    stretches = []
    if -1 in columns.values():
        columns, may_be_milliseconds = {"start": 0, "end": 1, "text": 2}, False
        if len(names) != 3 or not _is_number(names[0]):
            raise UserError(f"{shown(path)} has the columns {', '.join(names)[:80]}; expected start, end and word")
        stretches.append(_stretch(header, columns, f"{name}, line {number},"))
    for number, row in rows:
        may_be_milliseconds &= all(row[columns[key]].isdecimal() for key in ("start", "end") if columns[key] < len(row))
        stretches.append(_stretch(row, columns, f"{name}, line {number},"))
    if may_be_milliseconds:
        return [Stretch(text, start / 1000, end / 1000) for text, start, end in stretches]
    return stretches


def _rows(text: str, path: pathlib.Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the fields of each row."""
    lines = text.lstrip("\n").split("\n")
    if max(map(len, lines)) > _MAX_LINE:
        raise UserError(
            f"{shown(path)} has a line of more than {_MAX_LINE} characters; expected start, end and word in each"
        )
    # Tools that write tabs do not quote, and a transcript may have a single quotation mark.
    style = {"delimiter": "\t", "quoting": csv.QUOTE_NONE} if "\t" in lines[0] else {"delimiter": ",", "strict": True}
    reader = csv.reader(lines, **style)
    try:
        for row in reader:
            if any(field.strip() for field in row):
                yield reader.line_num, row
    except csv.Error as error:
        raise UserError(
            f"{shown(path)}, line {reader.line_num}, is damaged ({error}); export the table again"
        ) from error


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _stretch(row: list[str], columns: dict[str, int], name: str) -> Stretch:
    try:
        start, end, text = (row[columns[key]] for key in ("start", "end", "text"))
        return Stretch(text, float(start), float(end))
    except IndexError as error:
        raise UserError(f"{name} has {len(row)} columns instead of {1 + max(columns.values())}; correct it") from error
    except ValueError as error:
        raise UserError(f"{name} has a time that is not a number ({str(error)[:80]}); correct it") from error

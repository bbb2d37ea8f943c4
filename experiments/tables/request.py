"""Request of the user for a table, from the texts of the command line."""

import ast
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.data.talk import build
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import check_file

_DEBUG_SPEAKERS, _DEBUG_MINUTES = 6, 10  # of the Talk corpus of the debug size

_OPTIONS = {"seed": "--seeds", "data.path": "--data NAME:DIR"}  # settings that are options of their own


class Request(NamedTuple):
    """Request of the user for a table.

    Attributes:
        table: one of `paper_tables.TABLES`.
        data: one of `presets.DATA`.
        size: one of `config.SIZES`.
        path: folder of the corpus; "" for the Talk corpus, which is made on first use.
        seeds: seeds of the runs of each row.
        workdir: folder of the workdirs of all runs.
        changes: dotted name of a setting -> value, for every row but not for the auto-encoder.
        jobs: number of runs at once.
        has_training: whether to train missing runs; False only evaluates existing ones.
        has_legacy: whether to add the scores of the public release.
    """

    table: str
    data: str
    size: str
    path: str
    seeds: tuple[int, ...]
    workdir: pathlib.Path
    changes: Mapping[str, Any] = {}
    jobs: int = 1
    has_training: bool = True
    has_legacy: bool = False


def check_report(out: pathlib.Path) -> None:
    """Check the path of a report before hours of work.

    Args:
        out: Markdown file to write, beside which the chart has the suffix .svg.

    Raises:
        UserError: the path is that of a folder, or of the chart.
    """
    check_file(out)
    if out.suffix.lower() == ".svg":
        raise UserError(f"{shown(out)} would be the chart of the report; give the name of the report, such as out.md")


def parse_seeds(text: str) -> tuple[int, ...]:
    """Parse seeds.

    Args:
        text: number of seeds, such as "3" for 0, 1 and 2, or a list such as "0,5,7".

    Returns:
        The seeds.

    Raises:
        UserError: the text has another form, or gives no seed or one twice.
    """
    parts = text.split(",")
    if not all(part.strip().isdecimal() for part in parts if part.strip()) or not text.strip(", "):
        raise UserError(f"--seeds {text} is neither a number of seeds nor a list such as 0,5,7")
    numbers = tuple(int(part) for part in parts if part.strip())
    seeds = numbers if "," in text else tuple(range(numbers[0]))
    if not seeds or len(set(seeds)) < len(seeds):
        raise UserError(f"--seeds {text} gives {'a seed twice' if seeds else 'no seed'}; give one or more, each once")
    return seeds


def parse_changes(texts: Sequence[str]) -> dict[str, Any]:
    """Parse changes of settings.

    Args:
        texts: texts of the form KEY=VALUE; a value that is not a Python literal is text.

    Returns:
        Dotted name of a setting -> value.

    Raises:
        UserError: a text has no key or no value, or the setting is an option of its own.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        key, _, value = text.partition("=")
        if not key or not value:
            raise UserError(f"--changes {text} is not KEY=VALUE, such as train.steps=3000")
        if key in _OPTIONS:
            raise UserError(f"--changes cannot set {key}; give {_OPTIONS[key]}")
        try:
            changes[key] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            changes[key] = value
    return changes


def corpus_path(request: Request) -> pathlib.Path:
    """Return the folder of the corpus; make the Talk corpus if it is missing, a small one for the debug size.

    Args:
        request: request of the user.

    Raises:
        UserError: the data set needs a path, or the Talk corpus cannot be made.
    """
    if request.path:
        return pathlib.Path(request.path).resolve()
    if request.data != "talk":
        raise UserError(f"--data {request.data} needs the folder of a corpus: add --path DIR (docs/data.md)")
    if request.size != "debug":
        return build.talk_path("talk").resolve()
    path = request.workdir.resolve() / "talk-debug-corpus"
    if not path.exists():
        build.make_talk(path, speakers=_DEBUG_SPEAKERS, minutes=_DEBUG_MINUTES, seed=0)
    return path

"""Tables 5 and 10: statistics of a corpus beside those that the paper gives for its data sets. Nothing is trained."""

import os
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus.statistics import joint_rows, summarise
from tables.tables import markdown

CORPUS_TABLES = ("table5", "table10")

# Videos, hours and segments of all splits, and ratio of the length of a video that shots of interest have.
_TABLE_5 = {
    "TED Gesture, paper": ("1,766", "106.1", "252,109", "25 %"),
    "TED-Expressive, paper": ("1,764", "100.8", "240,447", "21 %"),
}


def corpus_report(name: str, path: str | os.PathLike, command: str) -> str:
    """Write the report of Table 5 or 10 for a corpus as Markdown.

    Args:
        name: one of `CORPUS_TABLES`.
        path: folder of the corpus.
        command: command of the user.

    Raises:
        UserError: there is no corpus, a record cannot be used, or Table 10 is asked for without a training split.
    """
    found = summarise(path)
    if name == "table10" and not found["training"]:
        raise UserError(f"{path} has no training split, which the angles of Table 10 are of")
    title, lines, note = _table_5(found) if name == "table5" else _table_10(found)
    return "\n".join([f"# {title}", "", f"Made by `{command}`.", "", *markdown(lines).splitlines(), "", note, ""])


def _table_5(found: dict[str, Any]) -> tuple[str, list[tuple[str, ...]], str]:
    lines = [("data", "videos", "hours", "segments", "ratio of interest")]
    lines += [(name, *numbers) for name, numbers in _TABLE_5.items()]
    for name, counts in [*found["splits"].items(), ("all splits", found["total"])]:
        numbers = (f"{counts['recordings']:,}", f"{counts['hours']:,.3f}", f"{counts['windows']:,}", "-")
        lines.append((f"this corpus, {name}", *numbers))
    note = (
        "A video is a recording here, and a segment a window of 34 frames that starts every 10 frames. A corpus does "
        "not store how long the recordings were before clips were cut from them, so that it has no ratio."
    )
    return "Table 5: size of the data", lines, note


def _table_10(found: dict[str, Any]) -> tuple[str, list[tuple[str, ...]], str]:
    lines = [tuple(row) for row in joint_rows(found["training"])]
    note = (
        "Angles inside the joint, in degrees, over the frames of the training split that lie in windows. *Published* "
        "are the statistics that were published with TED-Expressive and TED-Gesture, which differ from the paper's "
        'Table 10; its "var" agrees neither with their variances nor, at the elbows, with their standard deviations.'
    )
    return "Table 10: angles of the shoulders and elbows", lines, note

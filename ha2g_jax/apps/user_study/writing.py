"""The report of a user study as Markdown and as an HTML page, and the folder with both.

Names of systems, files and participants and all comments are text of any origin: they are escaped here, and the page
allows no script.
"""

import base64
import html
import importlib.resources
import json
import pathlib
import re
import string
from collections.abc import Mapping
from typing import Any

from ha2g_jax.apps.user_study.report import Chart, Section, Table, sections
from ha2g_jax.evaluation.corpus.charts import table as html_table
from ha2g_jax.files.writing import whole_file

PAGE, MARKDOWN, NUMBERS = "report.html", "report.md", "report.json"
"""Files of the folder; charts are beside them as `.svg`."""

_SPECIAL = re.compile(r"([\\`*_\[\]|~$@]|:(?=//)|(?<=www)\.)")  # links that are made without brackets, too


def write_report(results: Mapping[str, Any], out: pathlib.Path) -> pathlib.Path:
    """Write a folder with the report as an HTML page, as Markdown with charts, and as JSON.

    Args:
        results: return value of `analysis.analyse`.
        out: folder to write, which may exist.

    Returns:
        Path of the page. Each file is written completely or not at all.

    Raises:
        UserError: a file cannot be written.
    """
    found = sections(results)
    files = {
        MARKDOWN: as_markdown(results, charts=True),
        NUMBERS: as_json(results) + "\n",
        PAGE: as_html(results),
    }
    charts = [part for section in found for part in section.parts if isinstance(part, Chart)]
    for name, text in ({f"{chart.name}.svg": chart.svg for chart in charts} | files).items():
        with whole_file(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8", errors="replace")
    return out / PAGE


def as_json(results: Mapping[str, Any]) -> str:
    """Return results as JSON in ASCII."""
    return json.dumps(results, indent=1, allow_nan=False)


def as_markdown(results: Mapping[str, Any], *, charts: bool = False) -> str:
    """Return the report as Markdown.

    Args:
        results: return value of `analysis.analyse`.
        charts: whether to refer to the charts as files beside the report.
    """
    lines = []
    for number, section in enumerate(sections(results)):
        lines += [f"{'#' if not number else '##'} {_markdown(section.heading)}", ""]
        for part in section.parts:
            if isinstance(part, Table):
                head, *body = [" | ".join(_markdown(cell) or " " for cell in row) for row in part.rows]
                rule = " | ".join(["---"] * len(part.rows[0]))
                lines += [f"| {row} |" for row in (head, rule, *body)] + [""]
            elif not isinstance(part, Chart):
                lines += [_markdown(part), ""]
            elif charts:
                lines += [f"![{_markdown(part.label)}]({part.name}.svg)", ""]
    return "\n".join(lines)


def as_html(results: Mapping[str, Any]) -> str:
    """Return the report as an HTML page that needs no other file and has no script.

    Args:
        results: return value of `analysis.analyse`.
    """
    found = sections(results)
    body = "\n".join(_html(section, "h2" if number else "h1") for number, section in enumerate(found))
    template = importlib.resources.files("ha2g_jax") / "assets" / "corpus_report.html"
    return string.Template(template.read_text()).substitute(title=html.escape(_plain(found[0].heading)), body=body)


def _html(section: Section, level: str) -> str:
    parts = [f"<{level}>{html.escape(_plain(section.heading))}</{level}>"]
    for part in section.parts:
        if isinstance(part, Table):
            parts.append(html_table([[_plain(cell) for cell in row] for row in part.rows]))
        elif isinstance(part, Chart):
            data = base64.b64encode(part.svg.encode("utf-8", errors="replace")).decode()
            label = html.escape(_plain(part.label))
            parts.append(f'<p><img style="max-width:100%" alt="{label}" src="data:image/svg+xml;base64,{data}"></p>')
        else:
            parts.append(f"<p>{html.escape(_plain(part))}</p>")
    return "\n".join(parts)


def _plain(text: str) -> str:
    """Return a text in one line, without control characters and those that turn the direction of others."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _markdown(text: str) -> str:
    """Return a text that Markdown shows as it is: HTML and all that marks up are escaped."""
    return _SPECIAL.sub(r"\\\1", html.escape(_plain(text), quote=False))

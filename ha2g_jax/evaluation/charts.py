"""Write the tables and the charts of reports: Markdown, HTML, and SVG by matplotlib."""

import html
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ha2g_jax.errors import require

if TYPE_CHECKING:  # an extra, which takes a while to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which people with colour vision deficiency can distinguish.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#999999", "#000000")

_NAME_LETTERS = 40
_ENDLESS = 1e6  # drawn length of an infinite side of an interval


class Mark(NamedTuple):
    """A value and the bounds of its interval; a bound is NaN if there is none, and may be infinite."""

    value: float
    low: float = math.nan
    high: float = math.nan


def number(value: float | None) -> str:
    """Format a value with about three digits; None gives "", NaN gives "-"."""
    if value is None:
        return ""
    if math.isnan(value):
        return "-"
    size = abs(value)
    return f"{value:.1f}" if size >= 100 else f"{value:.2f}" if size >= 10 else f"{value:.3f}"


def markdown(rows: Iterable[Sequence[str]], *, has_numbers: bool = False) -> str:
    """Write a Markdown table of plain text whose first row is its header.

    Args:
        has_numbers: whether all columns but the first are aligned to the right.
    """
    head, *body = ([cell.replace("|", "\\|") or " " for cell in row] for row in rows)
    rule = ["---", *["---:" if has_numbers else "---"] * (len(head) - 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, rule, *body))


def html_table(rows: Sequence[Sequence[str]]) -> str:
    """Write an HTML table of plain text with headings in its first row and column, which scrolls if too wide."""
    head = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in rows[0])
    body = "".join(
        f'<tr><th scope="row">{html.escape(title)}</th>'
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for title, *cells in rows[1:]
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def interval_chart(
    rows: Mapping[str, Mapping[str, Mark]], *, label: str, axis: str, reference: float | None = None
) -> str:
    """Draw an SVG document with a row for each name, and in it a point with its interval for each series.

    Args:
        rows: name of a row -> name of a series -> its mark.
        label: description of the chart for screen readers.
        reference: value at which a dashed line is drawn, such as no difference.
    """
    series = list(dict.fromkeys(name for marks in rows.values() for name in marks))
    height = 0.9 + 0.16 * sum(len(marks) + 0.6 for marks in rows.values())
    figure, ((axes,),) = make_figure(8, height)
    for count, name in enumerate(series):
        shift = (count - (len(series) - 1) / 2) / (len(series) + 0.6)
        places = {place + shift: marks[name] for place, marks in enumerate(rows.values()) if name in marks}
        draw_marks(axes, places, COLOURS[count % len(COLOURS)], name, is_horizontal=True)
    _set_limits(axes, (mark for marks in rows.values() for mark in marks.values()), reference)
    axes.set_yticks(range(len(rows)), [literal(name) for name in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel(literal(axis))
    if reference is not None:
        axes.axvline(reference, color="#222222", linewidth=1, linestyle="--")
    if len(series) > 1:
        figure.legend(loc="outside upper center", ncols=4, frameon=False)
    return as_svg(figure, label)


def histogram(
    counts: Sequence[int],
    edges: np.ndarray,
    *,
    axis: str,
    label: str,
    curves: Mapping[str, tuple[float, float]] | None = None,
) -> str:
    """Draw an SVG document of a histogram as a density, with normal densities over it.

    Args:
        counts: count of each bin.
        edges: (bins + 1,) edges of the bins, evenly spaced.
        label: description of the chart for screen readers.
        curves: name of a curve -> its mean and standard deviation.
    """
    figure, ((axes,),) = make_figure(5, 2.5)
    density = np.asarray(counts) / (max(sum(counts), 1) * float(edges[1] - edges[0]))
    axes.stairs(density, edges, fill=True, color="#9db8dc", label="this corpus")
    values = np.linspace(edges[0], edges[-1], 241)
    for count, (name, (mean, deviation)) in enumerate((curves or {}).items(), start=1):
        line = np.exp(-0.5 * ((values - mean) / deviation) ** 2) / (deviation * np.sqrt(2 * np.pi))
        axes.plot(values, line, color=COLOURS[count], linestyle="--" if count == 1 else "-", label=literal(name))
    axes.set(xlabel=literal(axis), yticks=[], xlim=(edges[0], edges[-1]))
    if curves:
        axes.legend(frameon=False, fontsize=8)
    return as_svg(figure, label)


def draw_marks(axes: "Axes", places: Mapping[float, Mark], colour: str, name: str, *, is_horizontal: bool) -> None:
    """Draw points with their intervals."""
    shown = {place: mark for place, mark in places.items() if math.isfinite(mark.value)}
    values = [mark.value for mark in shown.values()]
    ends = [
        [_length(mark.value - mark.low) for mark in shown.values()],
        [_length(mark.high - mark.value) for mark in shown.values()],
    ]
    style: dict[str, Any] = {"fmt": "o", "color": colour, "markersize": 4, "capsize": 2, "linewidth": 1.4}
    if is_horizontal:
        axes.errorbar(values, list(shown), xerr=ends, label=literal(name), **style)
    else:
        axes.errorbar(list(shown), values, yerr=ends, label=literal(name), **style)


def _length(length: float) -> float:
    """Return the length of one side of an interval, 0 if it has none, and a large number if it is infinite."""
    return 0.0 if math.isnan(length) else min(length, _ENDLESS)


def _set_limits(axes: "Axes", marks: Iterable[Mark], reference: float | None) -> None:
    """Set the limits of the horizontal axis, beyond which infinite intervals extend."""
    finite = [value for mark in marks for value in mark if math.isfinite(value)]
    finite += [] if reference is None else [reference]
    low, high = min(finite, default=0.0), max(finite, default=1.0)
    margin = 0.05 * (high - low) or 0.5
    axes.set_xlim(low - margin, high + margin)


def make_figure(width: float, height: float, columns: int = 1, rows: int = 1) -> tuple["Figure", list[list["Axes"]]]:
    """Make a figure of a size in inches with a grid of axes.

    Raises:
        UserError: matplotlib is missing.
    """
    figure = require("matplotlib.figure", "report", by="a chart").Figure(figsize=(width, height), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).tolist()
    for axes in (axes for row in grid for axes in row):
        axes.grid(color="#dddddd", linewidth=0.7)
        axes.set_axisbelow(True)
        axes.tick_params(length=0, labelsize=9)
        axes.spines[["top", "right", "left"]].set_visible(False)
    return figure, grid


def as_svg(figure: "Figure", label: str) -> str:
    """Return an SVG document, the same for the same chart, which may stand in a page with others."""
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": label}):
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg")
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r' id="(?![mpc][0-9a-f]{10})[^"]*"', "", text)  # those of groups are the same in every chart
    text = re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\d\.\d)\d+", r"\1", tag[0]), text)
    shown = html.escape(printable(label))
    head = f'<svg role="img" aria-label="{shown}" '
    return text.replace("<svg ", head, 1).replace(">", f"><title>{shown}</title>", 1).strip() + "\n"


def literal(text: str) -> str:
    """Escape a text so that matplotlib shows it literally, and cut it if it is long."""
    text = printable(text if len(text) <= _NAME_LETTERS else f"{text[: _NAME_LETTERS - 3]}...")
    return text.replace("$", r"\$")


def printable(text: str) -> str:
    """Return a text in one line, without control characters and those that change the direction of text."""
    return "".join(letter if letter.isprintable() else " " for letter in text)

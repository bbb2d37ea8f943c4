"""Charts as inline SVG and HTML, without a library or separate files. Colours are classes of the page's style sheet.

Every text is escaped here, because names of clips, speakers and reasons come from files.
"""

import html
from collections.abc import Mapping, Sequence

import numpy as np

_WIDTH, _HEIGHT = 480, 240
_LEFT, _RIGHT, _TOP, _BOTTOM = 20, 20, 12, 30  # margins around the axes
_ROW = 20  # height of a row of ranges
_NAME_WIDTH = 250


def histogram(
    counts: Sequence[int],
    edges: np.ndarray,
    *,
    unit: str,
    label: str,
    curves: Mapping[str, tuple[float, float]] | None = None,
    ticks: Sequence[float],
) -> str:
    """Draw a histogram of counts, with normal densities over it.

    Args:
        counts: count of each bin.
        edges: (bins + 1,) edges of the bins, evenly spaced.
        unit: unit of the edges, written under the axis.
        label: description of the chart for screen readers.
        curves: mean and standard deviation of each curve by its style class.
        ticks: values to mark on the axis.

    Returns:
        An SVG element.
    """
    low, high = float(edges[0]), float(edges[-1])
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    density = np.asarray(counts) / (max(sum(counts), 1) * float(edges[1] - edges[0]))
    values = np.linspace(low, high, 241)
    lines = {
        name: np.exp(-0.5 * ((values - mean) / deviation) ** 2) / (deviation * np.sqrt(2 * np.pi))
        for name, (mean, deviation) in (curves or {}).items()
    }
    top = 1.05 * max(density.max(), *(line.max() for line in lines.values()), 1e-9)

    def place(value: float, amount: float = 0.0) -> tuple[float, float]:
        return _LEFT + (value - low) / (high - low) * width, _TOP + (1 - amount / top) * height

    parts = []
    for start, end, amount in zip(edges[:-1], edges[1:], density, strict=True):
        if amount:
            (x, y), (right, bottom) = place(start, amount), place(end)
            parts.append(
                f'<rect class="bar" x="{x:.1f}" y="{y:.1f}" width="{max(right - x - 0.6, 0.6):.1f}" '
                f'height="{bottom - y:.1f}"/>'
            )
    for name, line in lines.items():
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(place, values, line))
        parts.append(f'<polyline class="{html.escape(name)}" points="{points}"/>')
    left, base = place(low)
    parts.append(f'<line class="axis" x1="{left:.1f}" y1="{base:.1f}" x2="{_WIDTH - _RIGHT}" y2="{base:.1f}"/>')
    for tick in ticks:
        x, _ = place(tick)
        parts.append(f'<line class="axis" x1="{x:.1f}" y1="{base:.1f}" x2="{x:.1f}" y2="{base + 4:.1f}"/>')
        parts.append(f'<text x="{x:.1f}" y="{base + 18:.1f}" text-anchor="middle">{tick:g}{html.escape(unit)}</text>')
    return _svg(_WIDTH, _HEIGHT, label, parts)


def ranges(rows: Mapping[str, Mapping[str, tuple[float, float]]], *, unit: str, label: str, high: float) -> str:
    """Draw a row of means for each name, each with a line of one standard deviation to both sides.

    Args:
        rows: mean and standard deviation by name and style class.
        unit: unit of the values.
        label: description of the chart for screen readers.
        high: end of the axis, which starts at 0.

    Returns:
        An SVG element.
    """
    width = 2 * _WIDTH
    scale = (width - _NAME_WIDTH - _RIGHT) / high
    base = _TOP + _ROW * len(rows)
    parts = []
    for tick in np.linspace(0, high, 7):
        x = _NAME_WIDTH + scale * tick
        parts.append(f'<line class="grid" x1="{x:.1f}" y1="{_TOP}" x2="{x:.1f}" y2="{base}"/>')
        parts.append(f'<text x="{x:.1f}" y="{base + 18}" text-anchor="middle">{tick:g}{html.escape(unit)}</text>')
    for number, (name, marks) in enumerate(rows.items()):
        middle = _TOP + _ROW * (number + 0.5)
        parts.append(f'<text x="{_NAME_WIDTH - 10}" y="{middle + 4:.1f}" text-anchor="end">{html.escape(name)}</text>')
        for shift, (mark, (mean, deviation)) in enumerate(marks.items()):
            y = middle + 5 * (shift - (len(marks) - 1) / 2)
            ends = np.clip([mean - deviation, mean + deviation], 0, high) * scale + _NAME_WIDTH
            parts.append(
                f'<line class="{html.escape(mark)}" x1="{ends[0]:.1f}" y1="{y:.1f}" x2="{ends[1]:.1f}" y2="{y:.1f}"/>'
                f'<circle class="{html.escape(mark)}" cx="{_NAME_WIDTH + scale * mean:.1f}" cy="{y:.1f}" r="3"/>'
            )
    return _svg(width, base + _BOTTOM, label, parts)


def fractions(counts: Mapping[str, int], *, good: str | None = None) -> str:
    """Make a table of counts with bars of their fractions of the sum.

    Args:
        counts: count of each row by name.
        good: name of the row that is not a loss, which has another colour.

    Returns:
        An HTML table.
    """
    whole = max(sum(counts.values()), 1)
    rows = []
    for name, count in counts.items():
        if not count and name != good:
            continue
        kind = "good" if name == good else "bad"
        rows.append(
            f'<tr><th scope="row">{html.escape(name)}</th><td>{count:,}</td><td>{count / whole:.1%}</td>'
            f'<td class="fraction"><span class="{kind}" style="width:{100 * count / whole:.2f}%"></span></td></tr>'
        )
    return f'<table class="fractions"><tbody>{"".join(rows)}</tbody></table>'


def table(rows: Sequence[Sequence[str]]) -> str:
    """Make an HTML table whose first row and first column are headings, and which scrolls if it is too wide.

    Args:
        rows: cells of each row.
    """
    head = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in rows[0])
    body = "".join(
        f'<tr><th scope="row">{html.escape(title)}</th>'
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for title, *cells in rows[1:]
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _svg(width: float, height: float, label: str, parts: Sequence[str]) -> str:
    text = html.escape(label)
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{text}"><title>{text}</title>'
        f"{''.join(parts)}</svg>"
    )

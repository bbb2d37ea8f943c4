"""Charts of estimates with their intervals as SVG, without a library or separate files."""

import html
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from tables.threshold_chart import COLOURS, STYLE, grid_step

_WIDTH, _LEFT, _RIGHT, _TOP, _BOTTOM = 720, 210, 24, 16, 44
_ROW, _BETWEEN = 20, 10  # heights of a line and of the space between two rows
_LEGEND = 26
_NAME_LETTERS = 28


class Mark(NamedTuple):
    """A value and the bounds of its interval; a bound is NaN if there is none, and infinite if it has no end."""

    value: float
    low: float
    high: float


def interval_chart(
    rows: Mapping[str, Mapping[str, Mark]], *, label: str, axis: str, reference: float | None = None
) -> str:
    """Draw an SVG document with a row for each name, and in it a point with its interval for each series.

    Args:
        rows: name of a row -> name of a series -> its mark; every name is escaped.
        label: description of the chart for screen readers.
        axis: title of the horizontal axis.
        reference: value at which a dashed line is drawn, such as no difference.
    """
    series = list(dict.fromkeys(name for marks in rows.values() for name in marks))
    colours = dict(zip(series, [COLOURS[(6 + number) % len(COLOURS)] for number in range(len(series))]))
    low, high, step = _range(rows, reference)
    top = _TOP + (_LEGEND if len(series) > 1 else 0)
    height_of = [_ROW * len(marks) + _BETWEEN for marks in rows.values()]
    base = top + sum(height_of)

    def across(value: float) -> float:
        return _LEFT + (min(max(value, low), high) - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT)

    parts = [f'<rect width="{_WIDTH}" height="{base + _BOTTOM}" fill="#fff"/>']
    if len(series) > 1:
        for number, name in enumerate(series):
            x = _LEFT + number * (_WIDTH - _LEFT - _RIGHT) / len(series)
            parts.append(f'<circle cx="{x + 5:.1f}" cy="{_TOP}" r="4" fill="{colours[name]}"/>')
            parts.append(f'<text x="{x + 14:.1f}" y="{_TOP + 4}">{_name(name)}</text>')
    for value in np.arange(low, high + step / 2, step):
        x = across(value)
        parts.append(f'<line class="grid" x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{base}"/>')
        parts.append(f'<text x="{x:.1f}" y="{base + 16}" text-anchor="middle">{round(value, 6):g}</text>')
    if reference is not None:
        x = across(reference)
        parts.append(f'<line class="axis" stroke-dasharray="5 4" x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{base}"/>')
    y = top
    for (name, marks), height in zip(rows.items(), height_of, strict=True):
        middle = y + height / 2
        parts.append(f'<text x="{_LEFT - 12}" y="{middle + 4:.1f}" text-anchor="end">{_name(name)}</text>')
        for number, (kind, mark) in enumerate(marks.items()):
            line = y + _BETWEEN / 2 + _ROW * (number + 0.5)
            parts += _mark(mark, line, colours[kind], across)
        y += height
    parts.append(f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{base + 36}" text-anchor="middle">{_text(axis)}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {base + _BOTTOM}" width="{_WIDTH}" '
        f'height="{base + _BOTTOM}" role="img" aria-label="{_text(label)}"><title>{_text(label)}</title>{STYLE}'
        f"{''.join(parts)}</svg>\n"
    )


def _mark(mark: Mark, y: float, colour: str, across) -> list[str]:
    if math.isnan(mark.value):
        return []
    parts = []
    if not math.isnan(mark.low) and not math.isnan(mark.high):
        ends = f'x1="{across(mark.low):.1f}" y1="{y:.1f}" x2="{across(mark.high):.1f}" y2="{y:.1f}"'
        parts.append(f'<line {ends} stroke="{colour}" stroke-width="3" stroke-opacity="0.45"/>')
        for bound in (mark.low, mark.high):
            if math.isfinite(bound):
                x = across(bound)
                parts.append(
                    f'<line x1="{x:.1f}" y1="{y - 4:.1f}" x2="{x:.1f}" y2="{y + 4:.1f}" stroke="{colour}" '
                    'stroke-width="1.5"/>'
                )
    return [*parts, f'<circle cx="{across(mark.value):.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>']


def _range(rows: Mapping[str, Mapping[str, Mark]], reference: float | None) -> tuple[float, float, float]:
    values: Sequence[float] = [value for marks in rows.values() for mark in marks.values() for value in mark]
    finite = [value for value in values if math.isfinite(value)] + ([] if reference is None else [reference])
    low, high = min(finite, default=0.0), max(finite, default=1.0)
    step = float(grid_step(max(high - low, 1e-3)))
    return float(np.floor(low / step) * step), float(np.ceil(high / step) * step + (step if low == high else 0)), step


def _name(name: str) -> str:
    return _text(name if len(name) <= _NAME_LETTERS else f"{name[: _NAME_LETTERS - 3]}...")


def _text(text: str) -> str:
    return html.escape("".join(letter if letter.isprintable() else " " for letter in text))

"""The curve as an SVG file: measures by look-ahead, with intervals, the value of the whole file apart at the right."""

import html
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tables.claims import Spread
from tables.threshold_chart import COLOURS, STYLE, grid_step

_PANEL, _ROW, _COLUMNS = 420, 280, 2
_LEFT, _RIGHT, _TOP, _BOTTOM, _LEGEND = 56, 14, 34, 50, 30
_SHIFT = 4  # distance of the curves from the middle of a look-ahead, so that their intervals can be told apart


class Panel(NamedTuple):
    """One measure.

    Attributes:
        title: title above the chart.
        curves: name of a setting -> a mean with its interval for each look-ahead; None where it is undefined.
        truth: value of ground truth, None without one.
    """

    title: str
    curves: Mapping[str, Sequence[Spread | None]]
    truth: float | None = None


def look_ahead_chart(names: Sequence[str], panels: Sequence[Panel], label: str, axis: str) -> str:
    """Draw an SVG document of panels, two in a row, with one legend.

    Args:
        names: name of each look-ahead; the last is apart from the others, and no line leads to it.
        panels: panels with the same curves.
        label: description of the chart for screen readers.
        axis: title of the horizontal axes.
    """
    curves = list(panels[0].curves)
    colours = dict(zip(curves, COLOURS[5:], strict=False))
    width = _PANEL * min(_COLUMNS, len(panels))
    height = _LEGEND + _ROW * -(-len(panels) // _COLUMNS)
    parts = [f'<rect width="{width}" height="{height}" fill="#fff"/>']
    entries = [*((name, colours[name], "") for name in curves), ("ground truth", COLOURS[0], ' stroke-dasharray="5 4"')]
    for number, (name, colour, dashes) in enumerate(entries):
        x = _LEFT + 200 * number
        parts.append(f'<line x1="{x}" y1="18" x2="{x + 26}" y2="18" stroke="{colour}" stroke-width="2"{dashes}/>')
        parts.append(f'<text x="{x + 32}" y="22">{html.escape(name)}</text>')
    for number, panel in enumerate(panels):
        x, y = _PANEL * (number % _COLUMNS), _LEGEND + _ROW * (number // _COLUMNS)
        parts += [f'<g transform="translate({x},{y})">', *_panel(names, panel, colours, axis), "</g>"]
    text = html.escape(label)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'role="img" aria-label="{text}"><title>{text}</title>{STYLE}{"".join(parts)}</svg>\n'
    )


def _panel(names: Sequence[str], panel: Panel, colours: Mapping[str, str], axis: str) -> list[str]:
    low, high, step = _range(panel)
    width, height = _PANEL - _LEFT - _RIGHT, _ROW - _TOP - _BOTTOM
    base = _TOP + height

    def across(place: int) -> float:
        return _LEFT + (place + 0.5 + 0.4 * (place == len(names) - 1)) / (len(names) + 0.5) * width

    def down(value: float) -> float:
        return _TOP + (high - value) / (high - low) * height

    parts = [f'<text class="title" x="{_LEFT}" y="{_TOP - 12}">{html.escape(panel.title)}</text>']
    for value in np.arange(low, high + step / 2, step):
        y = down(value)
        kind = "axis" if abs(value) < step / 2 else "grid"
        parts.append(f'<line class="{kind}" x1="{_LEFT}" y1="{y:.1f}" x2="{_PANEL - _RIGHT}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:.2f}</text>')
    for place, name in enumerate(names):
        parts.append(f'<text x="{across(place):.1f}" y="{base + 16}" text-anchor="middle">{html.escape(name)}</text>')
    parts.append(f'<text x="{_LEFT + width / 2}" y="{base + 36}" text-anchor="middle">{html.escape(axis)}</text>')
    if panel.truth is not None:
        y = f"{down(panel.truth):.1f}"
        line = f'x1="{_LEFT}" y1="{y}" x2="{_PANEL - _RIGHT}" y2="{y}"'
        parts.append(f'<line {line} stroke="{COLOURS[0]}" stroke-width="2" stroke-dasharray="5 4"/>')
    for number, (name, curve) in enumerate(panel.curves.items()):
        shift = _SHIFT * (2 * number - len(panel.curves) + 1)
        points = [(across(place) + shift, spread) for place, spread in enumerate(curve) if spread is not None]
        joined = [(x, spread) for x, spread in points if x < across(len(names) - 1) - _SHIFT * len(panel.curves)]
        text = " ".join(f"{x:.1f},{down(spread.mean):.1f}" for x, spread in joined)
        parts.append(f'<polyline points="{text}" stroke="{colours[name]}"/>')
        for x, spread in points:
            if spread.low is not None and spread.high is not None:
                ends = f'y1="{down(spread.low):.1f}" y2="{down(spread.high):.1f}"'
                parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" {ends} stroke="{colours[name]}" stroke-width="1.2"/>')
            parts.append(f'<circle cx="{x:.1f}" cy="{down(spread.mean):.1f}" r="3.5" fill="{colours[name]}"/>')
    return parts


def _range(panel: Panel) -> tuple[float, float, float]:
    """Return the ends of the vertical axis and the distance of its grid lines."""
    shown = [0.0] if panel.truth is None else [0.0, panel.truth]
    for curve in panel.curves.values():
        shown += [value for spread in curve if spread is not None for value in spread[:3] if value is not None]
    low, high = min(shown), max(max(shown), 0.05)
    step = grid_step(high - low)
    return float(np.floor(low / step) * step), float(np.ceil(high / step) * step), step

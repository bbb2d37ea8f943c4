"""Figure 3 as an SVG file: beat consistency of each row over the threshold of a motion beat."""

import html
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

_PANEL, _HEIGHT = 420, 300
_LEFT, _RIGHT, _TOP, _BOTTOM, _LEGEND = 56, 12, 34, 44, 190
# Okabe and Ito's colours, which people with colour vision deficiency can distinguish.
COLOURS = ("#000000", "#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#999999")
STYLE = (
    "<style>text{font:12px sans-serif;fill:#222}.axis{stroke:#222}.grid{stroke:#ddd}polyline{fill:none;stroke-width:2}"
    ".title{font-weight:bold}</style>"
)


class Panel(NamedTuple):
    """One of several charts side by side.

    Attributes:
        title: title above the chart.
        curves: name of a row -> a value for each threshold; NaN where it is undefined.
    """

    title: str
    curves: Mapping[str, Sequence[float]]


def threshold_chart(thresholds: Sequence[float], panels: Sequence[Panel], label: str) -> str:
    """Draw an SVG document of panels with the same rows and one legend.

    Args:
        thresholds: thresholds of all curves in ascending order.
        panels: panels from left to right; the first row is drawn in black.
        label: description of the chart for screen readers.
    """
    names = list(panels[0].curves)
    colours = {name: COLOURS[number % len(COLOURS)] for number, name in enumerate(names)}
    width = _PANEL * len(panels) + _LEGEND
    parts = [f'<rect width="{width}" height="{_HEIGHT}" fill="#fff"/>']
    for number, panel in enumerate(panels):
        parts += [f'<g transform="translate({_PANEL * number},0)">', *_panel(thresholds, panel, colours), "</g>"]
    for number, name in enumerate(names):
        x, y = _PANEL * len(panels) + 10, _TOP + 20 * number + 10
        parts.append(f'<line x1="{x}" y1="{y}" x2="{x + 22}" y2="{y}" stroke="{colours[name]}" stroke-width="2"/>')
        parts.append(f'<text x="{x + 28}" y="{y + 4}">{html.escape(name)}</text>')
    text = html.escape(label)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {_HEIGHT}" width="{width}" height="{_HEIGHT}" '
        f'role="img" aria-label="{text}"><title>{text}</title>{STYLE}{"".join(parts)}</svg>\n'
    )


def _panel(thresholds: Sequence[float], panel: Panel, colours: Mapping[str, str]) -> list[str]:
    values = np.array([list(curve) for curve in panel.curves.values()], float)
    finite = values[np.isfinite(values)]
    low, high = min(0.0, finite.min(initial=0.0)), max(finite.max(initial=0.0), 0.05)
    step = grid_step(high - low)
    low, high = np.floor(low / step) * step, np.ceil(high / step) * step
    width, height = _PANEL - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def place(threshold: float, value: float) -> tuple[float, float]:
        fraction = (threshold - thresholds[0]) / (thresholds[-1] - thresholds[0])
        return _LEFT + fraction * width, _TOP + (high - value) / (high - low) * height

    parts = [f'<text class="title" x="{_LEFT}" y="{_TOP - 14}">{html.escape(panel.title)}</text>']
    for value in np.arange(low, high + step / 2, step):
        _, y = place(thresholds[0], value)
        parts.append(f'<line class="grid" x1="{_LEFT}" y1="{y:.1f}" x2="{_PANEL - _RIGHT}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:.2f}</text>')
    base = _TOP + height
    parts.append(f'<line class="axis" x1="{_LEFT}" y1="{base}" x2="{_PANEL - _RIGHT}" y2="{base}"/>')
    for threshold in (thresholds[0], *(x for x in thresholds if round(100 * x) % 5 == 0)):
        x, _ = place(threshold, low)
        parts.append(f'<text x="{x:.1f}" y="{base + 16}" text-anchor="middle">{threshold:g}</text>')
    parts.append(f'<text x="{_LEFT + width / 2}" y="{base + 34}" text-anchor="middle">threshold</text>')
    for name, curve in panel.curves.items():
        points = [place(x, y) for x, y in zip(thresholds, curve, strict=True) if np.isfinite(y)]
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f'<polyline points="{text}" stroke="{colours[name]}"/>')
    return parts


def grid_step(span: float) -> float:
    """Return a round distance between grid lines that gives four to eight of them in `span`."""
    power = 10.0 ** np.floor(np.log10(span / 4))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= span / 8 and power * factor * 8 >= span)

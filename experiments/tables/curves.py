"""Draw the curves of the reports: panels with one legend, as an SVG document."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ha2g_jax.evaluation.charts import COLOURS, Mark, as_svg, draw_marks, literal, make_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = 2  # of panels


class Panel(NamedTuple):
    """Curves of one measure.

    Attributes:
        title: title above the chart.
        curves: name of a curve -> a mark for each place on the horizontal axis; a value is NaN where it is undefined.
        reference: value of a dashed line, such as that of ground truth.
    """

    title: str
    curves: Mapping[str, Sequence[Mark]]
    reference: float | None = None


def curve_chart(
    panels: Sequence[Panel], places: Sequence[float | str], *, label: str, axis: str, is_last_apart: bool = False
) -> str:
    """Draw an SVG document of panels with the same curves, two in a row, with one legend.

    Args:
        panels: panels in the order of reading.
        places: places of the marks of all curves in ascending order, numbers or names.
        label: description of the chart for screen readers.
        axis: title of the horizontal axes.
        is_last_apart: whether the last place is apart from the others, so that no line leads to it.
    """
    names = [str(place) for place in places] if isinstance(places[0], str) else None
    across = np.arange(len(places), dtype=float) if names else np.array(places, float)
    if is_last_apart:
        across[-1] += 0.4
    figure, grid = make_figure(
        8, 2.9 * -(-len(panels) // _COLUMNS), min(_COLUMNS, len(panels)), -(-len(panels) // _COLUMNS)
    )
    every = [axes for row in grid for axes in row]
    for panel, axes in zip(panels, every, strict=False):
        _draw_panel(axes, panel, across, is_last_apart)
        axes.set_title(literal(panel.title), fontsize=10, loc="left")
        axes.set_xlabel(literal(axis))
        if names:
            axes.set_xticks(across, [literal(name) for name in names])
    for axes in every[len(panels) :]:
        axes.set_visible(False)
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return as_svg(figure, label)


def _draw_panel(axes: "Axes", panel: Panel, across: np.ndarray, is_last_apart: bool) -> None:
    width = 0.06 * float(np.diff(across).min(initial=1)) if len(across) > 1 else 0
    for count, (name, curve) in enumerate(panel.curves.items()):
        colour, shift = COLOURS[count % len(COLOURS)], width * (count - (len(panel.curves) - 1) / 2)
        has_bounds = any(math.isfinite(mark.low) for mark in curve)
        joined = slice(None, -1 if is_last_apart else None)
        values = np.array([mark.value for mark in curve])
        line_name = None if has_bounds else literal(name)
        places = across + (shift if has_bounds else 0)
        axes.plot(places[joined], values[joined], color=colour, linewidth=1.6, label=line_name)
        if has_bounds:
            draw_marks(axes, dict(zip(places.tolist(), curve, strict=True)), colour, name, is_horizontal=False)
    if panel.reference is not None:
        axes.axhline(panel.reference, color="#222222", linewidth=1.2, linestyle="--", label="ground truth")

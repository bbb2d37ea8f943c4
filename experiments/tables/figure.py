"""Figure 3 of a reproduction: beat consistency over the threshold of a motion beat, as a chart and as a table."""

import math
from collections.abc import Sequence

import numpy as np

from tables.paper_tables import THRESHOLDS
from tables.run_estimates import MODEL, TRUTH
from tables.tables import RowScores, markdown, number
from tables.threshold_chart import Panel, threshold_chart

_CURVES = {"BC": "BC (Eq. 11)", "F": "F with the own speech", "gain": "gain over mismatched speech"}
_SHOWN = (0.01, 0.03, 0.1, 0.2, 0.3)  # thresholds in the table


def chart(scores: RowScores, split: str, title: str) -> str:
    """Draw an SVG document of BC, as Figure 3 has it, of F and of its gain by threshold, as means over seeds.

    Args:
        scores: name of a row -> seed -> scores.
        split: name of the split.
        title: description of the chart.
    """
    curves = _curves(scores, split)
    panels = [
        Panel(title, {name: values[key].tolist() for name, values in curves.items()}) for key, title in _CURVES.items()
    ]
    return threshold_chart(THRESHOLDS, panels, title)


def sweep_table(scores: RowScores, split: str) -> str:
    """Write the values of `chart` at a few thresholds as a Markdown table.

    Args:
        scores: name of a row -> seed -> scores.
        split: name of the split.
    """
    lines = [("row", *(f"{name} at {threshold:g}" for name in _CURVES for threshold in _SHOWN))]
    places = [THRESHOLDS.index(threshold) for threshold in _SHOWN]
    for name, curves in _curves(scores, split).items():
        lines.append((name, *(number(float(curves[key][place])) for key in _CURVES for place in places)))
    return markdown(lines)


def _curves(scores: RowScores, split: str) -> dict[str, dict[str, np.ndarray]]:
    """Return `_CURVES` by threshold for each row, ground truth first."""
    curves: dict[str, dict[str, np.ndarray]] = {}
    for row, mine in scores.items():
        sweeps = [one["splits"][split]["sweep"] for one in mine.values()]
        for name, key in ((TRUTH, TRUTH), (row, MODEL)):
            if sweeps and name not in curves:
                paper, own, floor = (
                    np.array([_numbers(each[key][part]) for each in sweeps]).mean(axis=0)
                    for part in ("consistency", "own", "mismatched")
                )
                curves[name] = {"BC": paper, "F": own, "gain": own - floor}
    return curves


def _numbers(values: Sequence[float | None]) -> list[float]:
    return [math.nan if value is None else value for value in values]

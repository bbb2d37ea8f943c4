"""Figure 3 is a whole SVG document, with every curve where its values are."""

import itertools
import math
import xml.etree.ElementTree as ElementTree

import pytest
from tables.threshold_chart import Panel, threshold_chart

_SVG = "{http://www.w3.org/2000/svg}"
_THRESHOLDS = [0.01, 0.02, 0.03, 0.04, 0.05]


def _lines(svg):
    lines = ElementTree.fromstring(svg).iter(f"{_SVG}polyline")
    return [[tuple(map(float, point.split(","))) for point in line.get("points", "").split()] for line in lines]


def test_curves_are_drawn_to_scale():
    panels = (
        Panel("F", {"a": [0.0, 0.1, 0.2, 0.3, 0.4], "b<": [0.4, 0.4, math.nan, 0.4, 0.4]}),
        Panel("gain", {"a": [-0.1, 0, 0.1, 0.2, 0.2], "b<": [0.0] * 5}),
    )
    svg = threshold_chart(_THRESHOLDS, panels, "Figure <3>")
    rising, flat, negative, _ = _lines(svg)
    steps = [before[1] - after[1] for before, after in itertools.pairwise(rising)]
    assert steps == pytest.approx([steps[0]] * 4, abs=0.11) and steps[0] > 20
    assert len(flat) == 4 and len({y for _, y in flat}) == 1
    assert flat[0][1] == rising[-1][1]
    assert negative[0][1] > negative[1][1]  # below zero is farther down
    texts = [element.text for element in ElementTree.fromstring(svg).iter(f"{_SVG}text")]
    assert "b<" in texts and "gain" in texts


@pytest.mark.parametrize("values", [[0.0] * 5, [math.nan] * 5, [1e-6] * 5, [30.0] * 5])
def test_any_range_has_a_scale(values):
    (line,) = _lines(threshold_chart(_THRESHOLDS, (Panel("F", {"a": values}),), "one"))
    assert all(0 <= y <= 300 for _, y in line)

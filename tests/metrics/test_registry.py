"""The table of metrics has every name once, and refuses a name that it lacks."""

import subprocess
import sys

import pytest

from ha2g_jax import metrics
from ha2g_jax.errors import UserError
from ha2g_jax.metrics.metric import Metric


def test_every_metric_is_complete_and_stands_under_its_name():
    for name, metric in metrics.METRICS.items():
        assert isinstance(metric, Metric) and metric.name == name
        assert metric.title and metric.group and callable(metric.measure)
        assert metric.direction in ("higher", "lower", "none") and metric.digits >= 0


def test_no_two_columns_of_a_section_have_one_heading():
    for section in ("rows", "legacy_v1", "known_causes", "recording", "beat2"):
        found = metrics.of_section(section)
        headings = [metric.heading for metric in found.values()]
        assert headings and len(set(headings)) == len(headings)


def test_a_name_that_is_not_registered_is_an_error():
    assert metrics.lookup("fgd").title == "FGD"
    with pytest.raises(UserError, match="no metric is registered as 'hand_speed'; add it to _REGISTERED"):
        metrics.lookup("hand_speed")


def test_metrics_start_no_accelerator_library():
    code = "import sys, ha2g_jax.metrics; print([name for name in ('jax', 'librosa', 'scipy') if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"

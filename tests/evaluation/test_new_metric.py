"""A metric is one definition and one line of the table of metrics: it then stands in every form of the results."""

import numpy as np
import pytest

from ha2g_jax import metrics
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.evaluation.scoring import make_results
from ha2g_jax.evaluation.table import as_markdown, as_table
from ha2g_jax.metrics.metric import MOVEMENT, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, mean_over_clips


def hand_speed(row: Row) -> Statistic:
    """Mean speed of the wrists in m/s."""
    skeleton = row.reference.skeleton
    hands = [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]
    steps = [np.diff(positions[SEED_FRAMES:, hands], axis=0) for positions in row.positions]
    speeds = [np.linalg.norm(step, axis=-1).mean() * row.reference.fps for step in steps]
    return mean_over_clips(row, speeds, row.num_scored)


HAND_SPEED = Metric(
    name="hand_speed",
    title="hand speed",
    unit="m/s",
    direction="none",
    group=MOVEMENT,
    digits=2,
    measure=hand_speed,
    is_paired=True,
)


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setitem(metrics.METRICS, HAND_SPEED.name, HAND_SPEED)


def test_a_registered_metric_is_a_column(registered, skeleton, perform):
    rows = {"same": perform(6), "late": perform(6, delay=0.25)}
    section = evaluate(rows, perform(6), skeleton, draws=10)
    assert section["rows"]["same"]["hand_speed"]["value"] == section["rows"]["ground truth"]["hand_speed"]["value"] > 0
    assert section["rows"]["frozen"]["hand_speed"]["value"] == 0
    assert section["differences"]["late - same"]["hand_speed"]["value"] != 0
    results = make_results({}, {"all": section})
    assert results["metrics"]["hand_speed"] == {"title": "hand speed", "unit": "m/s", "direction": "none"}
    assert "hand speed m/s" in as_table(results) and "| hand speed m/s |" in as_markdown(results)

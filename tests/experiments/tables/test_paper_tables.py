"""The published numbers are those of the paper, and every row is a config that can be made."""

import pytest
from tables.paper_tables import EQUAL, TABLES, Published, table

from ha2g_jax.config import presets
from ha2g_jax.errors import UserError


def _row(found, name):
    return next(row for row in found.rows if row.name == name)


@pytest.mark.parametrize(
    ("name", "data", "row", "numbers"),
    [
        ("table1", "ted_expressive", "Trimodal", (12.613, 0.592, 154.088)),
        ("table1", "ted_gesture", "Speech2Gesture", (19.254, 0.764, 98.095)),
        ("table1", "talk", "HA2G", (5.306, 0.715, 173.899)),
        ("table3", "talk", "HA2G without text", (9.228, 0.619, 158.236)),
        ("table4", "talk", "without hand hierarchy", (10.832, 0.606, 158.823)),
        ("table11", "talk", "M = 7", (5.177, 0.715, 174.313)),
        ("gesture_ablation", "ted_gesture", "HA2G-ASR", (3.091, None, None)),
    ],
)
def test_published_values(name, data, row, numbers):
    assert _row(table(name, data), row).published == numbers


@pytest.mark.parametrize(("name", "count"), list(zip(TABLES, (5, 5, 8, 6, 3, 1, 5, 5), strict=True)))
def test_rows_are_whole_and_can_be_made(name, count):
    data = {"gesture_ablation": "ted_gesture", EQUAL: "talk"}.get(name, "ted_expressive")
    found = table(name, data, "debug")
    assert len(found.rows) == len({row.name for row in found.rows}) == count
    assert found.reference in {row.name for row in found.rows}
    for row in found.rows:
        config = presets.make(data, "debug", row.method, row.changes)
        assert config.method == row.method


def test_rows_of_equal_inputs_say_that_they_are_not_the_paper_s():
    *others, last = table(EQUAL, "talk", "small").rows
    assert (last.name, last.changes) == ("HA2G", {})
    assert all(row.name.endswith(", equal inputs and size") and row.published == Published() for row in others)
    for data, size, expected in [
        ("video", "small", "give --data talk"),
        ("talk", "paper", "medium, small, study, debug"),
    ]:
        with pytest.raises(UserError, match=expected):
            table(EQUAL, data, size)


def test_the_full_model_is_one_config_in_all_tables():
    full = [("table1", "HA2G"), ("table3", "HA2G Full"), ("table4", "HA2G Full"), ("table11", "M = 4")]
    rows = [_row(table(name, "talk"), row) for name, row in full]
    assert {row.published for row in rows} == {Published(5.306, 0.715, 173.899)}
    assert all(row.method == "ha2g" and not row.changes for row in rows)


def test_the_paper_s_order_is_in_the_data():
    """Whoever is the reference is ahead in FGD of every row that the paper calls worse."""
    for name in ("table1", "table3", "table4", "table11"):
        found = table(name, "talk")
        rows = [row for row in found.rows if row.published != Published()]
        others = [row for row in rows if row.name != found.reference and not row.is_comparable]
        best = _row(found, found.reference).published.fgd
        assert best and all(row.published.fgd and row.published.fgd > best for row in others)
    assert {row.name for row in table("table3", "talk").rows if row.is_comparable} == {"HA2G-ASR"}

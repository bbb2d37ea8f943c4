"""Flags of an evaluation: metrics that a sanity row wins, and motion that beats too often or too seldom."""

from collections.abc import Mapping, Sequence
from typing import Any

from ha2g_jax import metrics
from ha2g_jax.metrics.sanity import HALF, SANITY_ROWS, TRUTH

MANY = 1.3  # times as many beats as ground truth, which jitter makes; dense beats are near some onset by chance
FEW = 0.5

_BY_CHANCE = (TRUTH, HALF)


def flags(rows: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> list[str]:
    """Return the flags as sentences, those of the metrics first.

    Args:
        rows: {row: {metric: {"value", "low", "high"}}}.
        methods: names of the rows of methods.
    """
    return [*_won_metrics(rows), *_beat_rates(rows, methods)]


def _won_metrics(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each metric in which a sanity row goes further in the "better" direction than truth."""
    sentences = []
    for key, metric in metrics.of_section("rows").items():
        true = _value(rows[TRUTH], key)
        if metric.direction == "none" or true is None:
            continue
        sign = 1 if metric.direction == "higher" else -1
        found = {name: _value(rows.get(name, {}), key) for name in SANITY_ROWS if name not in _BY_CHANCE}
        winners = [
            f"{name} ({value:.{metric.digits}f})"
            for name, value in found.items()
            if value is not None and round(sign * (value - true), metric.digits) > 0
        ]
        if winners:
            sentences.append(
                f"{metric.heading}: {', '.join(winners)} {metric.direction} than ground truth "
                f"({true:.{metric.digits}f}), so {metric.direction} is not better"
            )
    return sentences


def _beat_rates(rows: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> list[str]:
    true = _value(rows[TRUTH], "beats_per_second")
    sentences = []
    for name in methods:
        rate = _value(rows[name], "beats_per_second")
        if not true or rate is None or FEW * true <= rate <= MANY * true:
            continue
        found = f"{name}: {rate:.2f} beats/s, ground truth {true:.2f}"
        jerk = _value(rows[name], "jerk_ratio")
        if rate < true:
            sentences.append(f"{found}: far fewer, whatever the F")
        else:
            rough = "" if jerk is None else f", and {jerk:.1f} times its jerk"
            sentences.append(f"{found}{rough}: its F and BC are those of dense beats")
    return sentences


def _value(row: Mapping[str, Any], key: str) -> float | None:
    return row[key]["value"] if key in row else None

"""What a reader of an evaluation must be told: metrics that a sanity row wins, and motion that beats far too often."""

from collections.abc import Mapping, Sequence
from typing import Any

from ha2g_jax.study.evaluation.metrics import HALF, METRICS, NEITHER, SANITY_ROWS, TRUTH

FAR = 2.0  # times as many beats as ground truth, or as few

_BY_CHANCE = (TRUTH, HALF)


def flags(rows: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> list[str]:
    """Sentences, the metrics first.

    Args:
        rows: {row: {metric: {"value", "low", "high"}}}.
        methods: names of the rows that are evaluated.
    """
    return [*_won_metrics(rows), *_beat_rates(rows, methods)]


def _won_metrics(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Metrics in which a sanity row is further in the "better" direction than ground truth."""
    sentences = []
    for key, metric in METRICS.items():
        true = _value(rows[TRUTH], key)
        if metric.better == NEITHER or true is None:
            continue
        found = {name: _value(rows.get(name, {}), key) for name in SANITY_ROWS if name not in _BY_CHANCE}
        winners = [
            f"{name} ({value:.{metric.digits}f})"
            for name, value in found.items()
            if value is not None and round(metric.better * (value - true), metric.digits) > 0
        ]
        if winners:
            direction = "higher" if metric.better > 0 else "lower"
            sentences.append(
                f"{metric.title}: {', '.join(winners)} {direction} than ground truth ({true:.{metric.digits}f}), so "
                f"{direction} is not better"
            )
    return sentences


def _beat_rates(rows: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> list[str]:
    true = _value(rows[TRUTH], "beats_per_second")
    sentences = []
    for name in methods:
        rate = _value(rows[name], "beats_per_second")
        if true and rate is not None and not true / FAR <= rate <= true * FAR:
            sentences.append(f"{name}: {rate:.2f} beats/s, ground truth {true:.2f}: far from it, whatever its F")
    return sentences


def _value(row: Mapping[str, Any], key: str) -> float | None:
    return row[key]["value"] if key in row else None

"""Flags of an evaluation: metrics that a sanity row wins, and motion that beats far too often."""

from collections.abc import Mapping, Sequence
from typing import Any

from ha2g_jax import metrics
from ha2g_jax.metrics.sanity import HALF, SANITY_ROWS, TRUTH

FAR = 2.0  # times as many beats as ground truth, or as few

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
        if true and rate is not None and not true / FAR <= rate <= true * FAR:
            sentences.append(f"{name}: {rate:.2f} beats/s, ground truth {true:.2f}: far from it, whatever the F")
    return sentences


def _value(row: Mapping[str, Any], key: str) -> float | None:
    return row[key]["value"] if key in row else None

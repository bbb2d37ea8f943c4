"""Single numbers from the stored scores of a run, and their means over seeds."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tables.claims import Measured, Spread, over_seeds

MODEL, TRUTH = "model", "ground truth"


class Estimate(NamedTuple):
    """A value of one run and its interval over clips.

    Attributes:
        value: value of the run.
        low: lower bound of the interval, None without an interval.
        high: upper bound of the interval, None without an interval.
    """

    value: float
    low: float | None
    high: float | None


class Cell(NamedTuple):
    """A value of a row.

    Attributes:
        seeds: mean and interval over seeds.
        low: mean over seeds of the lower bounds of the intervals over clips, or None.
        high: mean over seeds of the upper bounds of the intervals over clips, or None.
    """

    seeds: Spread
    low: float | None
    high: float | None


Scores = Mapping[str, Any]


def estimate(scores: Scores, split: str, metric: str, row: str = MODEL) -> Estimate | None:
    """Look up one number in the scores that `run_scores` stored.

    Args:
        scores: of one run.
        split: of the corpus.
        metric: name of a metric of `evaluation`, "legacy_..." included; or "talk.NAME" with one of the known
            causes; or "talk.floor" and "talk.above_floor": the better of the two floors of the hand shapes, and how far
            the row is above it.
        row: `MODEL`, or one that stands beside every model.
    """
    result = scores["splits"][split]
    if metric.startswith("legacy_"):
        legacy = result["evaluation"].get("legacy_v1", {"rows": {}})
        return _interval(legacy["rows"].get(row, {}).get(metric))
    if not metric.startswith("talk."):
        return _interval(result["evaluation"]["rows"].get(row, {}).get(metric))
    name = metric.removeprefix("talk.")
    talk = result.get("talk")
    if talk is None:
        return None
    if name not in ("floor", "above_floor"):
        return _interval(talk["rows"].get(row, {}).get(name))
    floors = [talk["rows"].get(floor, {}).get("semantic_recall") for floor in ("majority", "shuffled")]
    values = [floor["value"] for floor in floors if floor and floor["value"] is not None]
    shown = _interval(talk["rows"].get(row, {}).get("semantic_recall"))
    if not values or shown is None:
        return None
    floor = max(values)
    return Estimate(floor if name == "floor" else shown.value - floor, None, None)


def by_seed(scores: Mapping[int, Scores], split: str, metric: str) -> dict[int, Measured]:
    """Return a metric of the model by seed, without seeds for which it is undefined; see `estimate`.

    Known causes, where they have been measured so, come with the values without each speaker.
    """
    found = {seed: estimate(one, split, metric) for seed, one in scores.items()}
    return {
        seed: Measured(each.value, _without_speakers(scores[seed], split, metric))
        for seed, each in found.items()
        if each is not None
    }


def _without_speakers(scores: Scores, split: str, metric: str) -> np.ndarray:
    talk = scores["splits"][split].get("talk", {})
    values = talk.get("without_speakers", {}).get(metric.removeprefix("talk."), {})
    return np.array([values[speaker] for speaker in sorted(values)], float)  # NaN for None


def cell(scores: Mapping[int, Scores], split: str, metric: str, row: str = MODEL) -> Cell | None:
    """Return the value of a row over its seeds, or None where no seed has one; see `estimate`."""
    found = [estimate(one, split, metric, row) for one in scores.values()]
    there = [each for each in found if each is not None]
    if not there:
        return None
    lows, highs = ([getattr(each, bound) for each in there] for bound in ("low", "high"))
    return Cell(over_seeds([each.value for each in there]), _mean(lows), _mean(highs))


def _interval(values: Mapping[str, float | None] | None) -> Estimate | None:
    if values is None or values["value"] is None:
        return None
    return Estimate(values["value"], values.get("low"), values.get("high"))


def _mean(bounds: Sequence[float | None]) -> float | None:
    there = [bound for bound in bounds if bound is not None]
    return float(np.mean(there)) if len(there) == len(bounds) else None

"""Tables of a reproduction from the stored scores of its runs: those of its page and the file of all numbers."""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.evaluation.charts import markdown, number
from ha2g_jax.metrics.sanity import MISMATCHED, TRUTH
from tables.claims import HELD, NOT_HELD, Claim, Measured, Spread, Verdict, judge, over_seeds, paired
from tables.paper_tables import GROUND_TRUTH, TABLE_12, Row, Table

MODEL = "model"

Scores = Mapping[str, Any]  # of one run, as `scores.score_run` stores them
RowScores = Mapping[str, Mapping[int, Scores]]  # name of a row -> seed -> scores
Claimed = Mapping[str, tuple[str, bool]]

# Metric -> its title, and whether a higher value is better in the paper's claim.
CLAIMED: Claimed = {"fgd": ("FGD", False), "beat_gain": ("beat gain", True)}
CLAIMED_ON_TALK: Claimed = {
    "talk.beat_f1_gain": ("beat F1 gain", True),
    "talk.finger_correlation": ("fingers r", True),
}
SHOWN = {
    "fgd": "FGD",
    "beat_consistency": "BC",
    "beat_gain": "beat gain",
    "beats_per_second": "beats/s",
    "jerk_ratio": "jerk / truth",
    "diversity_l1": "diversity",
}
SHOWN_ON_TALK = {
    "talk.beat_f1_gain": "beat F1 gain",
    "talk.finger_correlation": "fingers r",
    "talk.above_floor": "words above floor",
    "talk.style_handedness": "handedness r",
}
_TEACHER = "teacher"
_HEAD = ("kind", "split", "row", "metric", "value", "low", "high", "clips_low", "clips_high", "p", "verdict", "seeds")


class Estimate(NamedTuple):
    """A metric of one run with the bounds of its interval over clips, where it has one."""

    value: float
    low: float | None = None
    high: float | None = None


class Cell(NamedTuple):
    """A value of a row.

    Attributes:
        seeds: mean and interval over seeds.
        low, high: means over seeds of the bounds of the intervals over clips, or None.
    """

    seeds: Spread
    low: float | None
    high: float | None
    values: Mapping[int, float]


def estimate(scores: Scores, split: str, metric: str, row: str = MODEL) -> Estimate | None:
    """Look up one metric of one run, None where it is undefined.

    Args:
        metric: name of a metric of `evaluation`, "legacy_..." included; or "talk.NAME" with one of the known
            causes; or "talk.floor" and "talk.above_floor": the better of the two floors of the hand shapes, and how far
            the row is above it.
        row: `MODEL`, or a row that is scored with every model.
    """
    result, name = scores["splits"][split], metric.removeprefix("talk.")
    if name == metric:
        part = result["evaluation"]
        part = part.get("legacy_v1", {"rows": {}}) if metric.startswith("legacy_") else part
        return _defined(part["rows"].get(row, {}).get(metric))
    rows = result.get("talk", {"rows": {}})["rows"]
    if name not in ("floor", "above_floor"):
        return _defined(rows.get(row, {}).get(name))
    floors = [_defined(rows.get(floor, {}).get("semantic_recall")) for floor in ("majority", "shuffled")]
    values = [floor.value for floor in floors if floor]
    shown = _defined(rows.get(row, {}).get("semantic_recall"))
    if not values or shown is None:
        return None
    return Estimate(max(values) if name == "floor" else shown.value - max(values))


def _defined(score: Mapping[str, Any] | None) -> Estimate | None:
    if score is None or score["value"] is None:
        return None
    return Estimate(score["value"], score["low"], score["high"])


def by_seed(scores: Mapping[int, Scores], split: str, metric: str) -> dict[int, Measured]:
    """Return a metric of the model by seed, without seeds for which it is undefined; see `estimate`.

    Known causes, where they have been measured so, come with the values without each speaker.
    """
    found = {}
    for seed, one in scores.items():
        if (score := estimate(one, split, metric)) is not None:
            speakers = one["splits"][split].get("talk", {}).get("without_speakers", {})
            values = speakers.get(metric.removeprefix("talk."), {})
            without = np.array([values[speaker] for speaker in sorted(values)], float)  # NaN for None
            found[seed] = Measured(score.value, without)
    return found


def cell(scores: Mapping[int, Scores], split: str, metric: str, row: str = MODEL) -> Cell | None:
    """Return the value of a row over its seeds, or None where no seed has one; see `estimate`."""
    found = {seed: estimate(one, split, metric, row) for seed, one in scores.items()}
    there = {seed: each for seed, each in found.items() if each is not None}
    if not there:
        return None
    values = {seed: each.value for seed, each in there.items()}
    low, high = _mean([each.low for each in there.values()]), _mean([each.high for each in there.values()])
    return Cell(over_seeds(list(values.values())), low, high, values)


def _mean(bounds: Sequence[float | None]) -> float | None:
    there = [bound for bound in bounds if bound is not None]
    return float(np.mean(there)) if len(there) == len(bounds) else None


def main_table(table: Table, scores: RowScores, split: str, columns: Mapping[str, str]) -> str:
    """Write the table of the paper's numbers and ours, with the rows that are scored with every model.

    Args:
        scores: name of a row -> seed -> scores.
        columns: metric -> title.
    """
    head = ("row", "paper: FGD, BC, diversity", *columns.values(), "seeds")
    truth = Row(GROUND_TRUTH, "", {}, table.truth)
    lines = [head, _main_line(truth, any_row(scores), split, columns, TRUTH)]
    lines += [_main_line(row, scores.get(row.name, {}), split, columns, MODEL) for row in table.rows]
    for title, key, mine in other_rows(table, scores, split):
        found = {metric: cell(mine, split, metric, key) for metric in _measured(title, columns)}
        cells = (number(each.seeds.mean) if (each := found.get(metric)) else "-" for metric in columns)
        lines.append((f"*{title}*", "", *cells, ""))
    return markdown(lines)


def _main_line(row: Row, scores: Mapping[int, Scores], split: str, columns: Iterable[str], key: str) -> tuple[str, ...]:
    published = ", ".join(number(value) for value in row.published if value is not None)
    cells = (_text(cell(scores, split, metric, key)) for metric in columns)
    return row.name, published, *cells, "" if key == TRUTH else str(len(scores))


def _text(found: Cell | None) -> str:
    """Format a value as its mean and half its interval over seeds."""
    return "-" if found is None else plus_minus(found.seeds)


def plus_minus(spread: Spread) -> str:
    """Format a mean and half its interval."""
    mean, low, high, _ = spread
    return number(mean) if low is None or high is None else f"{number(mean)} ±{number((high - low) / 2)}"


def claim_table(table: Table, scores: RowScores, split: str, metrics: Claimed) -> str:
    """Write the differences that test the claims, a line for each row and a column for each metric."""
    lines = {row.name: [row.name] for row in table.rows if row.name != table.reference}
    for row, _, verdict in verdicts(table, scores, split, metrics):
        said = f"**{verdict.verdict}** {spread_text(verdict.difference)}"
        lines[row.name].append(said if verdict.p_value is None else f"{said}, {_p(verdict.p_value)}")
    return markdown([(f"{table.reference} less", *(title for title, _ in metrics.values())), *lines.values()])


def tally(table: Table, scores: RowScores, split: str, metrics: Claimed) -> str:
    """Count the verdicts on the claims for each metric, as text; see `claim_table`."""
    texts = []
    for metric, (title, _) in metrics.items():
        found = Counter(verdict.verdict for _, own, verdict in verdicts(table, scores, split, metrics) if own == metric)
        texts.append(f"{title} " + ", ".join(f"{count} {verdict}" for verdict, count in found.items()))
    return "; ".join(texts)


def verdicts(table: Table, scores: RowScores, split: str, metrics: Claimed) -> Iterator[tuple[Row, str, Verdict]]:
    """Yield row, metric and verdict of all claims of a split, which are tested together."""
    compared = [(row, metric) for row in table.rows if row.name != table.reference for metric in metrics]
    claims = []
    for row, metric in compared:
        reference, other = (by_seed(scores.get(name, {}), split, metric) for name in (table.reference, row.name))
        claims.append(Claim(paired(reference, other), metrics[metric][1], row.is_comparable))
    for (row, metric), verdict in zip(compared, judge(claims), strict=True):
        yield row, metric, verdict


def floor_line(table: Table, scores: RowScores, split: str) -> str:
    """Say which rows show the hand shapes of words more often than the floors do."""
    above = [by_seed(scores.get(row.name, {}), split, "talk.above_floor") for row in table.rows]
    found = judge([Claim(paired(one, dict.fromkeys(one, Measured(0.0))), is_higher_better=True) for one in above])
    rows = {
        said: ", ".join(row.name for row, each in zip(table.rows, found, strict=True) if each.verdict == verdict)
        for said, verdict in (("above the floors", HELD), ("below", NOT_HELD))
    }
    return "Hand shapes of words: " + "; ".join(f"{said}: {names or 'none'}" for said, names in rows.items()) + "."


def every_number(
    table: Table, scores: RowScores, splits: Sequence[str], metrics: Claimed, more: Iterable[Sequence[str]]
) -> str:
    """Write all scores with their intervals and the value of each seed, and all differences, as CSV.

    Args:
        scores: name of a row -> seed -> scores.
        more: further lines, kind and text.
    """
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n").writerow
    write(_HEAD)
    for split in splits:
        rows = [(GROUND_TRUTH, TRUTH, any_row(scores))]
        rows += [(row.name, MODEL, scores.get(row.name, {})) for row in table.rows]
        for title, key, mine in [*rows, *other_rows(table, scores, split)]:
            is_of_models = key == MODEL or title == _performed(table)
            for metric in _measured(title, _metrics(mine, split, key)):
                if (found := cell(mine, split, metric, key)) is not None:
                    value = _three(found.seeds if is_of_models else found.seeds._replace(low=None, high=None))
                    values = _seeds(found.values if is_of_models else {})
                    write(("score", split, title, metric, *value, found.low, found.high, "", "", values))
        for row, metric, verdict in verdicts(table, scores, split, metrics):
            name, found = f"{table.reference} - {row.name}", verdict.difference
            write(("difference", split, name, metric, *_three(found), "", "", verdict.p_value, verdict.verdict, ""))
    for line in more:
        write(line)
    return out.getvalue()


def _metrics(scores: Mapping[int, Scores], split: str, key: str) -> list[str]:
    """Return the names of all metrics of a row, in the order in which they are stored."""
    found: dict[str, None] = {}
    for one in scores.values():
        result = one["splits"][split]
        found |= dict.fromkeys(result["evaluation"]["rows"].get(key, {}))
        found |= dict.fromkeys(result["evaluation"].get("legacy_v1", {"rows": {}})["rows"].get(key, {}))
        known = [f"talk.{name}" for name in result.get("talk", {"rows": {}})["rows"].get(key, {})]
        found |= dict.fromkeys(
            [*known, *(["talk.floor", "talk.above_floor"] if "talk.semantic_recall" in known else [])]
        )
    return list(found)


def _three(spread: Spread | None) -> tuple[float | None, ...]:
    return (None, None, None) if spread is None else (spread.mean, spread.low, spread.high)


def _seeds(values: Mapping[int, float]) -> str:
    return "; ".join(f"{seed}: {value!r}" for seed, value in values.items())


def draws_table(scores: RowScores, split: str) -> str:
    """Write Table 12, the diversity in ten random draws of pairs."""
    groups: dict[str, Sequence[float]] = {"paper, TED-Expressive": TABLE_12}
    for name, mine in scores.items():
        for seed, one in mine.items():
            draws = one["splits"][split]["draws"]
            if draws[TRUTH]:  # empty where no two windows are of different recordings
                groups.setdefault(TRUTH, draws[TRUTH])
                groups[f"{name}, seed {seed}"] = draws[MODEL]
    lines = [("group", *map(str, range(1, len(TABLE_12) + 1)), "mean", "range / mean")]
    for name, values in groups.items():
        lines.append((name, *map(number, values), number(float(np.mean(values))), f"{_relative_range(values):.2%}"))
    return markdown(lines)


def draws_verdict(scores: RowScores, split: str) -> str:
    """Say whether our draws are as close together as those of the paper."""
    draws = [one["splits"][split]["draws"] for mine in scores.values() for one in mine.values()]
    ranges = [_relative_range(own) for each in draws for own in each.values() if own]
    if not ranges:
        return "No two windows are of different recordings, so that there are no draws."
    if not any(ranges):
        return "All draws are the same: there are no more than 500 pairs of different recordings."
    widest, published = max(ranges), _relative_range(TABLE_12)
    return f"The widest range is {widest:.2%} of the mean, {'within' if widest <= published else 'beyond'} the paper's."


def _relative_range(draws: Sequence[float]) -> float:
    mean = np.mean(draws)
    return float(np.ptp(draws) / mean) if mean else 0.0


def other_rows(table: Table, scores: RowScores, split: str) -> list[tuple[str, str, Mapping[int, Scores]]]:
    """Return title, name and scores of the rows that are scored with every model.

    The row of mismatched speech is the true motion for the metrics of sound. For those of known causes it is the motion
    of the reference, and has its own title.
    """
    one = next(iter(any_row(scores).values()), None)
    if one is None:
        return []
    result = one["splits"][split]
    rows = [(name, name, any_row(scores)) for name in result["evaluation"]["rows"] if name not in (MODEL, TRUTH)]
    if "talk" in result:
        rows.append((_TEACHER, _TEACHER, any_row(scores)))
        rows.append((_performed(table), MISMATCHED, scores.get(table.reference) or any_row(scores)))
    return rows


def _performed(table: Table) -> str:
    return f"{table.reference}, {MISMATCHED}"


def _measured(title: str, metrics: Iterable[str]) -> list[str]:
    """Return the metrics of a row of `other_rows`."""
    if title == MISMATCHED:
        return [metric for metric in metrics if not metric.startswith("talk.")]
    if title.endswith(f", {MISMATCHED}"):
        return [metric for metric in metrics if metric.startswith("talk.")]
    return list(metrics)


def any_row(scores: RowScores) -> Mapping[int, Scores]:
    """Return the scores of one run, because the rows that are scored with every model are the same in all runs."""
    return next(({seed: one} for mine in scores.values() for seed, one in mine.items()), {})


def spread_text(spread: Spread | None) -> str:
    """Format a mean over seeds with its interval, such as "0.412 [0.380, 0.444]"; "-" for None."""
    if spread is None:
        return "-"
    if spread.low is None:
        return number(spread.mean)
    return f"{number(spread.mean)} [{number(spread.low)}, {number(spread.high)}]"


def _p(value: float) -> str:
    return "p<0.001" if value < 1e-3 else f"p={value:.3f}"

"""Markdown tables of a reproduction: the paper's numbers beside ours, the scores of Talk, claims, and draws."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from ha2g_jax.evaluation import retrieval
from tables.claims import (
    HELD,
    NOT_HELD,
    Claim,
    Measured,
    Spread,
    Verdict,
    judge,
    paired,
)
from tables.paper_tables import GROUND_TRUTH, TABLE_12, Published, Row, Table
from tables.run_estimates import MODEL, TRUTH, Cell, Scores, by_seed, cell

RowScores = Mapping[str, Mapping[int, Scores]]  # name of a row -> seed -> scores

# Metric -> its title, and whether a higher value is better in the paper's claim.
CLAIMED = {"fgd": ("FGD", False), "beat_gain": ("beat gain", True)}
CLAIMED_ON_TALK = {
    "talk.beat_f1_gain": ("beat F1 gain (known beats)", True),
    "talk.finger_correlation": ("fingers r", True),
}
_TALK_COLUMNS = {
    "talk.beat_f1": "beat F1",
    "talk.beat_f1_gain": "beat F1 gain",
    "talk.strokes_per_second": "strokes/s",
    "talk.finger_correlation": "fingers r",
    "talk.semantic_recall": "semantic recall",
    "talk.floor": "its floor",
    "talk.above_floor": "above the floor",
    "talk.style_amplitude": "amplitude r",
    "talk.style_handedness": "handedness r",
}
SHOWN = ("fgd", "fgd_seeded", "beat_consistency", "beat_gain", "beat_f", "beats_per_second", "jerk_ratio")
SHOWN += ("diversity_l1",)
_HEAD = ("row", "FGD, paper", "FGD", "BC, paper", "BC", "beat gain", "beat F", "beats/s", "jerk / truth")
_HEAD += ("Diversity, paper", "Diversity (L1)", "seeds")
_TALK_FLOORS = {"teacher": "teacher (ceiling)", "mean pose": "mean pose"}
_TALK_FLOORS |= {retrieval.NAME: retrieval.NAME, "mismatched speech": "mismatched speech"}
_LEGACY = {"legacy_fgd": "FGD", "legacy_bc_paper": "BC paper", "legacy_bc_fixed": "BC fixed"}
_LEGACY |= {"legacy_diversity": "Diversity"}


def main_table(table: Table, scores: RowScores, split: str, failures: Mapping[str, Mapping[int, str]]) -> str:
    """Write the table of the paper's three measures beside ours, with the sanity rows.

    Args:
        table: table of the paper.
        scores: name of a row -> seed -> scores.
        split: name of the split.
        failures: name of a row -> seed -> reason.
    """
    lines: list[tuple[str, ...]] = [_HEAD]
    truth = Row(GROUND_TRUTH, "", {}, table.truth)
    lines.append(_main_line(truth, _any_row(scores), split, TRUTH, ""))
    for row in table.rows:
        mine, failed = scores.get(row.name, {}), failures.get(row.name, {})
        seeds = f"{len(mine)}, {len(failed)} failed" if failed else f"{len(mine)}"
        lines.append(_main_line(row, mine, split, MODEL, seeds))
    for name in _sanity_names(scores, split):
        sanity = Row(f"*{name}*", "", {}, Published())
        lines.append(_main_line(sanity, _any_row(scores), split, name, ""))
    return markdown(lines)


def _main_line(row: Row, scores: Mapping[int, Scores], split: str, key: str, seeds: str) -> tuple[str, ...]:
    def ours(metric: str) -> str:
        return _text(cell(scores, split, metric, key))

    published = row.published
    return (
        row.name,
        number(published.fgd),
        ours("fgd"),
        number(published.beat_consistency),
        ours("beat_consistency"),
        ours("beat_gain"),
        ours("beat_f"),
        ours("beats_per_second"),
        ours("jerk_ratio"),
        number(published.diversity),
        ours("diversity_l1"),
        seeds,
    )


def legacy_table(table: Table, scores: RowScores, split: str) -> str:
    """Write the table of the same rows with the scores of the public release; see `main_table`."""
    any_row = _any_row(scores)
    rows = [(GROUND_TRUTH, any_row, TRUTH), *((row.name, scores.get(row.name, {}), MODEL) for row in table.rows)]
    rows += [(f"*{name}*", any_row, name) for name in _sanity_names(scores, split)]
    lines = [("row, legacy rules", *_LEGACY.values())]
    for name, mine, key in rows:
        lines.append((name, *(_text(cell(mine, split, metric, key)) for metric in _LEGACY)))
    return markdown(lines)


def talk_table(table: Table, scores: RowScores, split: str) -> str:
    """Write the table of scores against the known causes of Talk, with the ceiling and floors; see `main_table`."""
    lines = [("row", *_TALK_COLUMNS.values())]
    for row in table.rows:
        mine = scores.get(row.name, {})
        lines.append((row.name, *(_text(cell(mine, split, metric)) for metric in _TALK_COLUMNS)))
    performed = scores.get(table.reference) or _any_row(scores)
    for key, name in _TALK_FLOORS.items():
        mine = performed if key == "mismatched speech" else _any_row(scores)
        cells = ("" if "floor" in metric else _text(cell(mine, split, metric, key)) for metric in _TALK_COLUMNS)
        lines.append((f"*{name}*", *cells))
    return markdown(lines)


def claim_table(table: Table, scores: RowScores, split: str, metrics: Mapping[str, tuple[str, bool]]) -> str:
    """Write the table of claims, one line for each metric and each row except the reference, tested together.

    Args:
        table: table of the paper.
        scores: name of a row -> seed -> scores.
        split: name of the split.
        metrics: metric -> title, and whether a higher value is better.
    """
    lines = [("claim", "measure", "difference, paper", "difference, ours [all 95 %]", "p (Holm)", "seeds", "verdict")]
    for row, metric, verdict in _verdicts(table, scores, split, metrics):
        claim = f"{table.reference} {'about as good as' if row.is_comparable else 'ahead of'} {row.name}"
        published, ours = _published_difference(_reference(table), row, metric), verdict.difference
        count = str(ours.num) if ours else "0"
        p_value = "-" if verdict.p_value is None else "<0.001" if verdict.p_value < 1e-3 else f"{verdict.p_value:.3f}"
        lines.append(
            (claim, metrics[metric][0], published, spread_text(ours), p_value, count, f"**{verdict.verdict}**")
        )
    return markdown(lines)


def tally(table: Table, scores: RowScores, split: str, metrics: Mapping[str, tuple[str, bool]]) -> str:
    """Count the verdicts on the claims for each metric, as text; see `claim_table`."""
    texts = []
    for metric, (title, _) in metrics.items():
        found = Counter(
            verdict.verdict for _, own, verdict in _verdicts(table, scores, split, metrics) if own == metric
        )
        texts.append(f"{title} " + ", ".join(f"{count} {verdict}" for verdict, count in found.items()))
    return "; ".join(texts)


def _verdicts(
    table: Table, scores: RowScores, split: str, metrics: Mapping[str, tuple[str, bool]]
) -> Iterator[tuple[Row, str, Verdict]]:
    compared = [(row, metric) for row in table.rows if row.name != table.reference for metric in metrics]
    claims = []
    for row, metric in compared:
        reference, other = (by_seed(scores.get(name, {}), split, metric) for name in (table.reference, row.name))
        claims.append(Claim(paired(reference, other), metrics[metric][1], row.is_comparable))
    for (row, metric), verdict in zip(compared, judge(claims), strict=True):
        yield row, metric, verdict


def _reference(table: Table) -> Row:
    return next(row for row in table.rows if row.name == table.reference)


def floor_lines(table: Table, scores: RowScores, split: str) -> list[str]:
    """Write for each row whether it shows the hand shapes of words more often than the floors do; see `main_table`."""
    above = [by_seed(scores.get(row.name, {}), split, "talk.above_floor") for row in table.rows]
    claims = [Claim(paired(one, dict.fromkeys(one, Measured(0.0))), is_higher_better=True) for one in above]
    lines = []
    for row, one, verdict in zip(table.rows, above, judge(claims), strict=True):
        said = {HELD: "above the floors", NOT_HELD: "below the floors"}.get(verdict.verdict, "undecided")
        lines.append(f"- {row.name}: {said} ({spread_text(verdict.difference)}, {len(one)} seeds)")
    return lines


def _published_difference(reference: Row, row: Row, metric: str) -> str:
    """Return the difference of reference and row in the paper; its BC, another measure, is beside our beat gain."""
    name = {"fgd": "fgd", "beat_gain": "beat_consistency"}.get(metric)
    if name is None:
        return ""
    pair = (getattr(reference.published, name), getattr(row.published, name))
    return "" if None in pair else f"{pair[0] - pair[1]:+.3f}" + (" (BC)" if metric == "beat_gain" else "")


def draws_table(scores: RowScores, split: str) -> str:
    """Write Table 12, the diversity in ten random draws of pairs; see `main_table`."""
    groups: dict[str, Sequence[float]] = {"paper, TED-Expressive": TABLE_12}
    for name, mine in scores.items():
        for seed, one in mine.items():
            draws = one["splits"][split]["draws"]
            if draws[TRUTH]:  # empty where no clip is as long as a window
                groups.setdefault(TRUTH, draws[TRUTH])
                groups[f"{name}, seed {seed}"] = draws[MODEL]
    lines = [("group", *map(str, range(1, len(TABLE_12) + 1)), "mean", "range / mean")]
    for name, values in groups.items():
        lines.append((name, *map(number, values), number(float(np.mean(values))), f"{_relative_range(values):.2%}"))
    return markdown(lines)


def draws_verdict(scores: RowScores, split: str) -> str:
    """Write a sentence on whether our draws are as close together as those of the paper; see `main_table`."""
    draws = [one["splits"][split]["draws"] for mine in scores.values() for one in mine.values()]
    ranges = [_relative_range(own) for each in draws for own in each.values() if own]
    if not any(ranges):
        return "All draws are the same: there are no more than 500 pairs of different recordings."
    widest, published = max(ranges), _relative_range(TABLE_12)
    return f"The widest range is {widest:.2%} of the mean, {'within' if widest <= published else 'beyond'} the paper's."


def _relative_range(draws: Sequence[float]) -> float:
    return float(np.ptp(draws) / np.mean(draws))


def markdown(lines: Iterable[Sequence[str]]) -> str:
    """Write a Markdown table whose first line is its header."""
    head, *body = ([text.replace("|", "\\|") or " " for text in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *body))


def _sanity_names(scores: RowScores, split: str) -> list[str]:
    rows = next(iter(_any_row(scores).values()), {"splits": {split: {"evaluation": {"rows": {}}}}})
    return [name for name in rows["splits"][split]["evaluation"]["rows"] if name not in (MODEL, TRUTH)]


def _any_row(scores: RowScores) -> Mapping[int, Scores]:
    """Return the scores of one run, because the rows that are scored with every model are the same in all runs."""
    return next(({seed: one} for mine in scores.values() for seed, one in mine.items()), {})


def _text(found: Cell | None) -> str:
    """Format a value as: mean [interval over seeds] (interval over clips)."""
    if found is None:
        return "-"
    text = spread_text(found.seeds)
    return text if found.low is None else f"{text} ({number(found.low)}, {number(found.high)})"


def spread_text(spread: Spread | None) -> str:
    """Format a mean over seeds with its interval, such as "0.412 [0.380, 0.444]"; "-" for None."""
    if spread is None:
        return "-"
    if spread.low is None:
        return number(spread.mean)
    return f"{number(spread.mean)} [{number(spread.low)}, {number(spread.high)}]"


def number(value: float | None) -> str:
    """Format a value with about three digits; None gives "", NaN gives "-"."""
    if value is None:
        return ""
    if math.isnan(value):
        return "-"
    size = abs(value)
    return f"{value:.1f}" if size >= 100 else f"{value:.2f}" if size >= 10 else f"{value:.3f}"

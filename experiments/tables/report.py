"""Page of a reproduction in Markdown: the claims with their verdicts, the paper's numbers next to ours, the runs."""

import datetime
import importlib.metadata
import pathlib
import platform
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

import ha2g_jax
from ha2g_jax import metrics
from ha2g_jax.evaluation.charts import Mark, markdown, number
from ha2g_jax.progress import counted
from tables.claims import LEVEL, Measured, Spread, interval, over_seeds, paired
from tables.curves import Panel, curve_chart
from tables.paper_tables import EQUAL, TABLE_12, THRESHOLDS, WITHOUT_GAN
from tables.plan import Plan, Request, TablePlan
from tables.runs import duration
from tables.tables import (
    CLAIMED,
    CLAIMED_ON_TALK,
    MODEL,
    SHOWN,
    SHOWN_ON_TALK,
    TRUTH,
    Claimed,
    RowScores,
    Scores,
    claim_table,
    draws_table,
    draws_verdict,
    estimate,
    every_number,
    floor_line,
    main_table,
    spread_text,
    tally,
)
from tables.workdirs import Record

_PACKAGES = ("ha2g-jax", "jax", "jaxlib", "flax", "optax", "numpy", "scipy", "librosa")
_CURVES = {"BC": "BC (Eq. 11)", "F": "F with the own speech", "gain": "gain over mismatched speech"}
_SHOWN_THRESHOLDS = (0.01, 0.03, 0.1, 0.2, 0.3)
_WITH_GAN = "HA2G"
_GAN_MEASURES = {"jerk_ratio": "jerk / truth", "fgd": "FGD", "diversity_l1": "Diversity (L1)"}
_TOLERANCE = 0.05  # share by which the reconstruction term may be larger with the GAN term
_NEARER = "nearer"
_CLAIMS = """\
A difference is the mean over seeds [interval]. The differences of this table are tested together: p-values have \
Holm's correction, and the intervals are Bonferroni's at 95 %. *Held*: p is below 0.05 on the side that the paper \
claims; *not held*: on the other side, or at all where the paper calls the rows about as good; else *undecided*."""
_SCORES = f"""\
A value is the mean over seeds ± half its {LEVEL:.0%} t interval. For beats and diversity the value to reach is ground \
truth's; more is not better. The paper's BC is another measure than beat gain. Rows in *italics* are not models: they \
show what a measure does with motion that is known to be good or bad."""
_KNOWN_CAUSES = """\
Known causes: beat F1 gain is about the strokes that sound causes, fingers r about the hand shapes of words; in the \
claims, their errors hold for other speakers too. Words above floor is the share of words with the right hand shape, \
less the better of two floors."""
_BESIDE = {
    "table1": """\
The paper has no rows *Trimodal, sound alone* and *HA2G without GAN*; *held* means there that HA2G is ahead.""",
    EQUAL: """\
The baselines are no longer those of their papers: each hears the spectrogram and sees the images as HA2G does, reads \
no words, and has as many parameters that generate. *Held* means that HA2G is ahead.""",
}
_GAN_RULE = f"""\
The GAN term helps if one of these distances to the truth is smaller with it, with a 95 % interval over seeds that \
excludes 0 (not corrected for their number), and if the reconstruction term on the validation split is at most \
{_TOLERANCE:.0%} larger."""
# Metrics that the evaluation may remark on but that no table here shows.
_UNSHOWN = {
    metric.heading
    for key, metric in metrics.of_section("rows").items()
    if key not in (*SHOWN, "fgd_seeded", "beat_f1", "beat_f")
}


class Results(NamedTuple):
    """Content of the report.

    Attributes:
        plan: plan of a table of the paper.
        records: name of a row -> seed -> record of the run.
        failures: name of a row -> seed -> reason in one line.
        facts: title -> text, printed in this order.
    """

    request: Request
    plan: TablePlan
    records: Mapping[str, Mapping[int, Record]]
    failures: Mapping[str, Mapping[int, str]]
    facts: Mapping[str, str]

    @property
    def scores(self) -> RowScores:
        """Scores by the name of the row and the seed."""
        return {
            row: scores
            for row, mine in self.records.items()
            if (scores := {seed: one.scores for seed, one in mine.items() if one.scores is not None})
        }

    @property
    def claimed(self) -> Claimed:
        """Metrics of the claims."""
        return {**CLAIMED, **CLAIMED_ON_TALK} if self.request.data == "talk" else CLAIMED


def describe_work(
    request: Request, plan: Plan, records: Iterable[Record], command: str, seconds: float
) -> dict[str, str]:
    """Describe what a report is based on: title -> text.

    Args:
        seconds: time that the command has taken.
    """
    from ha2g_jax.train.run_record import commit  # JAX takes a while to import

    starts = [start for record in records for start in record.starts]
    trained = _distinct(start.get("commit") or "unknown" for start in starts)
    devices = _distinct(f"{count} x {name}" for start in starts for name, count in start["hardware"]["devices"].items())
    corpus = plan.corpus.metadata
    splits = [f"{name} {values['clips']:,} clips" for name, values in corpus["splits"].items()]
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES)
    return {
        "command": f"`{command}`",
        "time": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC, {duration(seconds)} for what was missing",
        "commit": commit(pathlib.Path(ha2g_jax.__file__).parent) or "unknown",
        "trained with": f"commit {trained}; {devices}",
        "versions": f"Python {platform.python_version()}, {versions}",
        "data": f"{corpus['name']} ({corpus['source']}): {'; '.join(splits)}; {corpus['skeleton']}, "
        f"{corpus['fps']:g} frames per second",
        "size": request.size + (f", changed: {dict(request.changes)}" if request.changes else ""),
    }


def _distinct(texts: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(texts)) or "unknown"


def as_markdown(results: Results, numbers: str, chart: str | None = None) -> str:
    """Write the page.

    Args:
        numbers: name of the file beside the page with `all_numbers`.
        chart: name of the SVG of `figure`, for Figure 3.
    """
    plan, request = results.plan, results.request
    lines = [f"# {plan.table.title}, on {request.data} ({request.size})", ""]
    lines += [*(f"- {title}: {text}" for title, text in results.facts.items()), "", " ".join(caveats(results)), ""]
    if results.scores:
        lines += [f"All scores with their intervals, by seed, and all differences: [{numbers}]({numbers}).", ""]
        lines += {"table12": _draws, "figure3": _figure}.get(request.table, _comparison)(results, chart)
    failed = [
        f"{row}, seed {seed}: failed: {reason}"
        for row, reasons in results.failures.items()
        for seed, reason in reasons.items()
    ]
    lines += section("Failed", failed)
    lines += section("Left out", [f"{row}: {reason}" for row, reason in plan.left_out.items()])
    return "\n".join([*lines, "## Runs", "", run_table(results.records), ""])


def all_numbers(results: Results) -> str:
    """Write all numbers of the results, the remarks of the evaluations and the runs as CSV."""
    more = [("remark", split, row, "", text) for split, row, text in _remarks(results)]
    for row, mine in results.records.items():
        for seed, one in mine.items():
            validation = one.validated(one.config["train"]["best_by"])
            more.append(("run", "", row, f"seed {seed}, scored step {one.scored_step}, {one.name}", str(validation)))
    return every_number(results.plan.table, results.scores, results.plan.splits, results.claimed, more)


def caveats(results: Results) -> list[str]:
    """Return sentences on the limits of the results, depending on the runs."""
    (request, plan), found = results[:2], []
    runs = [record for mine in results.records.values() for record in mine.values()]
    if request.data == "talk":
        found.append("Talk is a testbed made by a program: these numbers do not describe people.")
    found.append(
        "FGD and diversity are of the auto-encoder named above, so compare the order of the rows and not the size with "
        f"the published values ({plan.table.published_on})."
    )
    if request.size != "paper":
        found.append(f"Models and training budget are of the size {request.size}, not the paper's.")
    if request.size == "debug":
        found.append("The debug size shows that everything runs; its numbers say nothing about the methods.")
    if (seeds := len(request.seeds)) < 3:
        found.append(f"{counted(seeds, 'seed')} a row: too few to decide anything.")
    if request.table == "table11":
        found.append("Three of the scored frames of each clip, 4 to 6, are given to M = 7.")
    budgets = {run.config["train"]["steps"] * run.config["train"]["batch_size"] for run in runs}
    if len(budgets) > 1:
        found.append(f"Budgets differ: {', '.join(f'{count:,}' for count in sorted(budgets))} windows of training.")
    if unfinished := sum(run.scored_step is not None and _is_unfinished(run) for run in runs):
        found.append(f"Runs that are unfinished and scored as they are: {unfinished}.")
    if failed := sum(map(len, results.failures.values())):
        found.append(f"Runs without scores: {failed} of {len(runs)}, see below.")
    if len(plan.splits) > 1 and request.table not in ("table12", "figure3"):
        found.append(f"The split {plan.splits[-1]} decides; what differs on another one decides nothing.")
    return [*found, "Checkpoints were chosen on the validation split."]


def _comparison(results: Results, _: str | None) -> list[str]:
    (request, plan), scores, claimed = results[:2], results.scores, results.claimed
    is_talk, split = request.data == "talk", plan.splits[-1]
    lines = ["## Claims", "", _CLAIMS, *([_BESIDE[request.table]] if is_talk and request.table in _BESIDE else []), ""]
    lines += [claim_table(plan.table, scores, split, claimed), ""]
    lines += [f"- {name}: {tally(plan.table, scores, name, claimed)}" for name in plan.splits]
    lines += ["", f"## Scores on {split}", "", _SCORES, *([_KNOWN_CAUSES] if is_talk else []), ""]
    columns = SHOWN | (SHOWN_ON_TALK if is_talk else {})
    lines += [main_table(plan.table, scores, split, columns), ""]
    if is_talk:
        lines += [floor_line(plan.table, scores, split), ""]
    flagged = dict.fromkeys(row for name, row, text in _remarks(results) if row and name == split and "beats/s" in text)
    if flagged:
        lines += [f"Flagged for beats that are too dense or too rare: {', '.join(flagged)}.", ""]
    if gan := _gan_term(results, split):
        lines += ["## The GAN term", "", *gan, ""]
    return lines


def _remarks(results: Results) -> list[tuple[str, str, str]]:
    """Return the remarks of the evaluations on the measures in the tables, each once: split, row of a model, text."""
    remarks: dict[tuple[str, str, str], None] = {}
    for row, mine in results.scores.items():
        for seed, one in mine.items():
            for split in results.plan.splits:
                found = one["splits"][split]["evaluation"]
                for remark in (*found["warnings"], *found["flags"]):
                    about, _, rest = remark.partition(": ")
                    if about == MODEL:
                        remarks[split, row, f"seed {seed}: {rest}"] = None
                    elif about not in _UNSHOWN:
                        remarks[split, "", remark] = None
    return list(remarks)


def _gan_term(results: Results, split: str) -> list[str]:
    """Write the distances to the truth with and without the GAN term, and whether the term helps; [] without both.

    The term helps if one of the measures is nearer to the truth, with a 95 % interval over seeds that excludes 0, and
    the reconstruction term on the validation split is at most 5 % larger on average. Seeds count that have scores of
    both rows.
    """
    pair = [results.scores.get(name, {}) for name in (_WITH_GAN, WITHOUT_GAN)]
    seeds = sorted(pair[0].keys() & pair[1].keys())
    lines: list[tuple[str, ...]] = [("distance to the truth", "with GAN", "without", "difference [95 %]", "verdict")]
    spreads = []
    for metric, title in _GAN_MEASURES.items():
        distances = [_distances({seed: mine[seed] for seed in seeds}, split, metric) for mine in pair]
        difference = paired(*distances)
        if difference is not None:
            spreads.append(interval(difference))
            means = [over_seeds([each.value for each in mine.values()]).mean for mine in distances]
            lines.append((title, *map(number, means), spread_text(spreads[-1]), _nearness(spreads[-1])))
    if not spreads:
        return []
    is_nearer = any(_nearness(each) == _NEARER for each in spreads)
    return [_GAN_RULE, "", markdown(lines), "", _gan_verdict(results, seeds, is_nearer)]


def _distances(scores: Mapping[int, Scores], split: str, metric: str) -> dict[int, Measured]:
    found = {seed: [estimate(one, split, metric, row) for row in (MODEL, TRUTH)] for seed, one in scores.items()}
    return {seed: Measured(abs(mine.value - truth.value)) for seed, (mine, truth) in found.items() if mine and truth}


def _nearness(spread: Spread) -> str:
    if spread.low is None or spread.high is None or spread.low <= 0 <= spread.high:
        return "undecided"
    return _NEARER if spread.high < 0 else "farther"


def _gan_verdict(results: Results, seeds: Sequence[int], is_nearer: bool) -> str:
    changes = []
    for seed in seeds:
        one, other = (results.records[name][seed] for name in (_WITH_GAN, WITHOUT_GAN))
        ours, without = (each.validated(each.config["train"]["best_by"]) for each in (one, other))
        if ours is None or without is None:
            return "Whether the fit is kept is not known, because a run has not logged the reconstruction term."
        changes.append(ours / without - 1)
    spread = over_seeds(changes)
    limits = "" if spread.low is None else f" [{spread.low:+.1%}, {spread.high:+.1%}]"
    helps = "helps" if is_nearer and spread.mean <= _TOLERANCE else "was not shown to help"
    return (
        f"The reconstruction term on the validation split changes by {spread.mean:+.1%}{limits} with the GAN term. "
        f"The GAN term **{helps}**."
    )


def _draws(results: Results, _: str | None) -> list[str]:
    published = np.array(TABLE_12)
    lines = [
        "Ten random draws of 500 pairs (L1). The paper's draws lie within "
        f"{np.ptp(published) / published.mean():.2%} of their mean.",
        "",
    ]
    for split in results.plan.splits:
        lines += [f"## Split {split}", "", draws_table(results.scores, split), ""]
        lines += [draws_verdict(results.scores, split), ""]
    return lines


def figure(results: Results) -> str:
    """Draw Figure 3 for the first split as an SVG document: BC, F and its gain by threshold, as means over seeds."""
    split = results.plan.splits[0]
    curves = _curves(results.scores, split)
    panels = [
        Panel(title, {name: [Mark(float(value)) for value in values[key]] for name, values in curves.items()})
        for key, title in _CURVES.items()
    ]
    label = f"{results.plan.table.title}, on {results.request.data}, split {split}"
    return curve_chart(panels, THRESHOLDS, label=label, axis="threshold")


def _figure(results: Results, chart: str | None) -> list[str]:
    lines = [f"![{results.plan.table.title}]({chart})", ""] if chart else []
    places = [THRESHOLDS.index(threshold) for threshold in _SHOWN_THRESHOLDS]
    for split in results.plan.splits:
        rows = [("row", *(f"{name} at {threshold:g}" for name in _CURVES for threshold in _SHOWN_THRESHOLDS))]
        for name, curves in _curves(results.scores, split).items():
            rows.append((name, *(number(float(curves[key][place])) for key in _CURVES for place in places)))
        lines += [f"## Split {split}", "", markdown(rows), ""]
    return lines


def _curves(scores: RowScores, split: str) -> dict[str, dict[str, np.ndarray]]:
    """Return `_CURVES` by threshold for each row, ground truth first."""
    curves: dict[str, dict[str, np.ndarray]] = {}
    for row, mine in scores.items():
        sweeps = [one["splits"][split]["sweep"] for one in mine.values()]
        for name, key in ((TRUTH, TRUTH), (row, MODEL)):
            if name not in curves:
                paper, own, floor = (
                    np.array([each[key][part] for each in sweeps], float).mean(axis=0)  # NaN for None
                    for part in ("consistency", "own", "mismatched")
                )
                curves[name] = {"BC": paper, "F": own, "gain": own - floor}
    return curves


def section(title: str, lines: Sequence[str]) -> list[str]:
    """Return a section with a list, nothing for an empty one."""
    return [f"## {title}", "", *(f"- {line}" for line in lines), ""] if lines else []


def run_table(records: Mapping[str, Mapping[int, Record]]) -> str:
    """Write the table of runs with their budgets and the checkpoints that were scored, a line for each row."""
    lines = [("row", "seeds", "steps x batch", "scored steps (best on validation)", "validation term")]
    for row, mine in records.items():
        runs = list(mine.values())
        steps = _distinct(
            f"{run.last_step:,}"
            + (f" of {run.config['train']['steps']:,}" if _is_unfinished(run) else "")
            + f" x {run.config['train']['batch_size']}"
            for run in runs
        )
        scored = _distinct("-" if run.scored_step is None else f"{run.scored_step:,}" for run in runs)
        terms = [term for run in runs if (term := run.validated(run.config["train"]["best_by"])) is not None]
        term = f"{min(terms):.4g} to {max(terms):.4g}" if terms else "-"
        lines.append((row, ",".join(map(str, mine)), steps, scored, term))
    return markdown(lines)


def _is_unfinished(run: Record) -> bool:
    return run.last_step < run.config["train"]["steps"]

"""Report of a reproduction in Markdown: the runs, the paper's numbers beside ours, and the verdicts on claims."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax import metrics
from tables.claims import LEVEL
from tables.figure import chart, sweep_table
from tables.gan_term import gan_lines
from tables.paper_tables import TABLE_12
from tables.results import Results, RunState
from tables.run_estimates import MODEL
from tables.tables import (
    CLAIMED,
    CLAIMED_ON_TALK,
    SHOWN,
    claim_table,
    draws_table,
    draws_verdict,
    floor_lines,
    legacy_table,
    main_table,
    markdown,
    talk_table,
    tally,
)

_HOW_TO_READ = f"""\
A value is the mean over seeds [its t interval over seeds, {LEVEL:.0%}] (the bootstrap interval over clips, by source \
recording, {LEVEL:.0%}, mean of the seeds). The first says how far another training would be off, the second how far \
other speech would be. For beats and diversity the value to reach is ground truth's; more is not better. Beat gain is \
F with the own speech less F with other clips' speech. The paper's BC is another measure (speech to motion only, not \
against chance) and stands beside it for its order, not for its size. Rows in *italics* are not models: they show what \
a measure does with motion that is known to be good or bad."""
_TALK_HOW_TO_READ = """\
Talk knows which syllable or word causes which movement. Beat F1 and its gain are about the strokes that sound causes. \
Fingers r is the correlation, at gesture-bearing words, of the fingers with the hand shape of the word's class, 0 for \
motion that does not know the word. Semantic recall is the share of these words at which that shape is the nearest; \
its floor is the better of always showing the most frequent class and of showing the same shapes at shuffled words. \
Amplitude and handedness are correlations of what is seen with the style asked for. Intervals in parentheses are 1.96 \
standard errors over clips, of the styles over speakers. In the claims, the errors of beat F1 gain and fingers r hold \
for other speakers too (the jackknife over speakers)."""
_CLAIMS = """\
Difference: first row less second, seed by seed; its error holds for other trainings. The lines of one table are \
tested together: p-values have Holm's correction, and the intervals Bonferroni's, so that all of them hold at once \
with 95 %. *Held*: p is below 0.05 and the difference is on the side that the paper claims; *not held*: on the other \
side; *undecided*: p is above 0.05, or there is one seed. Where the paper calls two rows about as good, a difference \
means *not held*."""
_BESIDE = """\
The paper has no rows *Trimodal, sound alone* and *HA2G without GAN*. In their lines, *held* means that HA2G is ahead; \
what the GAN term does is seen in jerk, FGD and diversity, too."""
# Metrics that the evaluation may remark on and no table here shows.
_UNSHOWN = {metric.heading for key, metric in metrics.of_section("rows").items() if key not in SHOWN}


def as_markdown(results: Results, chart: str | None = None) -> str:
    """Write the whole report as Markdown.

    Args:
        results: results of all runs.
        chart: file name of the SVG of `figure`, for Figure 3.
    """
    lines = [f"# {results.table.title}, on {results.data} ({results.size})", ""]
    lines += [f"- {title}: {text}" for title, text in results.facts.items()]
    lines += [f"- pose auto-encoder: {results.autoencoder}", ""]
    lines += [" ".join(caveats(results)), ""]
    if any(results.scores.values()):
        body = {"table12": _draws, "figure3": _figure}.get(results.name, _comparison)
        lines += body(results, chart)
    failed = [
        f"{row}, seed {seed}: failed: {reason}"
        for row, reasons in results.failures.items()
        for seed, reason in reasons.items()
    ]
    lines += [
        *_section("Failed", failed),
        *_section("Left out", [f"{row}: {reason}" for row, reason in results.left_out.items()]),
        *_section("Remarks", _remarks(results)),
        "## Runs",
        "",
        run_table(results.runs),
        "",
    ]
    return "\n".join(lines)


def caveats(results: Results) -> list[str]:
    """Return sentences on the limits of the results, depending on the runs."""
    table, seeds = results.table, sorted({run.seed for run in results.runs})
    found = []
    if results.data == "talk":
        found.append("Talk is a testbed made by a program: these numbers do not describe people.")
    found.append(
        "FGD and Diversity are of the auto-encoder named above and can be compared with no other's, so not in size "
        f"with the published values ({table.published_on}); compare the order of the rows."
    )
    if results.size != "paper":
        found.append(f"Models and training budget are of the size {results.size}, not the paper's.")
    if results.size == "debug":
        found.append("The debug size shows that everything runs; its numbers say nothing about the methods.")
    if len(seeds) < 3:
        found.append(f"{len(seeds)} seed{'s' if len(seeds) > 1 else ''} a row: too few to decide anything.")
    if results.name == "table11":
        found.append("Three of the scored frames of each clip, 4 to 6, are given to M = 7.")
    if len(budgets := sorted({run.steps * run.batch_size for run in results.runs})) > 1:
        found.append(f"Budgets differ: {', '.join(f'{count:,}' for count in budgets)} windows of training.")
    unfinished = [run for run in results.runs if run.scored_step is not None and run.last_step < run.steps]
    if unfinished:
        found.append(f"Runs that are unfinished and scored as they are: {len(unfinished)}.")
    if failed := sum(map(len, results.failures.values())):
        found.append(f"Runs without scores: {failed} of {len(results.runs)}, see below.")
    count = (len(table.rows) - 1 - len(results.left_out)) * len(_claimed(results)) * len(results.splits)
    if count > 1 and results.name not in ("table12", "figure3"):
        found.append(
            f"{count} differences are looked at; those of each table of claims are corrected for their number, those "
            "of different splits are not."
        )
    found.append("Checkpoints were chosen on the validation split; the splits below were used for these scores only.")
    return found


def _comparison(results: Results, _: str | None) -> list[str]:
    tallies = [
        f"- {split}: {tally(results.table, results.scores, split, _claimed(results))}" for split in results.splits
    ]
    lines = ["Claims, in short:", "", *tallies, "", _HOW_TO_READ, ""]
    for split in results.splits:
        lines += [f"## Split {split}", ""]
        lines += [main_table(results.table, results.scores, split, results.failures), ""]
        if results.has_legacy:
            lines += ["By the rules of the public release, to be compared with old tables only:", ""]
            lines += [legacy_table(results.table, results.scores, split), ""]
        if results.data == "talk":
            lines += ["### Against the known causes", "", _TALK_HOW_TO_READ, ""]
            lines += [talk_table(results.table, results.scores, split), ""]
            lines += ["Hand shapes of words, above the floors:", ""]
            lines += [*floor_lines(results.table, results.scores, split), ""]
        has_beside = results.data == "talk" and results.name == "table1"
        lines += ["### Claims", "", *([_CLAIMS, _BESIDE] if has_beside else [_CLAIMS]), ""]
        lines += [
            claim_table(results.table, results.scores, split, _claimed(results)),
            "",
        ]
    if gan := _gan(results):
        lines += ["## The GAN term", "", *gan, ""]
    return lines


def _gan(results: Results) -> list[str]:
    """Return the lines on the GAN term, on the last split, that of speakers that no model was trained on."""
    validation: dict[str, dict[int, float]] = {}
    for run in results.runs:
        if run.validation is not None:
            validation.setdefault(run.row, {})[run.seed] = run.validation
    return gan_lines(results.scores, validation, results.splits[-1])


def _draws(results: Results, _: str | None) -> list[str]:
    published = np.array(TABLE_12)
    lines = [
        "Ten random draws of 500 pairs (L1). The paper's draws lie within "
        f"{np.ptp(published) / published.mean():.2%} of their mean.",
        "",
    ]
    for split in results.splits:
        lines += [f"## Split {split}", "", draws_table(results.scores, split), ""]
        lines += [draws_verdict(results.scores, split), ""]
    return lines


def _figure(results: Results, chart: str | None) -> list[str]:
    lines = [f"![{results.table.title}]({chart})", ""] if chart else []
    for split in results.splits:
        lines += [f"## Split {split}", "", sweep_table(results.scores, split), ""]
    return lines


def figure(results: Results) -> str:
    """Draw Figure 3 for the first split as an SVG document."""
    title = f"{results.table.title}, on {results.data}, split {results.splits[0]}"
    return chart(results.scores, results.splits[0], title)


def _claimed(results: Results) -> dict[str, tuple[str, bool]]:
    return CLAIMED | (CLAIMED_ON_TALK if results.data == "talk" else {})


def _remarks(results: Results) -> list[str]:
    """Return the remarks of the evaluations on the measures in the tables, each once, with row and seed of a model."""
    remarks: dict[str, None] = {}
    for row, mine in results.scores.items():
        for seed, one in mine.items():
            for split in results.splits:
                found = one["splits"][split]["evaluation"]
                for remark in (*found["warnings"], *found["flags"]):
                    about, _, rest = remark.partition(": ")
                    if about in _UNSHOWN:
                        continue
                    name = f"{row}, seed {seed}: {rest}" if about == MODEL else remark
                    remarks[f"{split}: {name}"] = None
    return list(remarks)


def _section(title: str, lines: Sequence[str]) -> list[str]:
    return [f"## {title}", "", *(f"- {line}" for line in lines), ""] if lines else []


def run_table(runs: Sequence[RunState]) -> str:
    """Write the table of runs with their budgets and the checkpoints that were scored."""
    head = ("row", "seed", "steps", "batch", "checkpoint scored (best on validation)", "its validation term", "folder")
    lines: list[tuple[str, ...]] = [head]
    for run in runs:
        steps = f"{run.last_step:,}" if run.last_step >= run.steps else f"{run.last_step:,} of {run.steps:,}"
        scored = "-" if run.scored_step is None else f"{run.scored_step:,}"
        term = "-" if run.validation is None else f"{run.validation:.4g}"
        lines.append((run.row, str(run.seed), steps, str(run.batch_size), scored, term, f"`{run.name}`"))
    return markdown(lines)

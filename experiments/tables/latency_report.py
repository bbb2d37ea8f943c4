"""Page of the study in Markdown: questions and rules first, then answers, tables and limits."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from tables.claims import LEVEL, Spread
from tables.latency_chart import Panel, look_ahead_chart
from tables.latency_estimates import (
    TRUTH_SCORES,
    Curves,
    Scores,
    all_of,
    difference,
    first_above_zero,
    is_better,
    is_no_worse,
    level,
    losses,
    smallest_within,
)
from tables.latency_plan import (
    ABOVE_FLOOR,
    BEATS,
    EVERY,
    F1,
    GAIN,
    HIDDEN,
    HOP,
    JERK,
    LOOK_AHEADS,
    PRIMARY,
    RECALL,
    SETTINGS,
    WHOLE,
    title,
)
from tables.latency_texts import LIMITS, MARGIN, NEEDS, QUESTIONS, SETTING, STREAM
from tables.report import run_table
from tables.results import RunState
from tables.tables import markdown, number

_PANELS = {
    GAIN: "beat F1 gain",
    ABOVE_FLOOR: "semantic recall above its floor",
    JERK: "jerk / truth",
    BEATS: "beats per second",
}
# Heading of a table -> name of a score -> title of its columns.
_TABLES = {
    "Beats": {GAIN: "gain", F1: "F1"},
    "Hand shapes at words": {ABOVE_FLOOR: "above the floor", RECALL: "recall"},
    "Smoothness": {JERK: "jerk / truth", BEATS: "beats/s"},
}


class Results(NamedTuple):
    """Content of the page.

    Attributes:
        size: size of the models.
        split: split that was scored.
        fps: frames per second of the models.
        curves: scores of all runs.
        failures: setting -> seed -> reason in one line.
        runs: states of the runs.
        facts: title -> text, printed in this order.
    """

    size: str
    split: str
    fps: float
    curves: Curves
    failures: Mapping[str, Mapping[int, str]]
    runs: Sequence[RunState]
    facts: Mapping[str, str]


def as_markdown(results: Results, chart: str | None = None) -> str:
    """Write the whole page as Markdown.

    Args:
        results: results of all runs.
        chart: file name of the SVG of `figure`, None without scores.
    """
    lines = ["# How much of the speech must be heard before a gesture?", ""]
    if count := sum(map(len, results.failures.values())):
        lines += [f"**Incomplete: runs without scores: {count} of {len(results.runs)}, see *Missing*.**", ""]
    lines += [SETTING, "", "## Questions", "", QUESTIONS, ""]
    if chart:
        lines += ["## Answers", "", *answers(results), "", NEEDS, ""]
        lines += ["## Curves", "", f"![{_label(results)}]({chart})", "", _HOW_TO_READ, ""]
        for heading, names in _TABLES.items():
            lines += [f"### {heading}", "", _table(results, names), ""]
    failed = [
        f"- {setting}, seed {seed}: {reason}"
        for setting, reasons in results.failures.items()
        for seed, reason in reasons.items()
    ]
    if failed:
        lines += ["## Missing", "", *failed, ""]
    lines += ["## Limits", "", *_limits(results), "", "## Runs", ""]
    lines += [f"- {name}: {text}" for name, text in results.facts.items()]
    lines += ["", run_table(results.runs), ""]
    return "\n".join(lines)


_HOW_TO_READ = f"""\
A value is the mean over seeds [{LEVEL:.0%} interval over seeds and recordings]. *Heard* is how much speech after the \
time of a frame has been heard when the frame is made; *latency* passes from a moment of the speech to the frame that \
shows it, with a hop of {HOP}. *file* is the motion of `Model.generate`, which hears everything. A difference is \
{HIDDEN} less {WHOLE}."""


def answers(results: Results) -> list[str]:
    """Write the answers to the questions, a line each; see `texts.QUESTIONS`."""
    lines = []
    for letter, name in zip("ab", PRIMARY, strict=True):
        found = _difference(results, STREAM, name)
        levels = "; ".join(f"{setting} {_text(level(_at(results, setting, STREAM), name))}" for setting in SETTINGS)
        said = f"**{is_better(found)}**. {levels}; difference {_text(found)}."
        lines.append(f"- ({letter}) {HIDDEN} better in {_PANELS[name]} at {STREAM} frames: {said}")
    offline = {name: _difference(results, None, name) for name in PRIMARY}
    verdict = all_of([is_no_worse(found, MARGIN) for found in offline.values()])
    said = "; ".join(f"{_PANELS[name]} {_text(found)}" for name, found in offline.items())
    lines.append(f"- (c) {HIDDEN} no worse with the whole file: **{verdict}**. Differences: {said}.")
    for setting in SETTINGS:
        found = losses(results.curves.get(setting, {}), GAIN)
        mean, sure = smallest_within(found, MARGIN)
        mean, sure = _frames(mean, results, found.values()), _frames(sure, results, _bounded(found.values()))
        said = f"**{mean}**; with the whole interval of the loss within {MARGIN}: {sure}"
        lines.append(f"- (d) smallest look-ahead, {setting}: {said}.")
    for name in PRIMARY:
        firsts = []
        for setting in SETTINGS:
            levels = _bounded(level(_at(results, setting, at), name) for at in LOOK_AHEADS)
            first = first_above_zero(results.curves.get(setting, {}), name)
            firsts.append(f"{setting} {_frames(first, results, levels)}")
        said = "; ".join(firsts)
        lines.append(f"- Not asked: the interval of {_PANELS[name]} is above 0 from this look-ahead on: {said}.")
    return lines


def figure(results: Results) -> str:
    """Draw the curves as an SVG document."""
    panels = [
        Panel(
            panel_title,
            {
                setting: [level(curve.get(at, {}), key) for at in LOOK_AHEADS]
                for setting, curve in results.curves.items()
            },
            None if truth is None else truth.mean,
        )
        for key, panel_title in _PANELS.items()
        for truth in [level(_any(results), key, TRUTH_SCORES)]
    ]
    axis = f"look-ahead in frames of 1/{results.fps:g} s"
    return look_ahead_chart([title(at) for at in LOOK_AHEADS], panels, _label(results), axis)


def _table(results: Results, names: Mapping[str, str]) -> str:
    """Write the table of some scores with a line for each look-ahead, and the differences of primary measures."""
    head = ["look-ahead", "heard, ms", "latency, ms"]
    truth = ["*ground truth*", "", ""]
    for name, column in names.items():
        columns = [f"{column}, {setting}" for setting in SETTINGS] + ["difference"] * (name in PRIMARY)
        head += columns
        truth += [_text(level(_any(results), name, TRUTH_SCORES)), *[""] * (len(columns) - 1)]
    lines = [head]
    for at in LOOK_AHEADS:
        line = [title(at), *(("all", "-") if at is None else (_ms(at, results), _ms(max(at + HOP, 1.5), results)))]
        for name in names:
            line += [_text(level(_at(results, setting, at), name)) for setting in SETTINGS]
            line += [_text(_difference(results, at, name))] * (name in PRIMARY)
        lines.append(line)
    return markdown([*lines, truth])


def _limits(results: Results) -> list[str]:
    seeds = {setting: len(_at(results, setting, None)) for setting in SETTINGS}
    recordings = {len(one["recordings"]) for one in _any(results).values()}
    found = [
        f"- Scored: one of every {EVERY} clips of the split {results.split}, {max(recordings, default=0)} recordings, "
        f"seeds: {', '.join(f'{setting} {count}' for setting, count in seeds.items())}."
    ]
    if min(seeds.values()) < 3:
        found.append("- With fewer than three seeds of a setting an interval says little about other trainings.")
    if results.size != "paper":
        found.append(f"- Models and training are of the size {results.size}, not the paper's.")
    if results.size == "debug":
        found.append("- The debug size shows that everything runs; its numbers say nothing.")
    return [*found, LIMITS]


def _any(results: Results) -> Mapping[int, Scores]:
    """Return the scores of some run, because the truth is the same for all."""
    return next((scores for curve in results.curves.values() for scores in curve.values() if scores), {})


def _label(results: Results) -> str:
    return f"Beats, hand shapes and smoothness by look-ahead, on talk, split {results.split}"


def _at(results: Results, setting: str, at: int | None) -> Mapping[int, Scores]:
    return results.curves.get(setting, {}).get(at, {})


def _difference(results: Results, at: int | None, name: str) -> Spread | None:
    return difference(_at(results, HIDDEN, at), _at(results, WHOLE, at), name)


def _frames(at: int | None, results: Results, based_on: Iterable[Spread | None]) -> str:
    """Write a look-ahead that was searched for, "-" where there was nothing to search in."""
    if not any(spread is not None for spread in based_on):
        return "-"
    return "none of them" if at is None else f"{at} frames ({_ms(at, results)} ms)"


def _bounded(spreads: Iterable[Spread | None]) -> list[Spread]:
    """Return the values that have an interval."""
    return [spread for spread in spreads if spread is not None and spread.low is not None]


def _ms(frames: float, results: Results) -> str:
    return f"{1000 * frames / results.fps:.0f}"


def _text(spread: Spread | None) -> str:
    if spread is None:
        return "-"
    if spread.low is None or spread.high is None:
        return number(spread.mean)
    return f"{number(spread.mean)} [{number(spread.low)}, {number(spread.high)}]"

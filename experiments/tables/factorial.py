"""The factorial study: what decides its three claims, and its page. docs/results/factorial.md has the protocol."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from ha2g_jax.config import presets
from ha2g_jax.config.presets import HOLISTIC, NO_COORDINATOR, ORACLE, OTHER_TEXT
from ha2g_jax.evaluation.charts import markdown, number
from ha2g_jax.metrics.uncertainty import holm, jackknife_variance
from tables.claims import (
    HELD,
    LEVEL,
    NOT_HELD,
    UNDECIDED,
    Measured,
    Spread,
    combine,
    interval,
    over_seeds,
    t_test,
    with_freedom_of_seeds,
)
from tables.paper_tables import Published, Row, Table
from tables.tables import RowScores, Scores, by_seed, plus_minus, spread_text
from tables.workdirs import Record

TABLE = "factorial"
SPLITS = ("val", "test_unseen_speakers")  # of the gate, and of the claims
SEEDS = 8
SPEAKERS, MINUTES = 288, 864  # of the corpus
HANDS_FGD = "hands_fgd"
MEASURED = ("finger_correlation", "probe_accuracy", "style_handedness", "style_amplitude")  # by speaker, too

GATE_ROWS = (ORACLE, presets.FULL)

_GATE, _GATE_MEASURE = 0.5, "talk.finger_correlation"
_POWER, _LEAST_BLOCKS, _MOST_BLOCKS = 0.8, 2, 64
_RULES = f"""\
An effect is the mean over blocks of the mean of the four cells with a part less that of the four without it; standard \
errors cover the choice of seeds and of speakers. *Held*: all measures of a claim are better, and the largest of their \
p-values, with Holm's correction for three claims, is at most {1 - LEVEL:.2g}. *Not held*: else, if an advantage that \
would matter is outside of the interval of one of them; intervals have Bonferroni's level for three claims. \
*Undecided*: else. A verdict at fewer than {SEEDS} blocks is not that of the study."""


class Measure(NamedTuple):
    """A measure of a claim.

    Attributes:
        metrics: names for `tables.by_seed`; the measure is their mean.
        matters: smallest advantage that would matter, above 0; of a measure in logarithms, of the logarithm.
    """

    metrics: tuple[str, ...]
    title: str
    matters: float
    is_higher_better: bool = True
    is_logarithm: bool = False


class Question(NamedTuple):
    """A claim of the paper: a part of HA2G improves these measures; `control` is the name of the control without it."""

    claim: str
    control: str
    measures: tuple[Measure, ...]


class Answer(NamedTuple):
    """Answer to a question.

    Attributes:
        effects: effect on each measure with Bonferroni's interval, None without blocks.
        p_value: with Holm's correction, None without errors.
        verdict: `HELD`, `NOT_HELD` or `UNDECIDED`.
    """

    question: Question
    effects: tuple[Spread | None, ...]
    p_value: float | None
    verdict: str


QUESTIONS = (
    Question(
        "the contrastive term brings the word to the hands",
        OTHER_TEXT,
        (
            Measure(("talk.finger_correlation",), "fingers r", 0.1),
            Measure(("talk.probe_accuracy",), "probe", 0.05),
        ),
    ),
    Question(
        "the hierarchy of the pose inferer makes hands more like the truth",
        HOLISTIC,
        (Measure((f"talk.{HANDS_FGD}",), "log FGD of the hands", math.log(1.1), False, True),),
    ),
    Question(
        "the style coordinator gives the style of a person who was not seen",
        NO_COORDINATOR,
        (Measure(("talk.style_handedness", "talk.style_amplitude"), "style r", 0.1),),
    ),
)
MEASURES = tuple(measure for question in QUESTIONS for measure in question.measures)
NOT_TRAINED = "not trained"
_FAILED = "not passed"
_CLAIM_HEAD = ("claim", "effect [interval]", "matters from", "p", "verdict", "blocks", "more blocks to decide")


def table(size: str) -> Table:
    """Return the rows of the study at a size: the oracle, then the eight cells, the full model first."""
    rows = tuple(Row(name, "ha2g", changes, Published()) for name, changes in presets.factorial(size).items())
    return Table(
        "Factorial study: hierarchy, contrastive term, style coordinator", "none", Published(), rows, rows[1].name
    )


def effect(scores: RowScores, control: str, measure: Measure) -> dict[int, Measured]:
    """Return the effect of a part by seed, for each block that has all eight cells."""
    found = {row: cell_values(mine, measure) for row, mine in scores.items() if row != ORACLE}
    if len(found) < 2 ** len(QUESTIONS):
        return {}
    signs, half = {row: -1 if control in row.split(", ") else 1 for row in found}, len(found) / 2
    return {
        seed: Measured(
            sum(sign * found[row][seed].value for row, sign in signs.items()) / half,
            np.sum([sign * found[row][seed].without for row, sign in signs.items()], axis=0) / half,
        )
        for seed in sorted(set.intersection(*(set(mine) for mine in found.values())))
    }


def cell_values(scores: Mapping[int, Scores], measure: Measure) -> dict[int, Measured]:
    """Return a measure of a cell by seed, the mean of its metrics, without seeds that lack one."""
    parts = [by_seed(scores, SPLITS[-1], metric) for metric in measure.metrics]
    function = np.log if measure.is_logarithm else np.asarray
    return {
        seed: Measured(
            float(np.mean([function(part[seed].value) for part in parts])),
            np.mean([function(part[seed].without) for part in parts], axis=0),
        )
        for seed in set.intersection(*(set(part) for part in parts))
    }


def judge(effects: Sequence[Sequence[Sequence[Measured]]], questions: Sequence[Question] = QUESTIONS) -> list[Answer]:
    """Answer the questions from their effects by question, measure and block; see `_RULES`."""
    means = [[with_freedom_of_seeds(combine(blocks)) if blocks else None for blocks in mine] for mine in effects]
    p_values = [max(t_test(mean) if mean and mean.error is not None else 1.0 for mean in mine) for mine in means]
    answers = []
    for question, mine, value in zip(questions, means, holm(p_values), strict=True):
        spreads = tuple(interval(mean, (1 - LEVEL) / len(questions)) if mean else None for mean in mine)
        has_errors = all(mean and mean.error is not None for mean in mine)
        verdict = _decide(question, spreads, value) if has_errors else UNDECIDED
        answers.append(Answer(question, spreads, value if has_errors else None, verdict))
    return answers


def _advantage(measure: Measure, value: float | None) -> float:
    return math.nan if value is None else value if measure.is_higher_better else -value


def _decide(question: Question, spreads: Sequence[Spread | None], value: float) -> str:
    pairs = [(measure, spread) for measure, spread in zip(question.measures, spreads, strict=True) if spread]
    if value <= 1 - LEVEL and all(_advantage(measure, spread.mean) > 0 for measure, spread in pairs):
        return HELD
    bounds = [
        (_advantage(measure, spread.high if measure.is_higher_better else spread.low), measure.matters)
        for measure, spread in pairs
    ]
    return NOT_HELD if any(bound < matters for bound, matters in bounds) else UNDECIDED


def more_blocks(question: Question, effects: Sequence[Sequence[Measured]]) -> int | None:
    """Return the least number of further blocks that decide an undecided question, with a probability of 80 % for each
    measure, if effects and spreads stay the same; None if more than 64 blocks would be needed.

    A claim is decided by intervals that exclude 0 in all of its measures, or the advantage that matters in one of them.
    The variance over blocks falls with their number, that over speakers does not.
    """
    there = min(map(len, effects))
    if there < _LEAST_BLOCKS:  # one block has no spread
        return _LEAST_BLOCKS - there
    tail = (1 - LEVEL) / len(QUESTIONS)
    for count in range(there + 1, _MOST_BLOCKS + 1):
        reach = float(stats.t.ppf(1 - tail / 2, count - 1) + stats.t.ppf(_POWER, count - 1))
        excludes_zero, excludes_what_matters = [], []
        for measure, blocks in zip(question.measures, effects, strict=True):
            values = np.array([block.value for block in blocks])
            speakers = jackknife_variance(np.mean([block.without for block in blocks], axis=0))
            half, advantage = (
                reach * math.sqrt(values.var(ddof=1) / count + speakers),
                _advantage(measure, values.mean()),
            )
            excludes_zero.append(advantage >= half)
            excludes_what_matters.append(measure.matters - advantage >= half)
        if all(excludes_zero) or any(excludes_what_matters):
            return count - there
    return None


def gate(scores: RowScores, size: str) -> tuple[dict[str, float], bool]:
    """Return fingers r on the validation split of the oracle and of the full model (the mean over blocks), as far as
    available, and whether both pass; the debug size has no gate.
    """
    found = {row: by_seed(scores.get(row, {}), SPLITS[0], _GATE_MEASURE) for row in GATE_ROWS}
    values = {row: float(np.mean([each.value for each in mine.values()])) for row, mine in found.items() if mine}
    return values, size == "debug" or (len(values) == 2 and min(values.values()) >= _GATE)


def describe(records: Mapping[str, Mapping[int, Record]]) -> str:
    """Say how many runs and complete blocks there are, and their hours."""
    there = {row: {seed for seed, one in mine.items() if one.scores is not None} for row, mine in records.items()}
    hours = sum(one.hours for mine in records.values() for one in mine.values())
    runs = f"{sum(map(len, there.values()))} of {sum(map(len, records.values()))} runs"
    return f"{len(_blocks(records))} of {max(map(len, records.values()))} blocks, {runs}, {hours:.1f} hours of training"


def _blocks(records: Mapping[str, Mapping[int, Record]]) -> list[int]:
    cells = [mine for row, mine in records.items() if row != ORACLE]
    return sorted(seed for seed in cells[0] if all(mine[seed].scores is not None for mine in cells))


def as_markdown(
    size: str,
    records: Mapping[str, Mapping[int, Record]],
    scores: RowScores,
    failures: Mapping[str, Mapping[int, str]],
    numbers: str,
) -> str:
    """Write the page, which depends only on the scores and on the reasons for failures.

    Args:
        numbers: name of the file beside the page with all numbers.
    """
    blocks, count = _blocks(records), max(map(len, records.values()))
    missing = sum(one.scores is None for mine in records.values() for one in mine.values())
    measured, has_passed = gate(scores, size)
    if size == "debug":
        said = "none at this size"
    elif has_passed:
        said = "passed"
    else:
        said = _FAILED if min(measured.values(), default=_GATE) < _GATE else "open"
    effects = [[[*each.values()] for each in mine] for mine in _effects(scores if has_passed else {})]
    answers = judge(effects)
    cells = [("cell", *(measure.title.removeprefix("log ") for measure in MEASURES), "seeds")]
    failed = [
        f"- {row}, seed {seed}: {text}"
        for row, mine in failures.items()
        for seed, text in mine.items()
        if text != NOT_TRAINED
    ]
    return "\n".join(
        [
            f"# Factorial study of HA2G on Talk ({size})",
            "",
            "The [protocol](factorial.md) was written before the first run; the training was changed after runs of "
            "its gate, as [its page](factorial.md#the-change-of-the-training) says. All numbers, and hours, machine "
            f"and commit of each run: [{numbers}]({numbers}).",
            "",
            f"Blocks: {len(blocks)} of {count}{_listed(blocks)}; runs that are missing: {missing}.",
            *(["The debug size shows that everything runs; its numbers say nothing."] if size == "debug" else []),
            "",
            "## Gate",
            "",
            f"Fingers r on the split {SPLITS[0]}, at least {_GATE} in both: **{said}**.",
            "",
            *(f"- {row}: {number(measured[row]) if row in measured else 'missing'}" for row in GATE_ROWS),
            "",
            "## Claims",
            "",
            _RULES,
            "",
            markdown([_CLAIM_HEAD, *(_claim_line(*each, said == _FAILED) for each in zip(answers, effects))]),
            "",
            f"## Cells on {SPLITS[-1]}",
            "",
            f"Means over seeds ± half their {LEVEL:.0%} interval.",
            "",
            markdown([*cells, *(_cell_line(row, mine) for row, mine in scores.items())]),
            "",
            *(["## Failed", "", *failed, ""] if failed else []),
        ]
    )


def _effects(scores: RowScores) -> list[list[dict[int, Measured]]]:
    return [[effect(scores, question.control, measure) for measure in question.measures] for question in QUESTIONS]


def _listed(blocks: Sequence[int]) -> str:
    return f" (seeds {', '.join(map(str, blocks))})" if blocks else ""


def _claim_line(answer: Answer, effects: Sequence[Sequence[Measured]], has_ended: bool) -> tuple[str, ...]:
    pairs = [*zip(answer.question.measures, answer.effects, strict=True)]
    more = 0 if answer.verdict != UNDECIDED else more_blocks(answer.question, effects)
    at_least = "at least " if answer.p_value is None else ""
    return (
        answer.question.claim,
        "; ".join(
            f"{measure.title} {spread_text(spread)}{'' if measure.is_higher_better else ' (lower is better)'}"
            for measure, spread in pairs
        ),
        "; ".join(number(measure.matters) for measure, _ in pairs),
        "-" if answer.p_value is None else f"{answer.p_value:.3f}",
        f"**{answer.verdict}**",
        str(min(map(len, effects))),
        "-" if has_ended else "out of reach" if more is None else f"{at_least}{more}",
    )


def _cell_line(row: str, scores: Mapping[int, Scores]) -> tuple[str, ...]:
    cells = []
    for measure in MEASURES:
        values = [one.value for one in cell_values(scores, measure._replace(is_logarithm=False)).values()]
        cells.append(plus_minus(over_seeds(values)) if values else "-")
    return (row, *cells, str(len(scores)))


def all_numbers(size: str, records: Mapping[str, Mapping[int, Record]], scores: RowScores) -> Iterator[Sequence[Any]]:
    """Yield the lines of `tables.every_number` for the effects by block and for the runs, with hours and machines."""
    for question, mine in zip(QUESTIONS, _effects(scores if gate(scores, size)[1] else {}), strict=True):
        for measure, blocks in zip(question.measures, mine, strict=True):
            for seed, block in blocks.items():
                yield "effect", SPLITS[-1], f"less {question.control}", f"{measure.title}, seed {seed}", block.value
    for row, mine in records.items():
        for seed, one in mine.items():
            if one.scores is not None:
                starts = ", ".join(f"{start.get('commit')} {start['hardware']['devices']}" for start in one.starts)
                yield "run", "", row, f"seed {seed}, scored step {one.scored_step}, {starts}", f"{one.hours:.3f} hours"

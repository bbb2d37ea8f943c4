"""The factorial study: what decides its three claims, and its page. docs/results/factorial.md has the protocol."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from ha2g_jax.config import presets
from ha2g_jax.config.presets import HOLISTIC, NO_COORDINATOR, ORACLE, OTHER_TEXT
from ha2g_jax.evaluation.charts import markdown, number
from ha2g_jax.metrics.uncertainty import holm
from tables.claims import (
    HELD,
    LEVEL,
    NOT_HELD,
    UNDECIDED,
    Mean,
    Measured,
    Spread,
    combine,
    interval,
    over_seeds,
    t_test,
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
An effect is the mean over blocks of the mean of the four cells with a part less that of the four without it; errors \
hold for other trainings and other speakers. *Held*: all measures of a claim are better, and the largest of their \
p-values, with Holm's correction for three claims, is at most {1 - LEVEL:.2g}. *Not held*: else, if an advantage that \
would matter is outside of the interval of one of them; intervals have Bonferroni's level for three claims. \
*Undecided*: else."""


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
    """A claim of the paper: a part of HA2G is there for these measures; `control` is the name of what takes it away."""

    claim: str
    control: str
    measures: tuple[Measure, ...]


class Answer(NamedTuple):
    """Effects by measure with Bonferroni's intervals, None without blocks; corrected p-value; verdict; and how many
    blocks would be needed to decide, 0 where it is decided, None where that is not known.
    """

    question: Question
    effects: tuple[Spread | None, ...]
    p_value: float | None
    verdict: str
    blocks: int | None


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
_CLAIM_HEAD = ("claim", "effect [interval]", "p", "verdict", "more blocks to decide")


def table(size: str) -> Table:
    """Return the rows of the study at a size: the oracle, then the eight cells, the full model first."""
    rows = tuple(Row(name, "ha2g", changes, Published()) for name, changes in presets.factorial(size).items())
    return Table(
        "Factorial study: hierarchy, contrastive term, style coordinator", "none", Published(), rows, rows[1].name
    )


def effect(scores: RowScores, control: str, measure: Measure) -> list[Measured]:
    """Return the effect of a part in each block that has all eight cells, in the order of the seeds."""
    found = {row: _values(mine, measure) for row, mine in scores.items() if row != ORACLE}
    if len(found) < 2 ** len(QUESTIONS):
        return []
    signs, half = {row: -1 if control in row.split(", ") else 1 for row in found}, len(found) / 2
    blocks = sorted(set.intersection(*(set(mine) for mine in found.values())))
    return [
        Measured(
            sum(sign * found[row][seed].value for row, sign in signs.items()) / half,
            np.sum([sign * found[row][seed].without for row, sign in signs.items()], axis=0) / half,
        )
        for seed in blocks
    ]


def _values(scores: Mapping[int, Scores], measure: Measure) -> dict[int, Measured]:
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
    means = [[_mean(blocks) for blocks in mine] for mine in effects]
    p_values = [
        None if any(mean is None or mean.error is None for mean in mine) else max(t_test(mean) for mean in mine if mean)
        for mine in means
    ]
    corrected = iter(holm([value for value in p_values if value is not None]))
    answers = []
    for question, mine, value in zip(questions, means, p_values, strict=True):
        spreads = tuple(mean and interval(mean, _tail(questions)) for mean in mine)
        if value is None:
            answers.append(Answer(question, spreads, None, UNDECIDED, None))
            continue
        value = next(corrected)
        verdict = _decide(question, spreads, value)
        blocks = (
            0
            if verdict != UNDECIDED
            else max(
                (_needed(mean, measure, _tail(questions)) for mean, measure in zip(mine, question.measures) if mean),
                key=lambda count: math.inf if count is None else count,
            )
        )
        answers.append(Answer(question, spreads, value, verdict, blocks))
    return answers


def _tail(questions: Sequence[Question]) -> float:
    return (1 - LEVEL) / len(questions)


def _mean(blocks: Sequence[Measured]) -> Mean | None:
    if not blocks:
        return None
    mean = combine(blocks)
    return mean._replace(freedom=min(mean.freedom, mean.num - 1))


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


def _needed(mean: Mean, measure: Measure, tail: float) -> int | None:
    """Return the least number of blocks that decides a measure with a probability of 80 %, if effect and error stay.

    With n blocks the interval is narrow enough that it excludes 0 or the advantage that matters, whichever is farther
    from the effect. None where more than 64 would be needed. All of the error is taken to fall with the blocks, that of
    speakers as well, so that the number is a lower bound.
    """
    advantage = _advantage(measure, mean.value)
    distance = max(advantage, measure.matters - advantage)
    for count in range(_LEAST_BLOCKS, _MOST_BLOCKS + 1):
        error = (mean.error or 0.0) * math.sqrt(mean.num / count)
        if distance >= (stats.t.ppf(1 - tail / 2, count - 1) + stats.t.ppf(_POWER, count - 1)) * error:
            return count
    return None


def gate(scores: RowScores, size: str) -> tuple[dict[str, float], bool]:
    """Return fingers r on the validation split of the oracle and of the full model, its mean over blocks, as far as
    they are there, and whether both pass; the debug size has no gate.
    """
    found = {row: by_seed(scores.get(row, {}), SPLITS[0], _GATE_MEASURE) for row in GATE_ROWS}
    values = {row: float(np.mean([each.value for each in mine.values()])) for row, mine in found.items() if mine}
    return values, size == "debug" or (len(values) == 2 and min(values.values()) >= _GATE)


def describe(records: Mapping[str, Mapping[int, Record]]) -> str:
    """Say how many runs and whole blocks are there, and their hours."""
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
    """Write the page, whose bytes depend on the scores and on the reasons of failures alone.

    Args:
        numbers: name of the file beside the page with all numbers.
    """
    blocks, count = _blocks(records), max(map(len, records.values()))
    missing = sum(one.scores is None for mine in records.values() for one in mine.values())
    measured, has_passed = gate(scores, size)
    said = (
        "none at this size"
        if size == "debug"
        else "passed"
        if has_passed
        else "not passed"
        if min(measured.values(), default=_GATE) < _GATE
        else "open"
    )
    answers = judge(_effects(scores if has_passed else {}))
    cells = [("cell", *(measure.title for measure in MEASURES), "seeds")]
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
            f"The [protocol](factorial.md) was written before the first run. All numbers, and hours, machine and "
            f"commit of each run: [{numbers}]({numbers}).",
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
            markdown([_CLAIM_HEAD, *(_claim_line(answer, len(blocks)) for answer in answers)]),
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


def _effects(scores: RowScores) -> list[list[list[Measured]]]:
    return [[effect(scores, question.control, measure) for measure in question.measures] for question in QUESTIONS]


def _listed(blocks: Sequence[int]) -> str:
    return f" (seeds {', '.join(map(str, blocks))})" if blocks else ""


def _claim_line(answer: Answer, blocks: int) -> tuple[str, ...]:
    pairs = zip(answer.question.measures, answer.effects, strict=True)
    if answer.p_value is None:  # one block has no spread
        more = f"at least {_LEAST_BLOCKS - blocks}" if blocks < _LEAST_BLOCKS else "-"
    elif answer.verdict == UNDECIDED:
        more = "out of reach" if answer.blocks is None else str(max(answer.blocks - blocks, 1))
    else:
        more = "0"
    return (
        answer.question.claim,
        "; ".join(f"{measure.title} {spread_text(spread)}" for measure, spread in pairs),
        "-" if answer.p_value is None else f"{answer.p_value:.3f}",
        f"**{answer.verdict}**",
        more,
    )


def _cell_line(row: str, scores: Mapping[int, Scores]) -> tuple[str, ...]:
    cells = []
    for measure in MEASURES:
        values = [one.value for one in _values(scores, measure).values()]
        cells.append(plus_minus(over_seeds(values)) if values else "-")
    return (row, *cells, str(len(scores)))


def all_numbers(records: Mapping[str, Mapping[int, Record]], scores: RowScores) -> Iterator[Sequence[Any]]:
    """Yield the lines of `tables.every_number` for the effects by block and for the runs, with hours and machines."""
    for question, mine in zip(QUESTIONS, _effects(scores), strict=True):
        for measure, blocks in zip(question.measures, mine, strict=True):
            for index, block in enumerate(blocks):
                yield (
                    "effect",
                    SPLITS[-1],
                    f"without {question.control}",
                    f"{measure.title}, block {index}",
                    block.value,
                )
    for row, mine in records.items():
        for seed, one in mine.items():
            if one.scores is not None:
                starts = ", ".join(f"{start.get('commit')} {start['hardware']['devices']}" for start in one.starts)
                yield "run", "", row, f"seed {seed}, scored step {one.scored_step}, {starts}", f"{one.hours:.3f} hours"

"""Simulate the power of the factorial study from the spreads of its complete blocks.

    python experiments/power.py

Prints the spreads and, for several numbers of blocks, the smallest effects that are held with a probability of 80 %,
and how often a part without any effect is not held. docs/results/factorial.md quotes the numbers.
"""

import pathlib
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from tables.claims import HELD, NOT_HELD, Measured
from tables.factorial import MEASURES, QUESTIONS, SPEAKERS, TABLE, cell_values, effect, judge
from tables.plan import Request, plan_table
from tables.tables import RowScores

from ha2g_jax.config.presets import ORACLE
from ha2g_jax.evaluation.charts import markdown
from ha2g_jax.metrics.uncertainty import jackknife_variance

FACTORIAL = pathlib.Path(__file__).parent / "factorial-runs" / "small"
BLOCKS = (2, 4, 8, 16)

_HEARD = SPEAKERS // 6  # speakers of the split in the corpus of the factorial study
_POWER, _DRAWS, _SEED = 0.8, 500, 0
_SIZES = np.arange(0.2, 4.01, 0.2)  # effects, in units of what matters


class Spreads(NamedTuple):
    """Standard deviation of a run within its block, and error of an effect by the choice of speakers."""

    run: float
    speakers: float


def read_spreads(blocks: RowScores) -> list[list[Spreads]]:
    """Return the spreads of each measure of each question, of the complete blocks.

    The spread of a run is the residual of the cells after the means of cell and block are subtracted. The error by
    speakers is the jackknife's, of the effect.
    """
    found = []
    for question in QUESTIONS:
        found.append([])
        for measure in question.measures:
            effects = effect(blocks, question.control, measure)
            cells = [cell_values(mine, measure) for row, mine in blocks.items() if row != ORACLE]
            run = _residual([[cell[seed].value for seed in effects] for cell in cells])
            speakers = jackknife_variance(np.mean([block.without for block in effects.values()], axis=0)) ** 0.5
            found[-1].append(Spreads(run, speakers))
    return found


def _residual(scores: Sequence[Sequence[float]]) -> float:
    table = np.array(scores)
    left = table - table.mean(axis=0) - table.mean(axis=1, keepdims=True) + table.mean()
    return float(np.sqrt(np.sum(left**2) / ((table.shape[0] - 1) * (table.shape[1] - 1))))


def draw_effects(
    rng: np.random.Generator, sizes: list[list[float]], spreads: list[list[Spreads]], blocks: int
) -> list[list[list[Measured]]]:
    """Draw the effects of each measure in each block: of eight runs, and of speakers that all blocks share."""
    drawn = []
    for mine, errors in zip(sizes, spreads, strict=True):
        drawn.append([])
        for size, error in zip(mine, errors, strict=True):
            own = rng.normal(0, error.speakers * _HEARD**0.5, _HEARD)
            values = size + own.mean() + rng.normal(0, error.run * 0.5**0.5, blocks)  # 2 means of 4 runs
            without = (own.mean() - own) / (_HEARD - 1)
            drawn[-1].append([Measured(value, value + without) for value in values.tolist()])
    return drawn


def simulate(spreads: list[list[Spreads]], blocks: int) -> list[tuple[float, float]]:
    """Return for each question the smallest effect that is held with a probability of 80 %, and how often a part
    without any effect is not held.

    All measures have the same effect in units of what matters, and the other parts have none; NaN above 4.
    """
    rng, found = np.random.default_rng(_SEED), []
    nothing = [[0.0 for _ in question.measures] for question in QUESTIONS]
    idle = [judge(draw_effects(rng, nothing, spreads, blocks)) for _ in range(_DRAWS)]
    for index, question in enumerate(QUESTIONS):
        smallest = np.nan
        for size in _SIZES:
            sizes = [list(mine) for mine in nothing]
            sizes[index] = [size * each.matters * (1 if each.is_higher_better else -1) for each in question.measures]
            held = [judge(draw_effects(rng, sizes, spreads, blocks))[index].verdict == HELD for _ in range(_DRAWS // 2)]
            if np.mean(held) >= _POWER:
                smallest = float(size)
                break
        found.append((smallest, float(np.mean([answers[index].verdict == NOT_HELD for answers in idle]))))
    return found


def main() -> int:
    """Print the spreads and the power."""
    plan = plan_table(Request(TABLE, "talk", FACTORIAL.name, "", (0,), FACTORIAL, has_training=False))
    found = {row: {run.seed: plan.kept.find(run) for run in runs} for row, runs in plan.rows.items()}
    scores = {
        row: {seed: one.scores for seed, one in mine.items() if one and one.scores} for row, mine in found.items()
    }
    spreads = read_spreads(scores)
    lines = [("measure", "smallest effect that matters", "run", "speakers")]
    lines += [
        (measure.title, f"{measure.matters:.3f}", f"{error.run:.3f}", f"{error.speakers:.3f}")
        for measure, error in zip(MEASURES, [error for mine in spreads for error in mine], strict=True)
    ]
    print(markdown(lines), "\n")
    rows = [
        (
            "blocks",
            *(f"{question.control}: held from, times what matters; not held without effect" for question in QUESTIONS),
        )
    ]
    for count in BLOCKS:
        found = [("-" if np.isnan(size) else f"{size:.1f}", ratio) for size, ratio in simulate(spreads, count)]
        rows.append((str(count), *(f"{size}; {ratio:.0%}" for size, ratio in found)))
    print(markdown(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())

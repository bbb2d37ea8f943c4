"""Simulate the power of the factorial study from the spreads of the stored scores of the study before it.

    python experiments/power.py

Prints the spreads and, for several numbers of blocks, the smallest effects that are held with a probability of 80 %,
and how often a part without any effect is not held. docs/results/factorial.md quotes the numbers.
"""

import pathlib
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from tables.claims import HELD, NOT_HELD, Measured, jackknife_variance
from tables.factorial import HANDS_FGD, MEASURES, QUESTIONS, SPEAKERS, judge
from tables.kept_runs import Kept, read_kept

from ha2g_jax.evaluation.charts import markdown

STUDY = pathlib.Path(__file__).parent / "talk-runs"
BLOCKS = (2, 4, 8, 16)

_SPLIT, _ABLATIONS_OF_STEPS = "test_unseen_speakers", 2000
_HEARD = SPEAKERS // 6  # speakers of the split in the corpus of the factorial study
_POWER, _DRAWS, _SEED = 0.8, 500, 0
_SIZES = np.arange(0.2, 4.01, 0.2)  # effects, in units of what matters


class Spreads(NamedTuple):
    """Standard deviations: of a run within its block, and of an effect by the choice of speakers."""

    run: float
    speakers: float


def read_spreads(kept: Kept) -> list[list[Spreads]]:
    """Return the spreads of each measure of each question, from runs that are alike but for their row.

    A run's is what is left of the scores of rows and seeds without the mean of the row and of the seed. Rows are the
    ablations of Tables 3 and 4 with all audio levels; for fingers r, which is at its floor in them, the baselines that
    read the words. By speakers, a difference of two rows in fingers r has a part of the error of one run. Other
    measures, which were not stored by speaker, are given the same part, and FGD none. An effect is the mean of four
    differences, and is given half of their error.
    """
    rows: dict[str, dict[int, Mapping[str, Any]]] = {}
    for record in kept.records:
        is_ablation = record.config["train"]["steps"] == _ABLATIONS_OF_STEPS and "-only-" not in record.name
        if record.scores is None:
            continue
        if is_ablation or record.config["method"] in ("trimodal", "seq2seq", "joint_embedding"):
            kind = "ablation" if is_ablation else "read" if "alone" not in record.name else ""
            rows.setdefault(f"{kind} {record.name.rsplit('-', 1)[0]}", {})[record.seed] = record.scores["splits"][
                _SPLIT
            ]
    ablations, readers = (
        [mine for name, mine in rows.items() if name.startswith(kind)] for kind in ("ablation", "read")
    )
    part = _shared_part(ablations) * (len(_without(readers[0])[0]) / _HEARD) ** 0.5 / 2
    found = []
    for question in QUESTIONS:
        found.append([])
        for measure in question.measures:
            parts = [_spreads(readers if "finger" in name else ablations, name, part) for name in measure.metrics]
            found[-1].append(Spreads(*(np.sqrt(np.sum(np.square(parts), axis=0)) / len(parts)).tolist()))
    return found


def _spreads(rows: list[dict[int, Any]], metric: str, part: float) -> Spreads:
    if metric == f"talk.{HANDS_FGD}":  # was not stored: the logarithm of the FGD of all bones
        return Spreads(_residual([[np.log(_all_bones(one)) for one in _ordered(mine)] for mine in rows]), 0.0)
    known = [[one["talk"]["rows"]["model"][metric.removeprefix("talk.")] for one in _ordered(mine)] for mine in rows]
    error = float(np.mean([one["error"] for mine in known for one in mine]))
    return Spreads(_residual([[one["value"] for one in mine] for mine in known]), part * error)


def _all_bones(scores: Mapping[str, Any]) -> float:
    return scores["evaluation"]["rows"]["model"]["fgd"]["value"]


def _ordered(mine: Mapping[int, Any]) -> list[Any]:
    return [mine[seed] for seed in sorted(mine)]


def _residual(values: Any) -> float:
    values = np.array(values, float)
    left = values - values.mean(axis=0) - values.mean(axis=1, keepdims=True) + values.mean()
    return float(np.sqrt(np.sum(left**2) / ((values.shape[0] - 1) * (values.shape[1] - 1))))


def _shared_part(rows: list[dict[int, Mapping[str, Any]]]) -> float:
    """Return the error by speakers of the difference of two rows over that of one row, in fingers r."""
    without = [_without(mine).mean(axis=0) for mine in rows]
    pairs = [jackknife_variance(a - b) for index, a in enumerate(without) for b in without[:index]]
    return float((np.mean(pairs) / np.mean([jackknife_variance(a) for a in without])) ** 0.5)


def _without(mine: Mapping[int, Any]) -> np.ndarray:
    """Return fingers r (seeds, speakers) without each speaker."""
    return np.array([list(one["talk"]["without_speakers"]["finger_correlation"].values()) for one in _ordered(mine)])


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
    """Return for each question the smallest effect that is held with a probability of 80 %, all measures alike in units
    of what matters and the other parts without effect, NaN above 4; and how often no effect is not held.
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
    spreads = read_spreads(read_kept(STUDY))
    lines = [("measure", "matters from", "run", "speakers")]
    lines += [
        (measure.title, f"{measure.matters:.3f}", f"{error.run:.3f}", f"{error.speakers:.3f}")
        for measure, error in zip(MEASURES, [error for mine in spreads for error in mine], strict=True)
    ]
    print(markdown(lines), "\n")
    head = [
        (
            "blocks",
            *(f"{question.control}: held from, times what matters; not held without effect" for question in QUESTIONS),
        )
    ]
    for blocks in BLOCKS:
        found = simulate(spreads, blocks)
        head.append((str(blocks), *(f"{size:.1f}; {ratio:.0%}" for size, ratio in found)))
    print(markdown(head))
    return 0


if __name__ == "__main__":
    sys.exit(main())

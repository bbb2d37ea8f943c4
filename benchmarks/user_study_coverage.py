"""How often the intervals of ha2g study analyse hold the truth, for simulated participants whose truth is known.

python benchmarks/user_study_coverage.py            # 1000 studies of each design, about ten minutes on one core
python benchmarks/user_study_coverage.py --studies 100

Each study draws new participants and new clips. Ratings are whole numbers from 1 to 5 of normal opinions; preferences
follow Bradley and Terry's model and choices of matched motion a share, both with a share of choices for neither.
"independent" has no differences between participants and clips but of how strict and how hard they are; in "varied",
systems differ by participant and by clip, too.
"""

import argparse
import json
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, special, stats

from ha2g_jax.apps.user_study import bradley_terry
from ha2g_jax.apps.user_study.answers import Choices
from ha2g_jax.apps.user_study.estimates import CrossedEstimate, share, system_differences
from ha2g_jax.cli.parser import positive


class Design(NamedTuple):
    """A study: participants, clips, systems and items that each participant answers (None for all)."""

    participants: int
    clips: int
    systems: int = 2
    items: int | None = None

    def draw(self, random: np.random.Generator, kinds: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return participant, clip and kind (system, or pair of systems) of each answer."""
        cells = np.array([random.permutation(self.clips * kinds) for _ in range(self.participants)])
        cells = cells[:, : self.items]
        participants = np.repeat(np.arange(self.participants), cells.shape[1])
        return participants, *np.divmod(cells.ravel(), kinds)


class Variation(NamedTuple):
    """Standard deviations, of systems by participant and by clip: opinions in points, choices in logits."""

    participants: float = 0.0
    clips: float = 0.0


Trial = Callable[[np.random.Generator, Design, Variation], tuple[float, float, float]]
"""Function to the bounds of an interval of a new study, and the truth."""

DESIGNS = (
    *(Design(10, 5), Design(20, 8), Design(20, 10, 4, 20), Design(20, 10, 6, 24)),
    *(Design(100, 10), Design(100, 10, 3, 12)),
)
VARIATIONS = {"independent": (Variation(), Variation()), "varied": (Variation(0.3, 0.15), Variation(0.5, 0.3))}
_STRICT, _HARD, _REST = 0.5, 0.3, 0.8  # points
_EQUAL = 0.2
_SHARE = 0.65
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(61)  # quadrature over normal logits


def opinion(random: np.random.Generator, design: Design, variation: Variation) -> tuple[float, float, float]:
    """Return the interval of the difference of mean opinion scores of the first and the last system."""
    participants, clips, systems = design.draw(random, design.systems)
    means = np.linspace(3.4, 2.8, design.systems)
    scores = means[systems] + random.normal(0, _STRICT, design.participants)[participants]
    scores += random.normal(0, _HARD, design.clips)[clips] + random.normal(0, _REST, len(scores))
    scores += random.normal(0, variation.participants, (design.participants, design.systems))[participants, systems]
    scores += random.normal(0, variation.clips, (design.clips, design.systems))[clips, systems]
    found = system_differences(np.clip(np.round(scores), 1, 5), participants, clips, systems, design.systems)
    spread = np.sqrt(_STRICT**2 + _HARD**2 + _REST**2 + np.square(variation).sum())
    first, last = (1 + stats.norm.sf(np.arange(1.5, 5), means[at], spread).sum() for at in (0, -1))
    return *_bounds(found, design.systems - 2), first - last


def strength(random: np.random.Generator, design: Design, variation: Variation) -> tuple[float, float, float]:
    """Return the interval of the difference of strengths of the first and the last system."""
    first, second = np.triu_indices(design.systems, 1)
    participants, clips, pairs = design.draw(random, len(first))
    first, second = first[pairs], second[pairs]
    truth = np.linspace(0.5, -0.5, design.systems)
    own = random.normal(0, variation.participants, (design.participants, design.systems))
    of_clips = random.normal(0, variation.clips, (design.clips, design.systems))
    logits = truth[first] - truth[second] + own[participants, first] - own[participants, second]
    logits += of_clips[clips, first] - of_clips[clips, second]
    outcome = _outcome(random, special.expit(logits))
    found = bradley_terry.estimate(Choices(participants, clips, clips, first, second, outcome), design.systems)
    spread = float(np.sqrt(2) * np.hypot(*variation))
    marginal = _mean_share(truth[0] - truth[-1], spread)  # of all participants and clips
    return *_bounds(found.differences, design.systems - 2), float(special.logit(marginal))


def matched(random: np.random.Generator, design: Design, variation: Variation) -> tuple[float, float, float]:
    """Return the interval of the share of matched motion of one system."""
    participants, clips, _ = design._replace(items=None).draw(random, 1)
    spread = float(np.hypot(*variation))
    centre = optimize.root_scalar(lambda logit: _mean_share(logit, spread) - _SHARE, bracket=(-9, 9)).root
    logits = centre + random.normal(0, variation.participants, design.participants)[participants]
    logits += random.normal(0, variation.clips, design.clips)[clips]
    system = np.zeros(len(clips), int)
    found = share(Choices(participants, clips, clips, system, system, _outcome(random, special.expit(logits))))
    return found.low, found.high, _SHARE


TRIALS: dict[str, Trial] = {"MOS difference": opinion, "strength difference": strength, "matched share": matched}


def measure(trial: Trial, design: Design, variation: Variation, studies: int, seed: int = 0) -> tuple[float, float]:
    """Return the share of intervals that hold the truth, and their median width.

    Args:
        trial: one of `TRIALS`.
        design: design of the studies.
        variation: how much systems differ by participant and clip.
        studies: number of studies.
        seed: seed of all draws.
    """
    random = np.random.default_rng(seed)
    found = np.array([trial(random, design, variation) for _ in range(studies)])
    low, high, truth = found.T
    return float(((low <= truth) & (truth <= high)).mean()), float(np.median(high - low))


def _outcome(random: np.random.Generator, first: np.ndarray) -> np.ndarray:
    outcome = np.where(random.random(len(first)) < first, 1, -1)
    return np.where(random.random(len(first)) < _EQUAL, 0, outcome)


def _mean_share(logit: float, spread: float) -> float:
    return float(_WEIGHTS @ special.expit(logit + spread * _NODES) / _WEIGHTS.sum())


def _bounds(found: CrossedEstimate, at: int) -> tuple[float, float]:
    return float(found.low[at]), float(found.high[at])


def main() -> None:
    """Print how often the intervals of `ha2g study analyse` hold the truth, by design."""
    parser = argparse.ArgumentParser(description="Measure how often intervals of user studies hold the truth.")
    parser.add_argument("--studies", type=positive, default=1000, metavar="N", help="studies a design (default: 1000)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    rows = []
    for name, trial in TRIALS.items():
        for design in DESIGNS:
            if trial is matched:
                if design.systems > 2:
                    continue
                design = Design(design.participants, design.clips, systems=1)
            row: dict[str, Any] = {"statistic": name, **design._asdict()}
            for variation, (opinions, logits) in VARIATIONS.items():
                spread = opinions if trial is opinion else logits
                row[variation] = round(measure(trial, design, spread, arguments.studies)[0], 4)
            rows.append(row)
            print(f"{name}, {design}", file=sys.stderr)
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"| {' | '.join(rows[0])} |\n|{'---|' * len(rows[0])}")
    for row in rows:
        print(f"| {' | '.join('all' if value is None else str(value) for value in row.values())} |")


if __name__ == "__main__":
    main()

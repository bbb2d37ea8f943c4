"""How many participants a study needs: simulated studies, analysed by the functions that analyse answers.

In a simulated study, each participant answers `items` of `clips` clips, and for a difference of scores each of these
for both systems. A difference d of a participant and a clip is mean + participant + clip + rest, each normal; a choice
is one of two, with logits that vary normally over participants and clips around what gives the share.
"""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from ha2g_jax.apps.user_study.crossed import LEVEL, crossed, ratio
from ha2g_jax.apps.user_study.shares import interval
from ha2g_jax.errors import UserError
from ha2g_jax.progress import progress_bar

FEWEST = 3
"""Participants of the smallest study that is tried."""

_GRID = (5, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320, 480, 640, 960)
_NODES = 61  # of the quadrature over normal logits
_CELLS, _CLIPS = 2_000_000, 50  # numbers that are drawn at a time, as if there were this many clips or more


class Spreads(NamedTuple):
    """Standard deviations, of differences of scores between two systems, or of shares.

    Attributes:
        participants: between participants, of the difference or the share of each over many clips and answers.
        clips: between clips, of the difference or the share of each over many participants.
        rest: of one rating around all of this; for choices it follows from the share and is not used.
    """

    participants: float
    clips: float
    rest: float = 0.0


class Plan(NamedTuple):
    """A study whose power is asked for.

    Attributes:
        clips: number of clips.
        items: number of them that a participant answers.
        equal: share of choices for neither; 0 for ratings.
        comparisons: number of tests that are corrected for; the level is divided by it, as in the first step of Holm.
    """

    clips: int
    items: int
    equal: float = 0.0
    comparisons: int = 1


class Power(NamedTuple):
    """Powers by number of participants.

    Attributes:
        rows: number of participants -> share of simulated studies that find the effect.
        smallest: smallest number that reaches the power that was asked for; None if `most` does not.
    """

    rows: dict[int, float]
    smallest: int | None


Simulation = Callable[[np.random.Generator, int, int], np.ndarray]
"""Function of a generator, a number of simulations and of participants to whether each finds the effect."""


def of_difference(difference: float, spreads: Spreads, plan: Plan) -> Simulation:
    """Return the simulation of a paired difference of mean opinion scores.

    Args:
        difference: expected difference, other than 0.
        spreads: standard deviations.
        plan: the study.

    Raises:
        UserError: a number is out of range.
    """
    _check(plan)
    if not (difference and np.isfinite(difference)) or not all(0 <= sd < np.inf for sd in spreads):
        raise UserError("a difference is a number other than 0, and standard deviations are numbers from 0 up")

    def simulate(random: np.random.Generator, count: int, participants: int) -> np.ndarray:
        shape = (count, participants, plan.clips)
        values = difference + random.normal(0, spreads.participants, (*shape[:2], 1))
        values = values + random.normal(0, spreads.clips, (count, 1, plan.clips))
        values += random.normal(0, np.sqrt(2) * spreads.rest, shape)
        is_seen = _seen(random, shape, plan.items)
        values = np.where(is_seen, values, 0.0)
        mean = values.sum((1, 2)) / is_seen.sum((1, 2))
        over = [ratio(values.sum(axis), is_seen.sum(axis)) for axis in (2, 1)]
        found = crossed(mean, *over, level=_level(plan))
        return (found.low > 0) if difference > 0 else (found.high < 0)

    return simulate


def of_share(share: float, spreads: Spreads, plan: Plan) -> Simulation:
    """Return the simulation of a share that differs from a half, of preferences or of matched motion.

    Args:
        share: expected share among the choices that prefer one.
        spreads: standard deviations of the share.
        plan: the study.

    Raises:
        UserError: a number is out of range.
    """
    _check(plan)
    widest = np.sqrt(share * (1 - share)) if 0 < share < 1 else 0.0
    if not 0 < share < 1 or share == 0.5:
        raise UserError(f"a share of {share:g} cannot be told from a half; give one above 0 and below 1, such as 0.6")
    if not all(0 <= sd < np.inf for sd in spreads) or np.hypot(spreads.participants, spreads.clips) > 0.7 * widest:
        raise UserError(
            f"shares that are {share:g} on average cannot vary by {spreads.participants:g} between participants and "
            f"{spreads.clips:g} between clips; give smaller standard deviations"
        )
    of_participants, of_clips = (_logit_spread(share, sd) for sd in spreads[:2])
    centre = _centre(share, float(np.hypot(of_participants, of_clips)))

    def simulate(random: np.random.Generator, count: int, participants: int) -> np.ndarray:
        shape = (count, participants, plan.clips)
        logits = centre + random.normal(0, of_participants, (*shape[:2], 1))
        logits = logits + random.normal(0, of_clips, (count, 1, plan.clips))
        is_first = random.random(shape) < special.expit(logits)
        is_there = _seen(random, shape, plan.items) & (random.random(shape) >= plan.equal)
        wins = is_first & is_there
        total = is_there.sum((1, 2))
        over = [ratio(wins.sum(axis).astype(float), is_there.sum(axis)) for axis in (2, 1)]
        value = wins.sum((1, 2)) / np.maximum(total, 1)
        low, high, _ = interval(value, total, *over, level=_level(plan))
        return (low > 0.5) if share > 0.5 else (high < 0.5)

    return simulate


def find(simulate: Simulation, power: float, *, clips: int, most: int, simulations: int, seed: int) -> Power:
    """Return powers by number of participants, and the smallest number that reaches a power.

    Args:
        simulate: simulation of a study.
        power: power to reach, above 0 and below 1.
        clips: number of clips of the study.
        most: greatest number of participants that is tried.
        simulations: simulated studies for each number; with 2000, a power of 0.8 has a standard error of 0.009.
        seed: seed of all simulations.

    Raises:
        UserError: a number is out of range.
    """
    if not 0 < power < 1 or most < FEWEST or simulations < 1:
        raise UserError(f"a power is above 0 and below 1, and a study has at least {FEWEST} participants")
    rows: dict[int, float] = {}
    with progress_bar("Studies", unit="size") as bar:

        def reaches(participants: int) -> bool:
            if participants not in rows:
                rows[participants] = _power(simulate, participants, clips, simulations, seed)
                bar.update()
            return rows[participants] >= power

        below, reached = FEWEST - 1, None
        for participants in _sizes(most):
            if reaches(participants):
                reached = participants
                break
            below = participants
        while reached is not None and reached - below > 1:
            middle = (below + reached) // 2
            below, reached = (below, middle) if reaches(middle) else (middle, reached)
    return Power(dict(sorted(rows.items())), reached)


def _sizes(most: int) -> Iterator[int]:
    yield from (size for size in _GRID if FEWEST <= size < most)
    yield most


def _power(simulate: Simulation, participants: int, clips: int, simulations: int, seed: int) -> float:
    random = np.random.default_rng([seed, participants])
    found, chunk = [], max(1, _CELLS // (participants * max(clips, _CLIPS)))
    for start in range(0, simulations, chunk):
        found.append(simulate(random, min(chunk, simulations - start), participants))
    return float(np.concatenate(found).mean())


def _seen(random: np.random.Generator, shape: tuple[int, int, int], items: int) -> np.ndarray:
    """Draw which clips each participant sees."""
    if items == shape[2]:
        return np.ones(shape, bool)
    return random.random(shape).argsort(-1) < items


def _level(plan: Plan) -> float:
    return 1 - (1 - LEVEL) / plan.comparisons


def _check(plan: Plan) -> None:
    if plan.clips < 2 or not 1 <= plan.items <= plan.clips:
        raise UserError(f"{plan.items} items of {plan.clips} clips; give 2 clips or more, and at most as many items")
    if not 0 <= plan.equal < 1 or plan.comparisons < 1:
        raise UserError("the share of equal choices is from 0 to below 1, and there is at least one comparison")


def _logit_spread(share: float, sd: float) -> float:
    """Return the standard deviation of normal logits whose shares have a mean and a standard deviation."""
    if not sd:
        return 0.0

    def excess(spread: float) -> float:
        nodes, weights = _nodes()
        return float(weights @ np.square(special.expit(_centre(share, spread) + spread * nodes) - share)) - sd**2

    return float(optimize.root_scalar(excess, bracket=(0, 20)).root)


def _centre(share: float, spread: float) -> float:
    """Return the mean of normal logits whose shares have a mean."""
    nodes, weights = _nodes()

    def excess(mean: float) -> float:
        return float(weights @ special.expit(mean + spread * nodes)) - share

    return float(optimize.root_scalar(excess, bracket=(-60, 60)).root)


@functools.cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    return nodes, weights / weights.sum()

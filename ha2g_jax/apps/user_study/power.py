"""How many participants a study needs: simulated studies, analysed by the functions that analyse answers.

In a simulated study, each participant answers `items` of `clips` clips, and for a difference of scores each of these
for both systems. The difference d for a participant and a clip is mean + participant + clip + rest, each normal. A
choice is one of two, with logits that vary normally over participants and clips around the value that gives the share.
"""

import functools
import itertools
import math
import pathlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import threadpoolctl
from scipy import optimize, special

from ha2g_jax.apps.user_study.answers import Choices, Ratings, choices_of, ratings_of, read_answers
from ha2g_jax.apps.user_study.design import POINTS, Key
from ha2g_jax.apps.user_study.estimates import LEVEL, crossed, interval, ratio
from ha2g_jax.errors import UserError
from ha2g_jax.progress import progress_bar

MOS = "mos"
"""Measure of a difference of mean opinion scores; those of shares are `PREFERENCE` and `MISMATCH`."""

FEWEST = 3
"""Participants of the smallest study that is tried."""

_SIMULATIONS, _SEED = 2000, 0
_GRID = (5, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320, 480, 640, 960)
_NODES = 61  # of the quadrature over normal logits
_CELLS, _CLIPS = 2_000_000, 50  # numbers that are drawn at a time, as if there were this many clips or more


class Spreads(NamedTuple):
    """Standard deviations of differences of scores or of shares, between participants, and between clips.

    `rest` is the standard deviation of one rating around these; for choices it follows from the share and is not used.
    """

    participants: float
    clips: float
    rest: float = 0.0


class Plan(NamedTuple):
    """A study whose power is computed: each participant answers `items` of `clips` clips.

    Attributes:
        equal: share of choices for neither; 0 for ratings.
        comparisons: number of tests that are corrected for; the level is divided by it, as in the first step of Holm.
    """

    clips: int
    items: int
    equal: float = 0.0
    comparisons: int = 1


Simulation = Callable[[np.random.Generator, int, int], np.ndarray]
"""Function that maps a generator and the numbers of simulations and participants to whether each finds the effect."""


def of_difference(difference: float, spreads: Spreads, plan: Plan) -> Simulation:
    """Return the simulation of a paired difference of mean opinion scores.

    Raises:
        UserError: a number is out of range.
    """
    _check(plan)
    widest = POINTS[1] - POINTS[0]
    if not 0 < abs(difference) <= widest:
        raise UserError(f"a difference of {difference:g}; give one other than 0 and from -{widest} to {widest}")
    if not all(0 <= sd < np.inf for sd in spreads) or not any(spreads):
        raise UserError("standard deviations are numbers from 0 up, and not all of them are 0, as answers differ")

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
    """Return the simulation of a share among the choices that prefer one, of preferences or of matched motion.

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


def required_participants(
    simulate: Simulation, power: float, *, clips: int, most: int
) -> tuple[dict[int, float], int | None]:
    """Return powers by number of participants, and the smallest number that reaches a power, None if `most` does not.

    Raises:
        UserError: the power is not between 0 and 1, or `most` is below 3.
    """
    if not 0 < power < 1 or most < FEWEST:
        raise UserError(f"a power is above 0 and below 1, and a study has at least {FEWEST} participants")
    rows: dict[int, float] = {}
    with progress_bar("simulating studies") as bar:

        def reaches(participants: int) -> bool:
            if participants not in rows:
                rows[participants] = _power(simulate, participants, clips)
                bar.update()
            return rows[participants] >= power

        below, reached = FEWEST - 1, None
        for participants in (*(size for size in _GRID if size < most), most):
            if reaches(participants):
                reached = participants
                break
            below = participants
        while reached is not None and reached - below > 1:
            middle = (below + reached) // 2
            below, reached = (below, middle) if reaches(middle) else (middle, reached)
    return dict(sorted(rows.items())), reached


def _power(simulate: Simulation, participants: int, clips: int) -> float:
    random = np.random.default_rng([_SEED, participants])
    found, chunk = [], max(1, _CELLS // (participants * max(clips, _CLIPS)))
    for start in range(0, _SIMULATIONS, chunk):
        found.append(simulate(random, min(chunk, _SIMULATIONS - start), participants))
    return float(np.concatenate(found).mean())


def _seen(random: np.random.Generator, shape: tuple[int, int, int], items: int) -> np.ndarray:
    if items == shape[2]:
        return np.ones(shape, bool)
    return random.random(shape).argsort(-1) < items


def _level(plan: Plan) -> float:
    return 1 - (1 - LEVEL) / plan.comparisons


def _check(plan: Plan) -> None:
    if plan.clips < 2 or not 1 <= plan.items <= plan.clips:
        raise UserError(f"{plan.items} items of {plan.clips} clips; give 2 clips or more, and at most as many items")
    if not 0 <= plan.equal < 1:
        raise UserError(f"the share of equal choices is {plan.equal:g}; give one from 0 to below 1")


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

    return float(optimize.root_scalar(excess, bracket=(-400, 400)).root)


@functools.cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    return nodes, weights / weights.sum()


def power_table(
    measure: str, effect: float, spreads: Spreads, plan: Plan, *, power: float = 0.8, most: int = 500
) -> str:
    """Return how many participants, at most `most`, reach a power, after a table of the powers of smaller studies.

    The measure is `MOS`, `PREFERENCE` or `MISMATCH`, and the effect is the expected difference of scores, or share.

    Raises:
        UserError: a number is out of range.
    """
    is_mos = measure == MOS
    simulate = (of_difference if is_mos else of_share)(effect, spreads, plan)
    powers, smallest = required_participants(simulate, power, clips=plan.clips, most=most)
    what = f"a difference of {effect:g}" if is_mos else f"a share of {effect:g} against 0.5"
    rest = f", {spreads.rest:.3g} of one rating" if is_mos else ""
    equal = "" if is_mos else f"; {plan.equal:.1%} of the choices are for neither"
    lines = [
        f"{measure}: {what}, found with an interval of {_level(plan):.4g}",
        f"standard deviations: {spreads.participants:.3g} between participants, {spreads.clips:.3g} between clips"
        + rest,
        f"each participant answers {plan.items} of {plan.clips} clips" + equal,
        "",
        "participants  power",
        *(f"{count:>12}  {value:.3f}" for count, value in powers.items()),
        "",
    ]
    if smallest is None:
        lines.append(
            f"{most} participants do not reach a power of {power:g}; use more clips, which further participants do not "
            "replace, or a larger --most"
        )
    else:
        lines.append(f"{smallest} participants reach a power of {power:g}.")
    return "\n".join(lines)


@threadpoolctl.threadpool_limits.wrap(limits=1)  # with small matrices, threads of BLAS wait for each other
def read_pilot(measure: str, paths: Sequence[pathlib.Path], key: Key) -> tuple[Spreads, float]:
    """Estimate standard deviations and the share of equal choices from the answers of a pilot study.

    The sums of squares over participants, over clips and of the rest are set equal to their expectations (Henderson
    1953), negative results are set to 0, and the results are averaged over scales and pairs of systems.

    Raises:
        UserError: the answers cannot be read, or have too little to estimate standard deviations.
    """
    participants, equal = read_answers(paths, key).participants, 0.0
    if measure == MOS:
        variances = variances_of_ratings(ratings_of(participants, key))
    else:
        choices = choices_of(participants, key, measure)
        variances = variances_of_choices(choices)
        equal = float((choices.outcome == 0).mean()) if len(choices.outcome) else 0.0
    if not variances:
        raise UserError(
            f"the pilot study has too few answers for {measure}: participants have to answer for two clips or more of "
            "the same pair of systems each, as where there are fewer clips; give --sd-participants and --sd-clips"
        )
    means = np.mean(variances, axis=0)
    if not np.any(means):
        raise UserError(f"all answers of the pilot study to {measure} agree; give the standard deviations")
    return Spreads(*(math.sqrt(value) for value in means)), equal


def variances_of_ratings(ratings: Ratings) -> list[tuple[float, float, float]]:
    """Return the variances of differences between systems on the same clip, for each pair and scale."""
    found = []
    shape = (ratings.participant.max(initial=0) + 1, ratings.clip.max(initial=0) + 1)
    for first, second in itertools.combinations(range(len(ratings.systems)), 2):
        for scores in ratings.scores.T:
            tables = []
            for system in (first, second):
                table, mine = np.full(shape, np.nan), ratings.system == system
                table[ratings.participant[mine], ratings.clip[mine]] = scores[mine]
                tables.append(table)
            participants, clips = np.nonzero(np.isfinite(tables[0] - tables[1]))
            values = (tables[0] - tables[1])[participants, clips]
            rest = _rest(values, participants, clips)
            if rest is not None:
                found.append((*_components(values, participants, clips, rest), rest / 2))
    return found


def variances_of_choices(choices: Choices) -> list[tuple[float, float, float]]:
    """Return the variances of shares, for each pair of systems or each system."""
    found = []
    for pair in np.unique([choices.first, choices.second], axis=1).T if len(choices.outcome) else []:
        mine = choices.where((choices.first == pair[0]) & (choices.second == pair[1]) & (choices.outcome != 0))
        values = (mine.outcome == 1).astype(float)
        rest = _rest(values, mine.participant, mine.clip)
        if rest is not None:
            found.append((*_components(values, mine.participant, mine.clip, rest), 0.0))
    return found


def _components(values: np.ndarray, participants: np.ndarray, clips: np.ndarray, rest: float) -> tuple[float, float]:
    """Return the variances between participants and between clips, given that of the rest."""
    belongs = [(groups[:, None] == np.unique(groups)).astype(float) for groups in (participants, clips)]
    # The sums of squares are those of totals of participants, or clips, less their share of the mean.
    totals = [each.T - each.mean(axis=0)[:, None] for each in belongs]
    implied = [[np.square(total @ each).sum() for each in belongs] for total in totals]
    squares = [np.square(total @ values).sum() - rest * np.square(total).sum() for total in totals]
    of_participants, of_clips = np.linalg.solve(implied, squares).tolist()
    return max(0.0, of_participants), max(0.0, of_clips)


def _rest(values: np.ndarray, participants: np.ndarray, clips: np.ndarray) -> float | None:
    """Return the variance around effects of participants and clips; None if the answers do not determine it."""
    columns = [groups[:, None] == np.unique(groups) for groups in (participants, clips)]
    design = np.concatenate(columns, axis=1).astype(float)
    freedom = len(values) - (np.linalg.matrix_rank(design) if len(values) else 0)
    if freedom < 1 or min(column.shape[1] for column in columns) < 2:
        return None
    left = values - design @ np.linalg.lstsq(design, values)[0]
    return float(left @ left) / freedom

"""The number of participants that a study needs, for standard deviations that are given or those of a pilot study."""

import itertools
import math
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.apps.user_study import power
from ha2g_jax.apps.user_study.answers import read_answers
from ha2g_jax.apps.user_study.crossed import LEVEL, ratio
from ha2g_jax.apps.user_study.key import MISMATCH, PREFERENCE, Key
from ha2g_jax.apps.user_study.observations import Choices, Ratings, mismatches_of, preferences_of, ratings_of
from ha2g_jax.apps.user_study.power import Plan, Spreads
from ha2g_jax.errors import UserError

MOS = "mos"
MEASURES = (MOS, PREFERENCE, MISMATCH)
"""What a study can measure: a difference of mean opinion scores, a share of preferences, a share of matched motion."""


class Pilot(NamedTuple):
    """What a pilot study says: standard deviations, and the share of choices for neither."""

    spreads: Spreads
    equal: float = 0.0


def required_participants(
    measure: str,
    effect: float,
    spreads: Spreads,
    plan: Plan,
    *,
    target: float = 0.8,
    most: int = 500,
    simulations: int = 2000,
    seed: int = 0,
) -> dict[str, Any]:
    """Return powers by number of participants, and the smallest number that reaches a power.

    Args:
        measure: one of `MEASURES`.
        effect: expected difference of scores, or expected share.
        spreads: standard deviations.
        plan: clips, items and corrections.
        target: power to reach.
        most: greatest number of participants that is tried.
        simulations: simulated studies for each number.
        seed: seed of the simulations.

    Returns:
        "participants" (None if `most` do not suffice), "powers" by number, and all that they depend on.

    Raises:
        UserError: a number is out of range.
    """
    simulation = (power.of_difference if measure == MOS else power.of_share)(effect, spreads, plan)
    found = power.find(simulation, target, clips=plan.clips, most=most, simulations=simulations, seed=seed)
    settings = {"power": target, "most": most, "simulations": simulations, "seed": seed, "level": LEVEL}
    return {
        "measure": measure,
        "effect": effect,
        "standard_deviations": spreads._asdict(),
        "plan": plan._asdict(),
        **settings,
        "participants": found.smallest,
        "powers": {str(count): value for count, value in found.rows.items()},
    }


def as_text(result: Mapping[str, Any]) -> str:
    """Return a result of `required_participants` as a table for a terminal.

    Args:
        result: return value of `required_participants`.
    """
    plan, spreads = result["plan"], result["standard_deviations"]
    is_mos = result["measure"] == MOS
    what = f"a difference of {result['effect']:g}" if is_mos else f"a share of {result['effect']:g} against 0.5"
    rest = f", {spreads['rest']:.3g} of one rating" if is_mos else ""
    lines = [
        f"{result['measure']}: {what}, found with an interval of {1 - (1 - LEVEL) / plan['comparisons']:.4g}",
        f"standard deviations: {spreads['participants']:.3g} between participants, {spreads['clips']:.3g} between "
        f"clips{rest}",
        f"each participant answers {plan['items']} of {plan['clips']} clips"
        + ("" if is_mos else f"; {plan['equal']:.1%} of the choices are for neither"),
        "",
        "participants  power",
        *(f"{count:>12}  {value:.3f}" for count, value in result["powers"].items()),
        "",
    ]
    if result["participants"] is None:
        lines.append(
            f"{result['most']} participants do not reach a power of {result['power']:g}; use more clips, which further "
            "participants do not replace, or a larger --most"
        )
    else:
        lines.append(f"{result['participants']} participants reach a power of {result['power']:g}.")
    return "\n".join(lines)


def read_pilot(measure: str, paths: Sequence[pathlib.Path], key: Key) -> Pilot:
    """Estimate standard deviations from the answers of a pilot study, on average over scales and pairs of systems.

    The delete-one variances over participants and clips are set equal to what the standard deviations give, and
    negative results are 0.

    Args:
        measure: one of `MEASURES`.
        paths: answer files, and folders of them.
        key: key of the pilot study.

    Raises:
        UserError: the answers cannot be read, or have too little to estimate standard deviations.
    """
    participants = read_answers(paths, key).participants
    if measure == MOS:
        found = _of_ratings(ratings_of(participants, key))
    else:
        of = preferences_of if measure == PREFERENCE else mismatches_of
        found = _of_choices(of(participants, key))
    variances, equal = found
    if not variances:
        raise UserError(
            f"the pilot study has too few answers for {measure}: it needs two participants and two clips with answers "
            "to the same pair of systems; give --sd-participants and --sd-clips"
        )
    means = np.mean(variances, axis=0)
    if not np.any(means):
        raise UserError(f"all answers of the pilot study to {measure} agree; give the standard deviations")
    return Pilot(Spreads(*(math.sqrt(value) for value in means)), equal)


def _of_ratings(ratings: Ratings) -> tuple[list[tuple[float, float, float]], float]:
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
    return found, 0.0


def _of_choices(choices: Choices) -> tuple[list[tuple[float, float, float]], float]:
    """Return the variances of shares, for each pair of systems or each system."""
    found = []
    for pair in np.unique([choices.first, choices.second], axis=1).T if len(choices.outcome) else []:
        mine = choices.where((choices.first == pair[0]) & (choices.second == pair[1]) & (choices.outcome != 0))
        if min(len(np.unique(mine.participant)), len(np.unique(mine.clip))) > 1:
            values = (mine.outcome == 1).astype(float)
            rest = float(values.mean() * (1 - values.mean()))
            found.append((*_components(values, mine.participant, mine.clip, rest), 0.0))
    return found, float((choices.outcome == 0).mean()) if len(choices.outcome) else 0.0


def _components(values: np.ndarray, participants: np.ndarray, clips: np.ndarray, rest: float) -> tuple[float, float]:
    """Return the variances between participants and between clips, given that of the rest."""
    found = []
    for groups in (participants, clips):
        counts = np.bincount(groups)
        variance = float(ratio(np.bincount(groups, values), counts).variance)
        found.append(max(0.0, (variance - rest / len(values)) * len(values) ** 2 / float(np.square(counts).sum())))
    return found[0], found[1]


def _rest(values: np.ndarray, participants: np.ndarray, clips: np.ndarray) -> float | None:
    """Return the variance around effects of participants and clips; None if the answers do not determine it."""
    columns = [groups[:, None] == np.unique(groups) for groups in (participants, clips)]
    design = np.concatenate(columns, axis=1).astype(float)
    freedom = len(values) - (np.linalg.matrix_rank(design) if len(values) else 0)
    if freedom < 1 or min(column.shape[1] for column in columns) < 2:
        return None
    left = values - design @ np.linalg.lstsq(design, values)[0]
    return float(left @ left) / freedom

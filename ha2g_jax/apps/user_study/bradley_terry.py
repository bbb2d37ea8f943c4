"""Strengths of systems from choices between two of them: the model of Bradley and Terry (1952), with intervals.

P(i is preferred to j) = 1 / (1 + exp(-(s_i - s_j))) among the choices that prefer one, with strengths s in logits. This
also holds in Davidson's (1970) model of choices for neither, so that the same strengths are estimated without them;
counted as half a win of each system, they would pull all strengths together. The estimate is that of maximum likelihood
(Zermelo 1929, Hunter 2004), computed by choix (Maystre and Grossglauser 2015).
"""

import itertools
from typing import NamedTuple

import numpy as np
from scipy.sparse import csgraph

from ha2g_jax.apps.user_study.answers import Choices
from ha2g_jax.apps.user_study.estimates import CrossedEstimate, crossed, jackknife

ELO_CENTRE = 1500
ELO_PER_LOGIT = 400 / np.log(10)
"""Points of Elo's scale for a strength of 1: a system 400 points above another is preferred ten times as often."""


class Strengths(NamedTuple):
    """Strengths of the compared systems (S,); a missing bound is infinite.

    They are relative to the mean of the largest group of systems that beat each other by chains of wins, or of all
    largest groups if there are several, so that the order of the systems does not matter.

    Attributes:
        differences: estimates (pairs,), first system minus second, in the order of `itertools.combinations`.
        finite: (S,) whether maximum likelihood determines the strength.
        is_connected: whether choices that prefer one connect every system with every other one, directly or not.
    """

    systems: np.ndarray
    strengths: CrossedEstimate
    differences: CrossedEstimate
    finite: np.ndarray
    is_connected: bool


def wins_of(choices: Choices, num_systems: int, groups: np.ndarray) -> np.ndarray:
    """Count the wins (groups, S, S) of the row over the column, by the group (n,) of each choice; ties do not count."""
    wins = np.zeros((groups.max(initial=0) + 1, num_systems, num_systems))
    np.add.at(wins, (groups, choices.first, choices.second), choices.outcome == 1)
    np.add.at(wins, (groups, choices.second, choices.first), choices.outcome == -1)
    return wins


def fit(wins: np.ndarray) -> np.ndarray:
    """Return the strengths of maximum likelihood, which sum to 0, from wins (S, S) of the row over the column.

    There must be a chain of wins from each system to every other one, or else a strength is infinite (Ford 1957).
    """
    import choix

    return choix.ilsr_pairwise_dense(wins, max_iter=1000, tol=1e-9)


def standard_errors(wins: np.ndarray, strengths: np.ndarray, contrasts: np.ndarray) -> np.ndarray:
    """Return the standard errors of contrasts (k, S) of strengths (S,), which sum to 0, for independent choices."""
    covariance = np.linalg.pinv(_information(wins, strengths), hermitian=True)
    return np.sqrt(np.einsum("ks,st,kt->k", contrasts, covariance, contrasts))


def estimate(choices: Choices, num_systems: int) -> Strengths:
    """Return strengths and differences of at least one choice with intervals over participants and clips.

    For each two systems that were compared, 1 / S wins of both are added, where S is the number of systems. In a
    balanced design this is Firth's (1993) correction of the bias of maximum likelihood, and it keeps the strength of a
    system that was never chosen finite. Where maximum likelihood has no finite difference, the bound on that side is
    infinite. The variance is at least that for independent choices.
    """
    used = np.unique([choices.first, choices.second])
    place = np.ix_(used, used)
    by_group = [wins_of(choices, num_systems, groups) for groups in (choices.participant, choices.clip)]
    wins = by_group[0].sum(0)[place]
    added = (wins + wins.T > 0) / len(used)
    beats = _closure(wins > 0)
    is_connected = bool(_closure(wins + wins.T > 0).all())
    mutual = beats & beats.T
    # The largest groups in which each one beats each other one; what beats one and is not beaten by it has no bound.
    reference = mutual.sum(1) == mutual.sum(1).max()
    above, below = (np.any((each & ~each.T)[:, reference], axis=1) for each in (beats, beats.T))
    finite = reference & ~above & ~below
    to_mean = np.eye(len(used)) - reference / reference.sum()
    first, second = np.array(list(itertools.combinations(range(len(used)), 2))).T
    contrasts = np.eye(len(used))[first] - np.eye(len(used))[second]
    if not is_connected:
        nothing = [
            CrossedEstimate(*np.full((len(CrossedEstimate._fields), len(rows)), np.nan))
            for rows in (to_mean, contrasts)
        ]
        return Strengths(used, *nothing, finite=finite, is_connected=False)
    strengths = fit(wins + added)
    parts = [each[each.sum((1, 2)) > 0][:, *place] for each in by_group]
    spreads = [_without(wins + added, each, strengths) for each in parts]
    found = []
    for rows in (to_mean, contrasts):
        least = np.square(standard_errors(wins + added, strengths, rows))
        found.append(crossed(rows @ strengths, *(jackknife((each @ rows.T).T) for each in spreads), least=least))
    found[0] = _open(found[0], above, below)
    is_ahead, is_behind = beats[first, second], beats[second, first]
    found[1] = _open(found[1], is_ahead & ~is_behind, is_behind & ~is_ahead)
    return Strengths(used, *found, finite=finite, is_connected=True)


def _without(wins: np.ndarray, parts: np.ndarray, strengths: np.ndarray) -> np.ndarray:
    """Return the strengths without the wins of each group (groups, S), by one step of Newton (Pregibon 1981)."""
    left = wins - parts
    expected = 1 / (1 + np.exp(strengths[None, :] - strengths[:, None]))
    scores = (left - (left + left.transpose(0, 2, 1)) * expected).sum(2)
    inverses = np.linalg.pinv(_information(left, strengths), rcond=1e-12, hermitian=True)
    return strengths + (inverses @ scores[..., None])[..., 0]


def _information(wins: np.ndarray, strengths: np.ndarray) -> np.ndarray:
    expected = 1 / (1 + np.exp(strengths[None, :] - strengths[:, None]))
    weights = (wins + np.swapaxes(wins, -1, -2)) * expected * (1 - expected)
    return np.eye(len(strengths)) * weights.sum(-1)[..., None] - weights


def _closure(edges: np.ndarray) -> np.ndarray:
    """Return which system is reached from which one by a chain of edges (S, S); each reaches itself."""
    return np.isfinite(csgraph.shortest_path(edges, unweighted=True))


def _open(found: CrossedEstimate, above: np.ndarray, below: np.ndarray) -> CrossedEstimate:
    return found._replace(low=np.where(below, -np.inf, found.low), high=np.where(above, np.inf, found.high))

"""Strengths agree with published estimates; systems that always or never win, and designs that are not connected."""

import numpy as np
import pytest

pytest.importorskip("choix")

from ha2g_jax.apps.user_study.answers import Choices
from ha2g_jax.apps.user_study.bradley_terry import estimate, fit, standard_errors, wins_of

# Agresti, Categorical Data Analysis, Table 10.10: the American League of 1987, wins of the row over the column. The
# estimates relative to Baltimore are printed there to two places, and with standard errors in Turner and Firth 2012
# (Journal of Statistical Software 48(9)), the model without the advantage of the home team.
TEAMS = ("Milwaukee", "Detroit", "Toronto", "New York", "Boston", "Cleveland", "Baltimore")
WINS = [
    *([0, 7, 9, 7, 7, 9, 11], [6, 0, 7, 5, 11, 9, 9], [4, 6, 0, 7, 7, 8, 12], [6, 8, 6, 0, 6, 7, 10]),
    *([6, 2, 6, 7, 0, 7, 12], [4, 4, 5, 6, 6, 0, 6], [2, 4, 1, 3, 1, 7, 0]),
]
PUBLISHED = [1.581, 1.436, 1.294, 1.248, 1.108, 0.684, 0]
ERRORS = [0.343, 0.340, 0.337, 0.336, 0.334, 0.332]


def choices(rows):
    """Return choices of (participant, clip, first, second, outcome)."""
    participant, clip, first, second, outcome = np.array(rows).T
    return Choices(participant, clip, clip, first, second, outcome)


def drawn(strengths, participants, clips, seed=0):
    random = np.random.default_rng(seed)
    pairs = np.array(np.triu_indices(len(strengths), 1)).T
    rows = [(p, c, *pair) for p in range(participants) for c in range(clips) for pair in pairs]
    difference = [strengths[row[2]] - strengths[row[3]] for row in rows]
    is_first = random.random(len(rows)) < 1 / (1 + np.exp(-np.array(difference)))
    return choices([(*row, 1 if won else -1) for row, won in zip(rows, is_first)])


def test_published_example():
    wins = np.array(WINS, float)
    strengths = fit(wins)
    assert strengths - strengths[-1] == pytest.approx(PUBLISHED, abs=6e-4)
    to_last = np.eye(7)[:-1] - np.eye(7)[-1]
    assert standard_errors(wins, strengths, to_last) == pytest.approx(ERRORS, abs=6e-4)


def test_two_systems_are_the_logit_of_the_share():
    """With the correction, half a choice is added to both; maximum likelihood alone is the logit of the share."""
    found = estimate(choices([(p, c, 0, 1, 1 if c < 3 else -1) for p in range(5) for c in range(4)]), 2)
    assert fit(np.array([[0, 15], [5, 0.0]])) == pytest.approx([np.log(3) / 2, -np.log(3) / 2])
    assert found.differences.value == pytest.approx(np.log(15.5 / 5.5))
    assert found.strengths.value.sum() == pytest.approx(0)


def total_wins(found):
    return wins_of(found, 3, found.participant).sum(0)


def test_deletions_are_those_of_new_fits():
    """One step of Newton gives the standard error of complete new fits, to a few percent."""
    found = drawn([0.5, 0, -0.5], 12, 5)
    values = []
    for groups in (found.participant, found.clip):
        fits = [fit(total_wins(found.where(groups != group)) + (1 - np.eye(3)) / 3) for group in np.unique(groups)]
        differences = np.array(fits) @ [1, 0, -1]
        values.append((len(fits) - 1) * differences.var())
    wins = total_wins(found)
    information = standard_errors(wins + (1 - np.eye(3)) / 3, fit(wins), np.array([[1, 0, -1]]))
    expected = max(np.sqrt(sum(values)), information[0])
    assert estimate(found, 3).differences.error[1] == pytest.approx(expected, rel=0.05)


def test_a_system_that_never_wins_has_no_lower_bound():
    mixed = [(p, c, 0, 1, 1 if (p + c) % 3 else -1) for p in range(6) for c in range(4)]
    never = [(p, c, first, 2, 1) for p in range(6) for c in range(4) for first in (0, 1)]
    found = estimate(choices(mixed + never), 3)
    assert found.finite.tolist() == [True, True, False] and found.is_connected
    assert np.isfinite(found.strengths.value).all()
    assert found.strengths.low[2] == -np.inf and found.strengths.high[2] < found.strengths.low[:2].min()
    assert np.isfinite([found.differences.low[0], found.differences.high[0]]).all()  # of the two that both win
    assert (found.differences.high[1:] == np.inf).all() and (found.differences.low[1:] > 0).all()


def test_the_order_of_the_systems_does_not_matter():
    """Where nothing varies, the width comes from the least variance, and not from that of rounding."""
    always = [(p, c, 0, 1, -1) for p in range(6) for c in range(3)]
    found, turned = (estimate(choices(rows), 2).differences for rows in (always, [(*row[:4], 1) for row in always]))
    np.testing.assert_allclose(found.value, -turned.value)
    np.testing.assert_allclose(found.low, -turned.high)
    np.testing.assert_allclose(found.p, turned.p)


def test_systems_that_were_not_compared_have_no_common_scale():
    found = estimate(choices([(p, 0, 2 * (p % 2), 2 * (p % 2) + 1, (-1) ** (p // 2)) for p in range(8)]), 4)
    assert not found.is_connected and np.isnan(found.differences.value).all()


def test_equal_choices_and_one_participant():
    rows = [(0, c, 0, 1, (1, 1, -1)[c % 3]) for c in range(9)]
    one = estimate(choices(rows), 2)
    assert np.isfinite(one.differences.value).all() and np.isnan(one.differences.low).all()
    assert estimate(choices([*rows, (0, 9, 0, 1, 0)]), 2).differences.value == one.differences.value

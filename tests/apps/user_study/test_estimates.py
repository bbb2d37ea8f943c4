"""Shares, means, differences, strengths and agreement: known and published values, small designs, and coverage."""

import itertools
import pathlib
import runpy

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats import inter_rater

from ha2g_jax.apps.user_study.answers import Choices
from ha2g_jax.apps.user_study.bradley_terry import estimate, fit, standard_errors, wins_of
from ha2g_jax.apps.user_study.estimates import (
    Spread,
    agreement,
    crossed,
    fleiss_kappa,
    interval,
    mean,
    share,
    system_differences,
)

COVERAGE = runpy.run_path(str(pathlib.Path(__file__).parents[3] / "benchmarks" / "user_study_coverage.py"))
# Fleiss 1971, Table 1: diagnoses of 30 patients by 6 psychiatrists each: depression, personality disorder,
# schizophrenia, neurosis, other. The article gives the agreement 0.555 and kappa 0.430.
DIAGNOSES = """
00060 03003 01401 00006 03030 20400 00402 20310 20040 00006 10050 11040 03300 10050 02031
00501 30012 51000 02040 10203 00006 01050 02013 20040 10041 05010 40002 02040 10500 00006
"""


def answers_of(table):
    """Return scores, participants, clips and systems of a table (P, S, C), NaN where nobody answered."""
    participants, systems, clips = np.nonzero(np.isfinite(table))
    return table[participants, systems, clips], participants, clips, systems


def choices(outcome):
    """Return choices of a table (P, C) of outcomes."""
    participants, clips = (each.ravel() for each in np.indices(outcome.shape))
    nothing = np.zeros(outcome.size, int)
    return Choices(participants, clips, clips, nothing, nothing, outcome.ravel())


def test_variance_is_that_of_the_two_sets_of_means():
    """In a complete design: the variances of the means of participants and of clips, and the degrees of min F'."""
    values = np.random.default_rng(0).normal(size=(6, 4))
    participants, clips = (each.ravel() for each in np.indices(values.shape))
    found = mean(values.ravel(), participants, clips)
    parts = [values.mean(axis).var(ddof=1) / len(values.mean(axis)) for axis in (1, 0)]
    assert found.error == pytest.approx(np.sqrt(sum(parts)))
    assert found.freedom == pytest.approx(sum(parts) ** 2 / (parts[0] ** 2 / 5 + parts[1] ** 2 / 3))
    assert found.high - found.value == pytest.approx(stats.t.ppf(0.975, found.freedom) * found.error)


def test_difference_in_a_complete_design_is_that_of_the_means():
    table = np.random.default_rng(1).normal(size=(7, 3, 5))
    found = system_differences(*answers_of(table), 3)
    means = table.mean((0, 2))
    assert found.value == pytest.approx([means[0] - means[1], means[0] - means[2], means[1] - means[2]])
    pairs = table[:, 0] - table[:, 1]
    participants, clips = (each.ravel() for each in np.indices(pairs.shape))
    assert found.error[0] == pytest.approx(mean(pairs.ravel(), participants, clips).error)


def test_difference_in_an_incomplete_design_is_free_of_participants_and_clips():
    """Without a rest, strict participants and hard clips that are met by one system more often change nothing."""
    random = np.random.default_rng(2)
    table = np.array([1.0, 0.25])[:, None] + random.normal(size=(9, 1, 1)) + random.normal(size=(1, 1, 6))
    table[random.random(table.shape) < 0.5] = np.nan
    found = system_differences(*answers_of(table), 2)
    assert found.value == pytest.approx([0.75]) and np.isnan(found.error)  # nothing varies


def test_difference_that_the_answers_do_not_determine():
    table = np.full((4, 2, 3), np.nan)
    table[:2, 0], table[2:, 1] = 4, 3  # each participant rated one system
    assert np.isnan(system_differences(*answers_of(table), 2).value)


def test_one_participant_and_one_clip():
    values = np.array([3.0, 4, 5])
    one = mean(values, np.zeros(3, int), np.arange(3))
    assert one.value == 4 and np.isnan([one.low, one.high, one.p]).all()
    of_participants = mean(values, np.arange(3), np.zeros(3, int))  # one clip: the t interval over participants
    assert of_participants.high == pytest.approx(stats.t.interval(0.95, 2, 4, stats.sem(values))[1])


def test_answers_that_all_agree_say_nothing_of_others():
    """No interval of width 0 is shown, nor one whose width is that of rounding."""
    participant, clip = (axis.ravel() for axis in np.indices((4, 5)))
    found = mean(np.full(20, 3.1), participant, clip)
    assert found.value == pytest.approx(3.1) and np.isnan([found.low, found.high, found.error, found.p]).all()


def test_p_is_small_where_the_interval_excludes_zero():
    clips = Spread(np.array(0.01), np.array(6))
    for value in np.linspace(-1, 1, 41):
        found = crossed(np.array(value), Spread(np.array(0.02), np.array(9)), clips)
        assert (found.p < 0.05) == (found.low > 0 or found.high < 0)
    assert crossed(np.array(0.0), Spread(np.array(0.0), np.array(9)), clips).p == 1


def test_share_of_independent_choices():
    """The exact numbers are those of scipy; the interval over participants and clips contains their interval."""
    outcome = np.where(np.random.default_rng(3).random((30, 10)) < 0.65, 1, -1)
    outcome[:, 0] = 0
    found = share(choices(outcome))
    test = stats.binomtest(int((outcome == 1).sum()), 270)
    assert (found.first + found.second, found.equal) == (270, 30) and found.exact_p == test.pvalue
    assert (found.exact_low, found.exact_high) == test.proportion_ci(method="exact")
    assert found.low <= found.exact_low < found.value < found.exact_high <= found.high
    assert found.with_half == pytest.approx((found.first + 15) / 300)


def test_share_of_participants_who_always_choose_the_same():
    """20 participants with 10 equal choices each tell as much as 20 choices, and the exact test would not see it."""
    outcome = np.where(np.arange(20) < 14, 1, -1)[:, None].repeat(10, axis=1)
    found = share(choices(outcome))
    assert found.exact_p < 1e-6 and found.p > 0.05 and found.low < 0.5 < found.value
    low, high = stats.binomtest(14, 20).proportion_ci(method="exact")
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.03)


def test_share_of_all_and_of_none():
    every = share(choices(np.ones((10, 8), int)))
    assert every.high == 1 and every.low == pytest.approx(stats.binomtest(10, 10).proportion_ci(method="exact").low)
    assert every.p == pytest.approx(2**-9)
    equal = share(choices(np.zeros((3, 2), int)))
    assert np.isnan(equal.value) and equal.with_half == 0.5
    one = share(choices(np.array([[1, 1, -1]])))
    assert one.value == pytest.approx(2 / 3) and np.isnan([one.low, one.high, one.p]).all() and one.exact_p == 1


def test_p_of_a_share_is_small_where_the_interval_excludes_a_half():
    for value in np.linspace(0, 1, 41):
        spreads = Spread(np.array(0.003), np.array(12)), Spread(np.array(0.002), np.array(8))
        low, high, p = interval(np.array(value), np.array(96), *spreads)
        assert low <= value <= high and (p < 0.05) == (low > 0.5 or high < 0.5)


@pytest.mark.parametrize("statistic", list(COVERAGE["TRIALS"]))
@pytest.mark.parametrize("variation", [0, 1], ids=list(COVERAGE["VARIATIONS"]))
def test_intervals_hold_the_truth_and_are_not_vacuous(statistic, variation):
    """In 95 of 100 studies at least, with a fixed seed; docs/user_study.md has those of 1000 each."""
    trial, design = COVERAGE["TRIALS"][statistic], COVERAGE["Design"](20, 8)
    spread = list(COVERAGE["VARIATIONS"].values())[variation][trial is not COVERAGE["opinion"]]
    held, width = COVERAGE["measure"](trial, design, spread, 200, seed=7)
    widest = {"MOS difference": 1.0, "strength difference": 1.6, "matched share": 0.4}
    assert held >= 0.95 and width < widest[statistic]


def test_published_agreement():
    table = np.array([[int(count) for count in row] for row in DIAGNOSES.split()])
    assert table.shape == (30, 5) and (table.sum(1) == 6).all()
    assert fleiss_kappa(table) == pytest.approx(0.430, abs=5e-4)


def test_agreement_in_complete_tables_is_that_of_statsmodels():
    random = np.random.default_rng(0)
    for _ in range(20):
        table = random.multinomial(7, random.dirichlet(np.ones(4)), size=9)
        assert fleiss_kappa(table) == pytest.approx(inter_rater.fleiss_kappa(table))


def test_agreement_in_an_incomplete_design():
    """Items with one answer do not count; with other numbers of answers, each item counts the same."""
    table = np.array([[3, 0], [0, 2], [1, 1], [1, 0]])
    agree, chance = (1 + 1 + 0) / 3, ((1 + 0 + 0.5) / 3) ** 2 + ((0 + 1 + 0.5) / 3) ** 2
    assert fleiss_kappa(table) == pytest.approx((agree - chance) / (1 - chance))
    assert np.isnan(fleiss_kappa(np.array([[1, 0], [0, 1]])))  # nobody answered the same item
    assert np.isnan(fleiss_kappa(np.array([[3, 0], [4, 0]])))  # nothing but one answer


def test_the_interval_of_agreement_ends_at_1():
    items, participants = np.repeat(np.arange(6), 5), np.tile(np.arange(5), 6)
    answers = np.where((items == 0) & (participants == 0), 1 - items % 2, items % 2)
    found = agreement(participants, items, items, answers)
    assert 0.7 < found.value < found.high == 1.0


def test_interval_of_agreement():
    random = np.random.default_rng(1)
    truth = random.integers(3, size=20)
    participants, items = (each.ravel() for each in np.indices((12, 20)))
    answers = np.where(random.random(240) < 0.7, truth[items], random.integers(3, size=240))
    found = agreement(participants, items // 2, items, answers)
    assert found.low < 0.49 < found.high and found.low > 0.2  # two answers agree by truth with probability 0.7^2
    copies = agreement(participants, items // 2, items, truth[items])
    assert copies.value == pytest.approx(1) and np.isnan(copies.low)  # nothing varies


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


def compared(rows):
    """Return choices of (participant, clip, first, second, outcome)."""
    participant, clip, first, second, outcome = np.array(rows).T
    return Choices(participant, clip, clip, first, second, outcome)


def drawn(strengths, participants, clips, seed=0):
    random = np.random.default_rng(seed)
    pairs = np.array(np.triu_indices(len(strengths), 1)).T
    rows = [(p, c, *pair) for p in range(participants) for c in range(clips) for pair in pairs]
    difference = [strengths[row[2]] - strengths[row[3]] for row in rows]
    is_first = random.random(len(rows)) < 1 / (1 + np.exp(-np.array(difference)))
    return compared([(*row, 1 if won else -1) for row, won in zip(rows, is_first)])


def test_published_strengths():
    wins = np.array(WINS, float)
    strengths = fit(wins)
    assert strengths - strengths[-1] == pytest.approx(PUBLISHED, abs=6e-4)
    to_last = np.eye(7)[:-1] - np.eye(7)[-1]
    assert standard_errors(wins, strengths, to_last) == pytest.approx(ERRORS, abs=6e-4)


def test_two_systems_are_the_logit_of_the_share():
    """With the correction, half a choice is added to both; maximum likelihood alone is the logit of the share."""
    found = estimate(compared([(p, c, 0, 1, 1 if c < 3 else -1) for p in range(5) for c in range(4)]), 2)
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
    found = estimate(compared(mixed + never), 3)
    assert found.finite.tolist() == [True, True, False] and found.is_connected
    assert np.isfinite(found.strengths.value).all()
    assert found.strengths.low[2] == -np.inf and found.strengths.high[2] < found.strengths.low[:2].min()
    assert np.isfinite([found.differences.low[0], found.differences.high[0]]).all()  # of the two that both win
    assert (found.differences.high[1:] == np.inf).all() and (found.differences.low[1:] > 0).all()


def test_the_order_of_the_systems_does_not_matter():
    """Where nothing varies, the width comes from the least variance, and not from that of rounding."""
    always = [(p, c, 0, 1, -1) for p in range(6) for c in range(3)]
    found, turned = (estimate(compared(rows), 2).differences for rows in (always, [(*row[:4], 1) for row in always]))
    np.testing.assert_allclose(found.value, -turned.value)
    np.testing.assert_allclose(found.low, -turned.high)
    np.testing.assert_allclose(found.p, turned.p)


@pytest.mark.parametrize("count", [2, 3])
def test_where_each_system_always_beats_the_next_the_first_has_no_upper_bound_and_the_last_no_lower(count):
    pairs = [*itertools.combinations(range(count), 2)]
    rows = [(p, c, *pair, 1) for p in range(8) for c in range(3) for pair in pairs]
    found = estimate(compared(rows), count)
    turned = estimate(compared([(*row[:4], -1) for row in rows]), count)
    assert not found.finite.any()
    for one, order in ((found.strengths, slice(None)), (turned.strengths, slice(None, None, -1))):
        assert one.value[order].sum() == pytest.approx(0) and (np.diff(one.value[order]) < -1).all()
        assert [value == np.inf for value in one.high[order]] == [True] * (count - 1) + [False]
        assert [value == -np.inf for value in one.low[order]] == [False] + [True] * (count - 1)
    np.testing.assert_allclose(found.strengths.value, -turned.strengths.value, atol=1e-9)


def test_systems_that_were_not_compared_have_no_common_scale():
    found = estimate(compared([(p, 0, 2 * (p % 2), 2 * (p % 2) + 1, (-1) ** (p // 2)) for p in range(8)]), 4)
    assert not found.is_connected and np.isnan(found.differences.value).all()


def test_equal_choices_and_one_participant():
    rows = [(0, c, 0, 1, (1, 1, -1)[c % 3]) for c in range(9)]
    one = estimate(compared(rows), 2)
    assert np.isfinite(one.differences.value).all() and np.isnan(one.differences.low).all()
    assert estimate(compared([*rows, (0, 9, 0, 1, 0)]), 2).differences.value == one.differences.value

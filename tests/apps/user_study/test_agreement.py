"""Fleiss' kappa agrees with published examples and with statsmodels, and takes incomplete designs."""

import numpy as np
import pytest

from ha2g_jax.apps.user_study.estimates import agreement, fleiss_kappa

# Fleiss 1971, Table 1: diagnoses of 30 patients by 6 psychiatrists each: depression, personality disorder,
# schizophrenia, neurosis, other. The article gives the agreement 0.555 and kappa 0.430.
DIAGNOSES = """
00060 03003 01401 00006 03030 20400 00402 20310 20040 00006 10050 11040 03300 10050 02031
00501 30012 51000 02040 10203 00006 01050 02013 20040 10041 05010 40002 02040 10500 00006
"""
# The example of 10 subjects and 14 raters of the article on Fleiss' kappa in Wikipedia, with kappa 0.210.
RATERS = [
    *([0, 0, 0, 0, 14], [0, 2, 6, 4, 2], [0, 0, 3, 5, 6], [0, 3, 9, 2, 0], [2, 2, 8, 1, 1]),
    *([7, 7, 0, 0, 0], [3, 2, 6, 3, 0], [2, 5, 3, 2, 2], [6, 5, 2, 1, 0], [0, 2, 2, 3, 7]),
]


def test_published_examples():
    table = np.array([[int(count) for count in row] for row in DIAGNOSES.split()])
    assert table.shape == (30, 5) and (table.sum(1) == 6).all()
    assert fleiss_kappa(table) == pytest.approx(0.430, abs=5e-4)
    assert fleiss_kappa(np.array(RATERS)) == pytest.approx(0.210, abs=5e-4)


def test_complete_tables_as_in_statsmodels():
    inter_rater = pytest.importorskip("statsmodels.stats.inter_rater")
    random = np.random.default_rng(0)
    for _ in range(20):
        table = random.multinomial(7, random.dirichlet(np.ones(4)), size=9)
        assert fleiss_kappa(table) == pytest.approx(inter_rater.fleiss_kappa(table))


def test_incomplete_design():
    """Items with one answer do not count; with other numbers of answers, each item counts the same."""
    table = np.array([[3, 0], [0, 2], [1, 1], [1, 0]])
    agree, chance = (1 + 1 + 0) / 3, ((1 + 0 + 0.5) / 3) ** 2 + ((0 + 1 + 0.5) / 3) ** 2
    assert fleiss_kappa(table) == pytest.approx((agree - chance) / (1 - chance))
    assert np.isnan(fleiss_kappa(np.array([[1, 0], [0, 1]])))  # nobody answered the same item
    assert np.isnan(fleiss_kappa(np.array([[3, 0], [4, 0]])))  # nothing but one answer


def test_interval_of_answers():
    random = np.random.default_rng(1)
    truth = random.integers(3, size=20)
    participants, items = (each.ravel() for each in np.indices((12, 20)))
    answers = np.where(random.random(240) < 0.7, truth[items], random.integers(3, size=240))
    found = agreement(participants, items // 2, items, answers)
    assert found.low < 0.49 < found.high and found.low > 0.2  # two answers agree by truth with probability 0.7^2
    copies = agreement(participants, items // 2, items, truth[items])
    assert copies.value == pytest.approx(1) and np.isnan(copies.low)  # nothing varies

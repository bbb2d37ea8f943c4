"""A claim is held, not held or undecided by the paired difference over seeds, whatever the seeds share."""

import pytest

from ha2g_jax.study.reproduction.claims import HELD, LEVEL, NOT_HELD, NOTHING_FOUND, UNDECIDED, judge, over_seeds


def test_the_interval_is_student_s():
    # By hand: mean 2, standard deviation 1, t(.975, 2) = 4.302653.
    spread = over_seeds([1.0, 2.0, 3.0])
    assert spread.mean == 2 and spread.num == 3
    assert spread.low is not None and spread.high is not None
    assert spread.high - spread.mean == pytest.approx(4.302653 / 3**0.5, rel=1e-6)
    assert spread.mean - spread.low == pytest.approx(spread.high - spread.mean)
    assert over_seeds([5.0]) == (5.0, None, None, 1)


def test_what_the_seeds_share_cancels():
    reference = {0: 10.0, 1: 20.0, 2: 30.0}
    row = {0: 11.1, 1: 21.0, 2: 31.2}
    verdict = judge(reference, row, is_higher_better=False)
    assert verdict.verdict == HELD
    assert verdict.difference and verdict.difference.mean == pytest.approx(-1.1)
    assert judge(reference, row, is_higher_better=True).verdict == NOT_HELD
    assert judge(row, reference, is_higher_better=True).verdict == HELD


def test_an_interval_that_covers_zero_decides_nothing():
    assert judge({0: 1.0, 1: 2.0, 2: 3.0}, {0: 2.0, 1: 1.0, 2: 2.5}, is_higher_better=True).verdict == UNDECIDED
    assert judge({0: 1.0, 1: 1.0}, {0: 1.0, 1: 1.0}, is_higher_better=True).verdict == UNDECIDED


def test_one_seed_decides_nothing():
    verdict = judge({0: 9.0}, {0: 1.0}, is_higher_better=True)
    assert verdict.verdict == UNDECIDED and verdict.difference == (8.0, None, None, 1)
    assert judge({0: 9.0}, {1: 1.0}, is_higher_better=True) == (None, UNDECIDED)


def test_only_seeds_of_both_rows_count():
    verdict = judge({0: 1.0, 1: 1.1, 2: 50.0}, {0: 0.0, 1: 0.0, 3: 99.0}, is_higher_better=True)
    assert verdict.difference and verdict.difference.num == 2 and verdict.difference.mean == pytest.approx(1.05)


def test_a_claim_of_likeness_is_refuted_by_either_side():
    far, near = {0: 1.0, 1: 1.01, 2: 0.99}, {0: 0.0, 1: 0.01, 2: -0.02}
    zero = dict.fromkeys(range(3), 0.0)
    for reference, row in ((far, zero), (zero, far)):
        assert judge(reference, row, is_higher_better=True, is_comparable=True).verdict == NOT_HELD
    assert judge(near, zero, is_higher_better=True, is_comparable=True).verdict == NOTHING_FOUND
    assert LEVEL == 0.95

"""Claims are tested by paired differences over seeds and speakers, corrected for their number."""

import numpy as np
import pytest
from tables.claims import (
    HELD,
    NOT_HELD,
    NOTHING_FOUND,
    UNDECIDED,
    Claim,
    Mean,
    Measured,
    combine,
    interval,
    judge,
    over_seeds,
    paired,
)
from tables.tables import by_seed


def _difference(reference, row):
    return paired(*({seed: Measured(value) for seed, value in each.items()} for each in (reference, row)))


def _verdict(reference, row, *, is_higher_better=True, is_comparable=False):
    (verdict,) = judge([Claim(_difference(reference, row), is_higher_better, is_comparable)])
    return verdict


def test_the_interval_is_student_s():
    # By hand: mean 2, standard deviation 1, t(.975, 2) = 4.302653.
    spread = over_seeds([1.0, 2.0, 3.0])
    assert spread.mean == 2 and spread.num == 3
    assert spread.low is not None and spread.high is not None
    assert spread.high - spread.mean == pytest.approx(4.302653 / 3**0.5, rel=1e-6)
    assert spread.mean - spread.low == pytest.approx(spread.high - spread.mean)
    assert over_seeds([5.0]) == (5.0, None, None, 1)


def test_the_error_has_the_variances_of_seeds_and_of_groups():
    no_groups = combine([Measured(value, np.full(3, value)) for value in (0.1, 0.2, 0.4)])
    assert interval(no_groups) == pytest.approx(over_seeds([0.1, 0.2, 0.4]))
    no_seeds = combine([Measured(0.5, np.array([0.4, 0.5, 0.6]))] * 2)
    assert no_seeds == pytest.approx(Mean(0.5, (2 / 3 * 0.02) ** 0.5, 2, 2))
    assert combine([Measured(0.1, np.zeros(3))]).error is None


def test_what_the_seeds_share_cancels():
    reference = {0: 10.0, 1: 20.0, 2: 30.0}
    row = {0: 11.1, 1: 21.0, 2: 31.2}
    verdict = _verdict(reference, row, is_higher_better=False)
    assert verdict.verdict == HELD
    assert verdict.difference and verdict.difference.mean == pytest.approx(-1.1)
    assert _verdict(reference, row).verdict == NOT_HELD
    assert _verdict(row, reference).verdict == HELD


def test_one_seed_decides_nothing():
    verdict = _verdict({0: 9.0}, {0: 1.0})
    assert verdict.verdict == UNDECIDED and verdict.difference == (8.0, None, None, 1) and verdict.p_value is None
    assert _verdict({0: 9.0}, {1: 1.0}) == (None, None, UNDECIDED)


def test_only_seeds_of_both_rows_count():
    found = _difference({0: 1.0, 1: 1.1, 2: 50.0}, {0: 0.0, 1: 0.0, 3: 99.0})
    assert found and found.num == 2 and found.value == pytest.approx(1.05)


def test_a_claim_of_likeness_is_refuted_by_either_side():
    far, near = {0: 1.0, 1: 1.01, 2: 0.99}, {0: 0.0, 1: 0.01, 2: -0.02}
    zero = dict.fromkeys(range(3), 0.0)
    for reference, row in ((far, zero), (zero, far)):
        assert _verdict(reference, row, is_comparable=True).verdict == NOT_HELD
    assert _verdict(near, zero, is_comparable=True).verdict == NOTHING_FOUND


def test_more_claims_need_larger_differences():
    edge = Claim(Mean(2.1, 1.0, 30.0, 31), is_higher_better=True)  # p = 0.044
    assert [each.verdict for each in judge([edge])] == [HELD]
    alone, together = judge([edge])[0], judge([edge, edge])[0]
    assert together.verdict == UNDECIDED and together.p_value == pytest.approx(2 * (alone.p_value or 0))
    assert together.difference and together.difference.low is not None and together.difference.low < 0


def test_all_true_null_hypotheses_are_kept_in_nineteen_of_twenty_tables():
    rng, wrong = np.random.default_rng(0), 0
    for _ in range(400):
        seeds, speakers = rng.normal(size=(8, 5, 1)), 0.5 * rng.normal(size=(8, 1, 12))
        values = seeds + speakers + rng.normal(size=(8, 5, 12))
        claims = []
        for table in values:
            without = (table.sum(axis=1, keepdims=True) - table) / 11
            runs = [Measured(float(row.mean()), rest) for row, rest in zip(table, without, strict=True)]
            claims.append(Claim(combine(runs), is_higher_better=True))
        wrong += any(verdict.verdict != UNDECIDED for verdict in judge(claims))
    assert wrong <= 400 * 0.05 + 2 * (400 * 0.05 * 0.95) ** 0.5


@pytest.mark.parametrize("without", [[None], [0.5, None]])
def test_without_other_speakers_nothing_is_decided(without):
    """Leaving out the only speaker leaves nothing to measure."""
    talk = {"without_speakers": {"x": dict(enumerate(without))}}
    rows = []
    for value in (1.0, 0.0):
        scores = {
            seed: talk | {"rows": {"model": {"x": {"value": value + seed, "low": None, "high": None}}}}
            for seed in range(3)
        }
        rows.append(
            by_seed({seed: {"splits": {"test": {"talk": one}}} for seed, one in scores.items()}, "test", "talk.x")
        )
    (verdict,) = judge([Claim(paired(*rows), is_higher_better=True)])
    assert verdict.verdict == UNDECIDED and verdict.p_value is None

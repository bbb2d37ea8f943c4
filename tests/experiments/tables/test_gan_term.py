"""The GAN term helps only if a measure is nearer to the truth over seeds and the fit is kept."""

import pytest
from tables.gan_term import gan_lines

TRUTH = {"fgd": 0.0, "jerk_ratio": 1.0, "diversity_l1": 40.0}
FIT = {"HA2G": {0: 1.03, 1: 1.05, 2: 1.04}, "HA2G without GAN": dict.fromkeys(range(3), 1.0)}


def _scores(**values: float):
    rows = {
        name: {metric: {"value": each, "low": None, "high": None} for metric, each in mine.items()}
        for name, mine in (("model", TRUTH | values), ("ground truth", TRUTH))
    }
    return {"splits": {"test": {"evaluation": {"rows": rows}}}}


def _rows(with_term: list[dict], without: list[dict]):
    pair = {"HA2G": with_term, "HA2G without GAN": without}
    return {name: {seed: _scores(**values) for seed, values in enumerate(mine)} for name, mine in pair.items()}


def _said(lines: list[str]) -> dict[str, str]:
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2].splitlines()[2:]]
    return {cell[0]: cell[-1] for cell in cells}


def test_nearer_is_less_distance_on_either_side_of_the_truth():
    jerks = [{"jerk_ratio": 1.1 + 0.01 * seed, "diversity_l1": 45.0 + seed} for seed in range(3)]
    lines = gan_lines(_rows(jerks, [{"jerk_ratio": 0.5, "diversity_l1": 38.0}] * 3), FIT, "test")
    assert _said(lines) == {"jerk / truth": "nearer", "FGD": "undecided", "Diversity (L1)": "farther"}
    assert "changes by +4.0% [+1.5%, +6.5%] with the GAN term. The GAN term **helps**." in lines[-1]


@pytest.mark.parametrize(
    ("jerks", "fit", "sentence"),
    [
        ([0.9, 0.4, 1.3], 1.0, "**was not shown to help**"),
        ([0.9, 0.91, 0.92], 1.06, "changes by +6.0% [+6.0%, +6.0%] with the GAN term. The GAN term **was not shown"),
        ([0.9, 0.91, 0.92], 0.9, "changes by -10.0% [-10.0%, -10.0%] with the GAN term. The GAN term **helps**"),
    ],
)
def test_noise_or_a_worse_fit_is_no_help_but_a_better_fit_is(jerks, fit, sentence):
    validation = {"HA2G": dict.fromkeys(range(3), fit), "HA2G without GAN": dict.fromkeys(range(3), 1.0)}
    lines = gan_lines(_rows([{"jerk_ratio": it} for it in jerks], [{"jerk_ratio": 0.5}] * 3), validation, "test")
    assert sentence in lines[-1]


def test_a_run_without_scores_does_not_count():
    """A run that breaks has a checkpoint and a bad fit, but no scores."""
    jerks = [{"jerk_ratio": 0.9 + 0.01 * seed} for seed in range(3)]
    rows = _rows(jerks, [{"jerk_ratio": 0.5}] * 4)
    validation = {"HA2G": {**FIT["HA2G"], 3: 2.0}, "HA2G without GAN": dict.fromkeys(range(4), 1.0)}
    assert gan_lines(rows, validation, "test") == gan_lines(_rows(jerks, [{"jerk_ratio": 0.5}] * 3), FIT, "test")


def test_nothing_is_said_without_both_rows_or_without_the_fit():
    rows = _rows([{}], [{}])
    assert gan_lines({"HA2G": rows["HA2G"]}, FIT, "test") == []
    assert "because a run has not logged" in gan_lines(rows, {}, "test")[-1]

"""Runs that differ only in the seed are one line; others are named by what they differ in."""

import numpy as np
import pytest

from ha2g_jax.train.report.curves import last_values, make_curves
from ha2g_jax.train.report.lines import common_differing, differing, make_lines, short_names
from ha2g_jax.train.report.runs import read_runs
from ha2g_jax.train.report.series import Series


def test_seeds_of_a_config_are_one_line(make_run):
    paths = [
        make_run(f"{rate}-{seed}", **{"seed": seed, "train.learning_rate": rate})
        for rate in (1e-4, 1e-3)
        for seed in (0, 1)
    ]
    runs = read_runs(paths)
    lines = make_lines(runs)
    assert [line.label for line in lines] == ["learning_rate=0.0001", "learning_rate=0.001"]
    assert [[run.name for run in line.runs] for line in lines] == [["0.0001-0", "0.0001-1"], ["0.001-0", "0.001-1"]]
    assert set(differing(runs)) == {"seed", "train.learning_rate"}


def test_runs_with_one_config_and_one_seed_are_lines_of_their_own(make_run):
    lines = make_lines(read_runs([make_run("a"), make_run("b"), make_run("c", seed=1)]))
    assert [line.label for line in lines] == ["a", "b", "c"]


def test_settings_of_another_method_are_told_by_its_name(make_run):
    from ha2g_jax.config import presets

    other = make_run("b")
    (other / "config.json").write_text(presets.parse("talk:debug", "seq2seq").to_json())
    runs = read_runs([make_run("a"), other])
    assert "method" in common_differing(runs) and "loss.ha2g.weights.gan" not in common_differing(runs)
    assert "loss.ha2g.weights.gan" in differing(runs)


def test_names_are_as_short_as_they_can_be_told_apart():
    short = short_names(["loss.ha2g.weights.gan", "loss.ha2g.gan", "train.steps"])
    assert list(short.values()) == ["weights.gan", "ha2g.gan", "steps"]


@pytest.fixture
def two_seeds(make_run):
    """A line of two seeds, a and b, and another line, c."""
    return make_lines(read_runs([make_run("a"), make_run("b", seed=1), make_run("c", **{"train.batch_size": 8})]))


def by_path(lines, metrics):
    """Return metrics by the name of a run as metrics by its workdir."""
    return {run.path: metrics[run.name] for line in lines for run in line.runs}


def test_the_band_is_from_the_least_to_the_greatest_seed(two_seeds):
    steps = np.array([10, 20, 30])
    first, second = Series(steps, np.array([1.0, 2, 3])), Series(steps[:2], np.array([3.0, 6]))
    metrics = {"a": {"x": first}, "b": {"x": second}, "c": {}}
    (curve,) = make_curves("x", two_seeds, by_path(two_seeds, metrics), 0.0)
    assert curve.mean.tolist() == [2, 4, 3] and curve.low is not None and curve.high is not None
    assert curve.low.tolist() == [1, 2, 3] and curve.high.tolist() == [3, 6, 3]
    assert curve.is_whole.tolist() == [True, True, False] and curve.num_runs == 2
    assert last_values(curve)[:4] == (20, 4.0, 2.0, 6.0)  # where both seeds have come to


def test_seeds_that_are_logged_at_other_steps_are_compared_at_all_of_them(two_seeds):
    metrics = {
        "a": {"x": Series(np.array([0, 20]), np.array([0.0, 2]))},
        "b": {"x": Series(np.array([0, 10, 20]), np.array([0.0, 3, 4]))},
        "c": {},
    }
    (curve,) = make_curves("x", two_seeds, by_path(two_seeds, metrics), 0.0)
    assert curve.steps.tolist() == [0, 10, 20] and curve.mean.tolist() == [0, 2, 3]


def test_a_metric_of_some_lines_is_a_curve_of_these(two_seeds):
    metrics = {"a": {}, "b": {}, "c": {"x": Series(np.array([1]), np.array([2.0]))}}
    (curve,) = make_curves("x", two_seeds, by_path(two_seeds, metrics), 0.0)
    assert curve.number == 1 and curve.low is None and curve.logged is not None
    assert make_curves("y", two_seeds, by_path(two_seeds, metrics), 0.0) == []

"""Logged rows become curves: what was written again holds, gaps stay gaps, and long runs keep their means and peaks."""

import math

import numpy as np
import pytest

from ha2g_jax.train.report.series import Series, extremes, running_mean, shown_steps, to_series


def test_rows_written_after_a_restart_replace_those_before_it():
    rows = [{"step": step, "loss/huber": step / 10} for step in (10, 20, 30, 40)]
    rows += [{"step": step, "loss/huber": step / 100} for step in (20, 30)]  # killed at 40, continued from 10
    series = to_series(rows)["loss/huber"]
    assert series.steps.tolist() == [10, 20, 30]
    assert series.values.tolist() == [1.0, 0.2, 0.3]


def test_metrics_of_different_rows_are_apart_and_clocks_are_none():
    rows = [{"step": 1, "loss/huber": 3.0, "seconds": 7.0, "compile_seconds": 5.0}, {"step": 1, "validation/x": 4.0}]
    assert {name: one.values.tolist() for name, one in to_series(rows).items()} == {
        "loss/huber": [3.0],
        "validation/x": [4.0],
    }


def test_values_that_are_not_finite_are_left_out_and_counted():
    series = to_series([{"step": step, "x": value} for step, value in enumerate([1.0, math.nan, 3.0, math.inf])])["x"]
    assert series.steps.tolist() == [0, 2] and series.num_left_out == 2


def test_the_running_mean_is_that_of_the_window():
    series = Series(np.arange(0, 100, 10), np.arange(10.0) ** 2)
    means = running_mean(series, np.array([0.0, 50.0, 90.0]), 20.0)
    assert means == pytest.approx([np.mean([0, 1]), np.mean([16, 25, 36]), np.mean([64, 81])])
    assert running_mean(series, series.steps.astype(float), 0.0) == pytest.approx(series.values)


def test_a_mean_is_joined_over_a_gap_and_ends_with_the_series():
    series = Series(np.array([10, 30]), np.array([1.0, 3.0]))
    means = running_mean(series, np.array([0.0, 10.0, 20.0, 30.0, 40.0]), 0.0)
    np.testing.assert_allclose(means, [np.nan, 1, 2, 3, np.nan])


def test_one_row_is_one_point():
    series = to_series([{"step": 5, "x": 2.0}])["x"]
    at = shown_steps([series], 240)
    assert at.tolist() == [5] and running_mean(series, at, 100.0).tolist() == [2.0]


def test_thinning_keeps_the_outliers_and_the_order():
    values = np.random.default_rng(0).normal(size=100_000)
    values[54_321], values[77_777] = 99.0, -99.0
    thin = extremes(Series(np.arange(100_000), values), 480)
    assert len(thin.steps) <= 480 and (np.diff(thin.steps) > 0).all()
    assert thin.values.max() == 99.0 and thin.values.min() == -99.0
    assert (values[thin.steps] == thin.values).all()


def test_means_of_a_thinned_run_are_those_of_all_its_values():
    series = Series(np.arange(100_000), np.random.default_rng(0).normal(size=100_000))
    at = shown_steps([series], 240)
    means = running_mean(series, at, at[1] - at[0])
    assert len(at) == 240 and means[1:-1].mean() == pytest.approx(series.values.mean(), abs=1e-3)
    assert means.std() < 0.1

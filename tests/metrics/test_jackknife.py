"""Standard errors agree with those that have a formula, and respect clusters."""

import numpy as np
import pytest

from ha2g_jax.metrics.uncertainty import jackknife

X = np.random.default_rng(0).normal(size=200)


def test_error_of_a_mean_is_the_textbook_one():
    value, error = jackknife(X, lambda x: float(np.mean(x)), np.arange(200))
    assert value == pytest.approx(X.mean())
    assert error == pytest.approx(X.std(ddof=1) / np.sqrt(200))


def test_repeating_a_sample_within_its_cluster_teaches_nothing():
    once = jackknife(X, lambda x: float(np.mean(x)), np.arange(200))
    thrice = jackknife(np.repeat(X, 3), lambda x: float(np.mean(x)), np.repeat(np.arange(200), 3))
    assert thrice == pytest.approx(once)


def test_undefined_where_there_is_too_little():
    assert np.isnan(jackknife(X[:0], lambda x: float(np.mean(x)), X[:0])).all()
    value, error = jackknife(X, lambda x: float(np.mean(x)), np.zeros(200))
    assert value == pytest.approx(X.mean()) and np.isnan(error)

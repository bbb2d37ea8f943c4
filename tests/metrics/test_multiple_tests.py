"""Holm's correction, by hand and as in statsmodels."""

import numpy as np
import pytest

from ha2g_jax.metrics.uncertainty import holm


def test_by_hand():
    # 0.01 x 4; 0.02 x 3; 0.03 x 2 = 0.06; 0.04 x 1 is raised to 0.06.
    assert holm([0.03, 0.01, 0.04, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([]) == []


def test_as_in_statsmodels():
    multitest = pytest.importorskip("statsmodels.stats.multitest")
    random = np.random.default_rng(0)
    for num in (1, 2, 7, 24):
        values = (random.uniform(size=num) ** 3).tolist()
        assert holm(values) == pytest.approx(multitest.multipletests(values, method="holm")[1])

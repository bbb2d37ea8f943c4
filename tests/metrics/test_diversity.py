"""Diversity is a mean over distinct pairs of different sources; the legacy one over whole batches."""

import numpy as np
import pytest

from ha2g_jax.metrics.diversity import diversity, multimodality
from ha2g_jax.metrics.legacy import legacy_diversity


def all_pairs(latents: np.ndarray, sources: np.ndarray) -> list[np.ndarray]:
    """The differences of every pair of different sources, by two loops."""
    n = len(latents)
    return [latents[i] - latents[j] for i in range(n) for j in range(i) if sources[i] != sources[j]]


def realistic(sources: int = 60, windows: int = 40, dim: int = 128) -> tuple[np.ndarray, np.ndarray]:
    """Latents of a realistic size: variance falling as 1/k over components, windows around their recording's centre."""
    rng = np.random.default_rng(0)
    centres = np.repeat(rng.normal(size=(sources, dim)), windows, axis=0)
    latents = (0.6 * centres + rng.normal(size=centres.shape)) / np.sqrt(np.arange(1, dim + 1))
    return latents, np.repeat(np.arange(sources), windows)


def test_all_pairs_where_there_are_few():
    """Each draw has every pair of different sources once; labels need be neither sorted nor numbers."""
    latents = np.random.default_rng(1).normal(size=(12, 4))
    sources = np.array(list("cabacabbbcac"))
    pairs = np.array(all_pairs(latents, sources))
    for num_pairs in (len(pairs), 500):
        draws = diversity(latents, sources, num_pairs=num_pairs, num_draws=3)
        np.testing.assert_allclose(draws.l1, np.full(3, np.abs(pairs).sum(axis=1).mean()))
        np.testing.assert_allclose(draws.l2, np.full(3, np.linalg.norm(pairs, axis=1).mean()))


@pytest.mark.parametrize("num_pairs", [1, 25])
def test_pairs_of_a_draw_are_distinct_fair_and_of_different_sources(num_pairs):
    """Latents at powers of two, so that a distance names its pair: each of the 26 eligible pairs is met as often.

    With 25 pairs of 26 a draw misses exactly one, so that a pair taken twice would show.
    """
    sources = np.array([0, 0, 0, 1, 1, 2, 2, 2, 2])[[4, 1, 8, 0, 2, 6, 3, 5, 7]]
    latents = (2.0 ** np.arange(9))[:, None]
    pairs = np.abs(all_pairs(latents, sources))[:, 0]
    assert len(pairs) == len(np.unique(pairs)) == 26
    sums = diversity(latents, sources, num_pairs=num_pairs, num_draws=2000).l1 * num_pairs
    named = sums if num_pairs == 1 else pairs.sum() - sums
    counts = np.isclose(named[:, None], pairs[None]).sum(axis=0)
    assert counts.sum() == 2000
    assert np.all(np.abs(counts - 2000 / 26) < 5 * np.sqrt(2000 / 26))


def test_draws_spread_as_in_table_12():
    """Ten draws of 500 pairs of 128 latent numbers differ as the paper's ten seeds do, by about 0.4 % of the mean.

    Protects the number and the independence of the pairs: the spread is that of 500 separate pairs, (std / mean of a
    pair) / sqrt(500). Fewer pairs, a pair met often or whole batches of pairs spread more; the same pairs in each draw
    not at all.
    """
    published = np.array([172.58, 171.91, 173.60, 173.66, 173.71, 172.12, 171.88, 173.02, 173.80, 172.83])
    table_12 = published.std(ddof=1) / published.mean()
    assert table_12 == pytest.approx(0.0044, abs=1e-4)
    latents, sources = realistic()
    spreads = [draws.std(ddof=1) / draws.mean() for draws in (diversity(latents, sources, seed=s).l1 for s in range(8))]
    assert table_12 / 1.5 < np.mean(spreads) < 1.5 * table_12
    assert max(spreads) < 2 * table_12

    rng = np.random.default_rng(1)
    first, second = rng.integers(len(latents), size=(2, 20_000))
    apart = sources[first] != sources[second]
    pairs = np.abs(latents[first[apart]] - latents[second[apart]]).sum(axis=1)
    expected = pairs.std() / pairs.mean() / np.sqrt(500)
    draws = diversity(latents, sources, num_draws=300).l1
    assert draws.std() / draws.mean() == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("n", [0, 1, 5])
def test_undefined_without_a_second_source(n):
    draws = diversity(np.ones((n, 3)), np.zeros(n))
    assert np.shape(draws) == (2, 10) and np.isnan(draws).all()


@pytest.mark.parametrize("labels", [4, 6])
def test_labels_that_are_not_as_many_as_the_latents_are_refused(labels):
    with pytest.raises(ValueError, match=f"{labels} labels of 5 latents"):
        diversity(np.ones((5, 3)), np.arange(labels))


def test_multimodality_is_the_mean_over_all_pairs():
    assert multimodality(np.array([[0.0, 0.0], [3.0, 4.0]])) == 7
    latents = np.random.default_rng(2).normal(size=(4, 5))
    pairs = [np.abs(a - b).sum() for i, a in enumerate(latents) for b in latents[:i]]
    assert multimodality(latents) == pytest.approx(np.mean(pairs))


def legacy_by_hand(latents: np.ndarray, batch_size: int, permutation: np.ndarray) -> float:
    """The legacy definition, row by row."""
    count = min(500, len(permutation))
    distances = [
        np.abs(latents[batch * batch_size + row] - latents[permutation[batch] * batch_size + row]).sum()
        for batch in range(count)
        for row in range(batch_size)
    ]
    return float(np.mean(distances))


def test_legacy_keeps_its_stored_values():
    """37 rows are 9 batches of 4; the last row is dropped, and with seed 0 batch 2 meets itself."""
    latents = np.random.default_rng(5).normal(size=(37, 3)).astype(np.float32)
    order = np.array([4, 5, 2, 6, 3, 8, 7, 0, 1])
    np.testing.assert_array_equal(np.random.default_rng(0).permutation(9), order)
    assert legacy_diversity(latents, 4, 0) == pytest.approx(2.854880509794586, rel=1e-6)
    assert legacy_diversity(latents, 4, 1) == pytest.approx(3.053683446823723, rel=1e-6)
    assert legacy_diversity(latents, 1, 0) == pytest.approx(3.033113052388905, rel=1e-6)
    assert legacy_by_hand(latents, 4, order) == pytest.approx(2.854880509794586, rel=1e-6)
    latents[36] = np.nan
    assert legacy_diversity(latents, 4, 0) == pytest.approx(2.854880509794586, rel=1e-6)


def test_legacy_draws_its_second_set_from_all_batches():
    """Beyond 500 batches the first set stops at 500, the permutation does not."""
    latents = np.random.default_rng(6).normal(size=(1203, 2))
    permutation = np.random.default_rng(3).permutation(601)
    assert legacy_diversity(latents, 2, 3) == pytest.approx(legacy_by_hand(latents, 2, permutation), rel=1e-12)


def test_legacy_batch_meets_itself():
    assert legacy_diversity(np.random.default_rng(7).normal(size=(9, 2)), 5, 0) == 0
    assert np.isnan(legacy_diversity(np.ones((3, 2)), 4, 0))

"""Intervals and standard errors have the width that theory gives them, and respect clusters; Holm by hand."""

import numpy as np
import pytest

from ha2g_jax.metrics import frechet
from ha2g_jax.metrics.row import Cut, Latents, mean_by_recording
from ha2g_jax.metrics.uncertainty import Interval, bootstrap, holm, jackknife

X = np.random.default_rng(0).normal(size=200) + 3
EACH = np.arange(200)
SOURCES = np.array([f"video {i}" for i in np.random.default_rng(1).integers(12, size=200)])


def by_indices(statistic, clusters, **options) -> Interval:
    """The interval of a function of the indices of samples; a sample that is drawn twice is listed twice."""
    _, members = np.unique(clusters, return_inverse=True)
    samples = np.arange(len(members))
    return bootstrap(lambda counts: statistic(np.repeat(samples, counts[members])), len(set(clusters)), **options)


def by_sums(values, clusters, *, weights=None, **options) -> Interval:
    """The interval of a mean, from sums by cluster."""
    labels, members = np.unique(clusters, return_inverse=True)
    return bootstrap(mean_by_recording(values, members, len(labels), weights), len(labels), **options)


def mean_of(values: np.ndarray):
    return lambda indices: float(np.mean(values[indices]))


def test_interval_of_a_mean_is_the_textbook_one():
    """Mean plus and minus 1.96 standard errors, within what 1000 draws can tell; narrower at a lower level."""
    value, low, high = by_indices(mean_of(X), EACH)
    half = 1.96 * X.std() / np.sqrt(200)
    assert value == X.mean()
    assert low == pytest.approx(value - half, abs=half / 5) and high == pytest.approx(value + half, abs=half / 5)
    value, low, high = by_indices(mean_of(X), EACH, level=0.5)
    half = 0.674 * X.std() / np.sqrt(200)
    assert low == pytest.approx(value - half, abs=half / 5) and high == pytest.approx(value + half, abs=half / 5)


def test_bounds_are_percentiles_of_the_seeded_draws():
    """The draws by hand: one resample of clusters after another from one generator."""
    rng = np.random.default_rng(5)
    labels = np.unique(SOURCES)
    scores = []
    for _ in range(40):
        drawn = labels[rng.integers(12, size=12)]
        scores.append(np.concatenate([X[label == SOURCES] for label in drawn]).max())
    _, low, high = by_indices(lambda indices: float(X[indices].max()), SOURCES, draws=40, seed=5, level=0.8)
    assert (low, high) == pytest.approx(tuple(np.percentile(scores, [10, 90])))


def test_repeating_a_sample_within_its_cluster_teaches_nothing():
    """Protects the clusters: drawn window by window, three copies would shrink the interval by 1.7."""
    once = by_indices(mean_of(X), EACH)
    thrice = by_indices(mean_of(np.repeat(X, 3)), np.repeat(EACH, 3))
    assert thrice == pytest.approx(once)
    apart = by_indices(mean_of(np.repeat(X, 3)), np.arange(600))
    assert (apart.high - apart.low) * 1.5 < once.high - once.low


def test_means_by_sums_equal_means_by_indices():
    values = X.copy()
    values[::7] = np.nan
    slow = by_indices(lambda indices: float(np.nanmean(values[indices])), SOURCES, draws=200)
    assert by_sums(values, SOURCES, draws=200) == pytest.approx(slow, rel=1e-12)
    frames = np.random.default_rng(2).integers(1, 90, size=200)
    slow = by_indices(lambda i: float(np.average(X[i], weights=frames[i])), SOURCES, draws=200)
    assert by_sums(X, SOURCES, weights=frames, draws=200) == pytest.approx(slow, rel=1e-12)


def test_a_distance_from_parts_equals_one_from_its_latents():
    """The fast path of an FGD: moments per source, in the order of np.unique."""
    latents = np.random.default_rng(4).normal(size=(200, 3))
    real = frechet.moments(np.random.default_rng(5).normal(size=(150, 3)) * 2)
    _, members = np.unique(SOURCES, return_inverse=True)
    parts = frechet.RecordingMoments(Latents(latents, members, EACH, Cut("fgd", 4, 34)), 12)
    fast = bootstrap(lambda counts: frechet.distance(parts.pool(counts), real), 12, draws=30)
    slow = by_indices(lambda i: frechet.distance(frechet.moments(latents[i]), real), SOURCES, draws=30)
    assert fast == pytest.approx(slow, rel=1e-9) and slow.low < slow.high


def test_undefined_where_there_is_too_little():
    """No sample, one source, no score at all: NaN, neither a crash nor a warning."""
    assert np.isnan(by_indices(mean_of(X), EACH[:0])).all()
    assert np.isnan(by_sums(X[:0], EACH[:0])).all()
    for one in (by_indices(mean_of(X), np.zeros(200)), by_sums(X, np.zeros(200))):
        assert one.value == pytest.approx(X.mean()) and np.isnan(one[1:]).all()
    assert np.isnan(by_sums(np.full(200, np.nan), SOURCES)).all()
    assert np.isnan(by_indices(lambda indices: np.nan, SOURCES, draws=10)).all()


def test_draws_without_a_score_are_left_out():
    """Only one of three clips has a value: a draw that misses it has no mean, the others all have the same."""
    values = np.array([np.nan, 4.0, np.nan])
    assert by_sums(values, np.arange(3)) == Interval(4.0, 4.0, 4.0)


SAMPLES = np.random.default_rng(0).normal(size=200)


def test_error_of_a_mean_is_the_textbook_one():
    value, error = jackknife(SAMPLES, lambda x: float(np.mean(x)), np.arange(200))
    assert value == pytest.approx(SAMPLES.mean())
    assert error == pytest.approx(SAMPLES.std(ddof=1) / np.sqrt(200))


def test_no_error_where_there_is_too_little():
    assert np.isnan(jackknife(SAMPLES[:0], lambda x: float(np.mean(x)), SAMPLES[:0])).all()
    value, error = jackknife(SAMPLES, lambda x: float(np.mean(x)), np.zeros(200))
    assert value == pytest.approx(SAMPLES.mean()) and np.isnan(error)


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

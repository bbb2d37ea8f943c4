"""The Frechet distance has its closed form, bears singular and extreme sets, and does not depend on chunks."""

import numpy as np
import pytest
from scipy import linalg

from ha2g_jax.errors import UserError
from ha2g_jax.metrics import frechet, legacy

DIM = 6


def exact_sample(n: int, covariance: np.ndarray, mean: np.ndarray, seed: int = 0) -> np.ndarray:
    """Rows whose sample mean and sample covariance are the given ones."""
    rows = np.random.default_rng(seed).normal(size=(n, len(mean)))
    rows -= rows.mean(axis=0)
    white = rows @ np.linalg.inv(np.linalg.cholesky(np.cov(rows, rowvar=False))).T
    return white @ np.linalg.cholesky(covariance).T + mean


def random_covariance(seed: int, dim: int = DIM) -> np.ndarray:
    factor = np.random.default_rng(seed).normal(size=(dim, dim + 3))
    return factor @ factor.T


def between(a: np.ndarray, b: np.ndarray) -> float:
    return frechet.distance(frechet.moments(a), frechet.moments(b))


def by_schur(a: np.ndarray, b: np.ndarray) -> float:
    """The textbook formula, with the general matrix square root."""
    first, second = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    step = a.mean(axis=0) - b.mean(axis=0)
    return float(step @ step + np.trace(first + second - 2 * np.real(linalg.sqrtm(first @ second))))


def test_equal_sets_are_at_zero_whatever_their_rank():
    """Protects the zero that the row of ground truth must show."""
    rows = np.random.default_rng(0).normal(size=(50, DIM))
    for same in (rows, rows[:3], rows + 1e6, rows * 1e8, rows * 1e-8, np.ones((9, DIM))):
        assert between(same, same) == 0
        assert between(same, same[::-1]) == pytest.approx(0, abs=1e-12 * float(np.square(same).sum(axis=1).max()))


@pytest.mark.parametrize("shift", [0.0, 0.3, 40.0])
@pytest.mark.parametrize("scale", [1.0, 1.001, 2.5, 1e-3])
def test_closed_form_of_shifted_and_scaled_gaussians(shift, scale):
    """N(m, S) and N(m + shift, scale^2 S) are at d shift^2 + (scale - 1)^2 tr S."""
    covariance, mean = random_covariance(1), np.arange(DIM) - 2.0
    expected = DIM * shift**2 + (scale - 1) ** 2 * np.trace(covariance)
    samples = [exact_sample(40, covariance, mean), exact_sample(70, scale**2 * covariance, mean + shift, seed=1)]
    assert between(*samples) == pytest.approx(expected, rel=1e-6, abs=1e-12)
    given = frechet.Moments(11, mean, 10 * covariance), frechet.Moments(5, mean + shift, 4 * scale**2 * covariance)
    assert frechet.distance(*given) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_agrees_with_scipy_on_covariances_that_do_not_commute():
    """Protects the cross term, which the closed forms above see only between proportional covariances."""
    a = exact_sample(60, random_covariance(2), np.zeros(DIM))
    b = exact_sample(50, random_covariance(3), np.ones(DIM), seed=1)
    assert between(a, b) == pytest.approx(by_schur(a, b), rel=1e-9)
    assert between(b, a) == pytest.approx(between(a, b), rel=1e-12)


def test_singular_sets_lose_no_accuracy():
    """Fewer samples than dimensions, constant, doubled and padded latents: the values known without them."""
    rng = np.random.default_rng(4)
    few = rng.normal(size=(5, 32))
    assert between(few, 3 * few + 1) == pytest.approx(
        np.square(2 * few.mean(axis=0) + 1).sum() + 4 * np.trace(np.cov(few, rowvar=False)), rel=1e-9
    )
    a, b = rng.normal(size=(90, 4)), 1.5 * rng.normal(size=(80, 4)) + 1
    full = between(a, b)
    assert between(np.tile(a, 2), np.tile(b, 2)) == pytest.approx(2 * full, rel=1e-9)
    assert between(np.pad(a, ((0, 0), (0, 3))), np.pad(b, ((0, 0), (0, 3)))) == pytest.approx(full, rel=1e-9)
    assert between(np.full((7, 4), 2.0), np.full((9, 4), 5.0)) == pytest.approx(36)
    assert between(np.zeros((7, 4)), a - a.mean(axis=0)) == pytest.approx(np.trace(np.cov(a, rowvar=False)), rel=1e-9)


@pytest.mark.parametrize("scale", [1e-100, 1e-6, 1e6, 1e100])
def test_units_of_the_latents_do_not_matter(scale):
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(40, DIM)), rng.normal(size=(30, DIM)) @ random_covariance(6)
    assert between(a * scale, b * scale) / scale**2 == pytest.approx(between(a, b), rel=1e-9)


def test_single_precision_latents_are_scored_in_double():
    rows = (np.random.default_rng(10).normal(size=(50, DIM)) + 1000).astype(np.float32)
    other = rows[::-1] + np.float32(0.5)
    assert between(rows, other) == pytest.approx(between(rows.astype(np.float64), other.astype(np.float64)), rel=1e-12)
    assert frechet.moments(rows).scatter.dtype == np.float64


def test_what_cannot_be_scored():
    rows = np.ones((5, DIM))
    assert np.isnan(between(rows, rows[:1])) and np.isnan(between(rows[:0], rows))
    with pytest.raises(UserError, match="6 and 4 numbers"):
        between(rows, rows[:, :4])
    rows[2, 1] = np.nan
    with pytest.raises(UserError, match="1 of 5 latents"):
        frechet.moments(rows)


def test_floor_compares_halves_of_disjoint_sources():
    """Protects the split by source: with every source at its own place, a split by window would be near zero."""
    sources = np.repeat([f"talk {i}" for i in range(8)], 25)
    rng = np.random.default_rng(11)
    latents = rng.normal(size=(200, 3)) + np.repeat(rng.normal(size=(8, 3)) * 20, 25, axis=0)
    floors = frechet.half_split_floor(latents, sources, num_draws=6, seed=1)
    assert floors.shape == (6,) and len(np.unique(floors)) > 1
    shuffled = frechet.half_split_floor(latents, np.arange(200), num_draws=6)
    assert floors.min() > 5 * shuffled.max()
    np.testing.assert_array_equal(floors, frechet.half_split_floor(latents, sources, num_draws=6, seed=1))
    pair = frechet.half_split_floor(latents[:50], sources[:50], num_draws=2)
    np.testing.assert_allclose(pair, between(latents[:25], latents[25:50]))
    assert np.isnan(frechet.half_split_floor(latents[:25], sources[:25])).all()


def test_floor_deals_about_half_of_the_latents():
    """One long recording is a half of its own beside three short ones."""
    latents = np.random.default_rng(12).normal(size=(64, 2))
    sources = np.repeat([0, 1, 2, 3], [30, 11, 11, 12])
    floors = frechet.half_split_floor(latents, sources, num_draws=20)
    assert np.isclose(floors, between(latents[:30], latents[30:])).sum() >= 5


def test_extrapolation_removes_the_bias_of_small_sets():
    """Two samples of one Gaussian: the distance is all bias, the intercept is near the true 0; and a true 1 is kept."""
    rng = np.random.default_rng(13)
    a, b = rng.normal(size=(600, 12)), rng.normal(size=(500, 12))
    biased = between(a, b)
    assert biased > 0.1
    assert abs(frechet.extrapolate(a, b)) < biased / 5
    b[:, 0] += 1
    assert frechet.extrapolate(a, b) == pytest.approx(1, abs=0.15)
    assert frechet.extrapolate(a, b, seed=3) == frechet.extrapolate(a, b, seed=3)
    assert frechet.extrapolate(a, a) == 0
    assert np.isnan(frechet.extrapolate(a[:3], b))


def test_several_motions_for_each_speech_are_extrapolated_as_one_is():
    """Copies of the truth are at no distance from it, and five takes of a system as far as each of them."""
    rng = np.random.default_rng(14)
    real = rng.normal(size=(400, 12))
    inputs = np.repeat(np.arange(400), 5)
    assert frechet.extrapolate(real[inputs], real, inputs=inputs) == 0
    takes = real[inputs] + rng.normal(0, 0.3, (2000, 12))
    ones = [frechet.extrapolate(takes[first::5], real) for first in range(5)]
    assert frechet.extrapolate(takes, real, inputs=inputs) == pytest.approx(float(np.mean(ones)), rel=0.2)


# The release's rules, on stored cases.


def legacy_sets() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(12)
    return rng.normal(size=(40, 5)).astype(np.float32), (rng.normal(size=(30, 5)) * 1.5 + 0.25).astype(np.float32)


def legacy_by_hand(a: np.ndarray, b: np.ndarray) -> float:
    """Rules 4 to 6 of the legacy definition, for two sets whose root is finite and nearly real."""
    means = [np.mean(rows, axis=0, dtype=np.float32) for rows in (a, b)]
    centred = [rows.astype(np.float64) - rows.astype(np.float64).mean(axis=0) for rows in (a, b)]
    first, second = (rows.T @ rows / (len(rows) - 1) for rows in centred)
    # tr sqrt(S1 S2) is the sum of the roots of the eigenvalues of S1 S2.
    roots = np.sqrt(np.linalg.eigvals(first @ second).astype(complex))
    return float(np.sum((means[0] - means[1]) ** 2) + np.trace(first) + np.trace(second) - 2 * roots.real.sum())


def test_legacy_keeps_its_stored_values():
    a, b = legacy_sets()
    assert a[0, 0] == pytest.approx(-0.006826, abs=1e-6)  # the stored values belong to these numbers
    assert legacy.legacy_distance(a, b) == pytest.approx(3.3858528092591467, rel=1e-6)
    assert legacy.legacy_distance(a[:4], b[:3]) == pytest.approx(12.52902372991979, rel=1e-6)  # singular
    assert legacy.legacy_distance(a, a) == pytest.approx(0, abs=1e-6)
    assert legacy.legacy_feature_distance(a[:30], b) == pytest.approx(7.462844961322844, rel=1e-6)
    assert legacy_by_hand(a, b) == pytest.approx(3.3858528092591467, rel=1e-6)
    assert legacy_by_hand(a[:4], b[:3]) == pytest.approx(12.52902372991979, rel=1e-6)


def test_legacy_takes_its_means_in_single_precision():
    """Far from the origin float32 means are coarse: the default is not moved by that, the legacy value is."""
    a, b = (rows + np.float32(1e4) for rows in legacy_sets())
    assert legacy.legacy_distance(a, b) == pytest.approx(legacy_by_hand(a, b), rel=1e-9)
    assert abs(legacy.legacy_distance(a, b) - between(a, b)) > 1e-5


def test_legacy_tries_again_with_wider_diagonals(monkeypatch, caplog):
    """A root that is not finite is taken again of (S1 + 1e-6)(S2 + 1e-6), with a warning; the other terms stay."""
    a, b = legacy_sets()
    products = []
    true_root = legacy._schur_root

    def first_fails(product):
        products.append(product)
        return np.full_like(product, np.inf) if len(products) == 1 else true_root(product)

    monkeypatch.setattr(legacy, "_schur_root", first_fails)
    value = legacy.legacy_distance(a, b)
    first, second = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    offset = 1e-6 * np.eye(5)
    np.testing.assert_allclose(products[0], first @ second, rtol=1e-12)
    np.testing.assert_allclose(products[1], (first + offset) @ (second + offset), rtol=1e-12)
    assert "1e-6" in caplog.text
    change = 2 * np.trace(true_root(products[1]) - true_root(products[0]))
    assert value == pytest.approx(3.3858528092591467 - change, rel=1e-7) and change > 1e-7


@pytest.mark.parametrize(("imaginary", "fails"), [(0.9e-3, False), (1.1e-3, True), (-1.1e-3, True), (np.nan, True)])
def test_legacy_bears_a_little_imaginary_part(monkeypatch, imaginary, fails):
    """The limit is 1e-3 on the diagonal; what lies off the diagonal is not looked at."""
    root = 2 * np.eye(5) + 1j * (np.diag([imaginary, 0, 0, 0, 0]) + 7 * np.eye(5, k=1))
    monkeypatch.setattr(legacy, "_schur_root", lambda product: root)
    a, b = legacy_sets()
    means = np.square(a.mean(axis=0) - b.mean(axis=0)).sum()
    traces = np.trace(np.cov(a, rowvar=False)) + np.trace(np.cov(b, rowvar=False))
    expected = 1e10 if fails else means + traces - 2 * 10
    assert legacy.legacy_distance(a, b) == pytest.approx(expected, rel=1e-6)


def test_legacy_root_is_the_general_one():
    """Real, complex and singular products against scipy; a matrix without a root has none."""
    rng = np.random.default_rng(14)
    for matrix in (random_covariance(15) @ random_covariance(16), rng.normal(size=(7, 7)), np.array([[4.0]])):
        root = legacy._schur_root(matrix)
        np.testing.assert_allclose(root, linalg.sqrtm(matrix), rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(root @ root, matrix, atol=1e-9)
    np.testing.assert_array_equal(legacy._schur_root(np.zeros((3, 3))), np.zeros((3, 3)))
    a, b = random_covariance(17), random_covariance(18)
    a[0], a[:, 0], b[1], b[:, 1] = 0, 0, 0, 0  # two eigenvalues that are 0 exactly
    np.testing.assert_allclose(legacy._schur_root(a @ b) @ legacy._schur_root(a @ b), a @ b, atol=1e-9)
    assert np.isnan(legacy._schur_root(np.array([[0.0, 1.0], [0.0, 0.0]]))).all()


def test_legacy_fails_with_its_number():
    a, b = legacy_sets()
    assert legacy.legacy_distance(a, np.full_like(b, np.nan)) == 1e10
    assert legacy.legacy_distance(a, b[:1]) == 1e10
    constant = np.ones((10, 5), np.float32)  # nothing fails here: the root of 0 is 0
    expected = np.square(a.mean(axis=0) - 1).sum() + np.trace(np.cov(a, rowvar=False))
    assert legacy.legacy_distance(a, constant) == pytest.approx(expected, rel=1e-6)

"""Accelerations, speeds, spread and angles beyond limits of motions whose values are known by hand."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ha2g_jax.metrics import kinematics, reconstruction
from ha2g_jax.skeleton import directions_to_positions, joint_angles, load_skeleton, normalize

FPS = 15
RNG = np.random.default_rng(0)


def fall(fps: float, frames: int = 40) -> np.ndarray:
    """(T, 2, 3): joint 0 stands, joint 1 falls with 9.81 m/s^2."""
    positions = np.zeros((frames, 2, 3))
    positions[:, 1, 1] = 9.81 / 2 * np.square(np.arange(frames) / fps)
    return positions


def walks(count: int, frames: int = 34, joints: int = 3, scale: float = 0.02) -> list[np.ndarray]:
    return [np.cumsum(RNG.normal(0, scale, (frames, joints, 3)), axis=0) for _ in range(count)]


def hellinger(clips, reference, fps, *, bins: int | np.ndarray = kinematics.NUM_BINS) -> float:
    """Distance of two sets of clips, with edges at quantiles of the reference or given ones."""
    edges = kinematics.speed_edges(reference, fps, bins=bins) if isinstance(bins, int) else bins
    sides = [
        np.sum([kinematics.speed_counts(clip, edges, fps) for clip in side], axis=0) for side in (clips, reference)
    ]
    return kinematics.histogram_distance(*sides)


def cca(generated, real, recordings=None, **options) -> float:
    """Correlation of all projected frames, as the table has it."""
    pairs = reconstruction.canonical_pairs(generated, real, recordings, **options)
    together = np.concatenate([np.zeros((0, 2)), *pairs.values()])
    x, y = (together - together.mean(axis=0)).T if len(together) else np.zeros((2, 0))
    sums = np.array([len(x), x.sum(), y.sum(), x @ x, y @ y, x @ y])
    return reconstruction.correlation_of_sums(sums)


@pytest.mark.parametrize("fps", [15, 30, 60])
def test_a_fall_has_the_acceleration_of_gravity_at_any_rate(fps):
    assert kinematics.acceleration(fall(fps), fps) == pytest.approx(9.81 / 2)  # the mean with the joint that stands
    assert kinematics.jerk(fall(fps), fps) == pytest.approx(0, abs=1e-7)


def test_a_cubic_has_constant_jerk():
    positions = np.zeros((30, 1, 3))
    positions[:, 0, 0] = (np.arange(30) / FPS) ** 3
    assert kinematics.jerk(positions, FPS) == pytest.approx(6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_turning_and_moving_the_body_change_nothing(seed):
    rng = np.random.default_rng(seed)
    positions = np.cumsum(rng.normal(0, 0.02, (30, 5, 3)), axis=0)
    moved = positions @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T + rng.normal(size=3)
    for metric in (kinematics.acceleration, kinematics.jerk):
        assert metric(moved, FPS) == pytest.approx(metric(positions, FPS))
    bins = np.linspace(0.1, 2, 10)  # edges at quantiles lie on speeds, which are turned with a rounding error
    assert hellinger([moved], [positions], FPS, bins=bins) == pytest.approx(0, abs=1e-6)
    shifted = positions + rng.normal(size=3)
    assert kinematics.l1_diversity(shifted) == pytest.approx(kinematics.l1_diversity(positions))


def test_spread_by_hand():
    values = np.zeros((4, 2, 1))
    values[:, 0, 0], values[:, 1, 0] = [0, 2, 0, 2], [0, 0, 0, 4]
    # Means 1 and 1; |x - mean| sums to 4 and to 3 + 3 over the frames.
    assert kinematics.l1_diversity(values) == pytest.approx((4 + 6) / 4)


def test_hellinger_distance_by_hand_with_fixed_bins():
    def moving(speeds):
        return np.concatenate([[0], np.cumsum(speeds)])[:, None, None] / FPS * np.array([[[0, 1, 0]]])

    # Bins up to 1, up to 2, beyond: (2, 1, 1) / 4 against (1, 1, 2) / 4.
    first, second = moving([0.5, 0.5, 1.5, 900]), moving([0.5, 1.5, 2.5, 3.5])
    expected = np.sqrt(1 - (2 * np.sqrt(2) + 1) / 4)
    assert hellinger([first], [second], FPS, bins=np.array([1.0, 2.0])) == pytest.approx(expected)


def test_bins_at_quantiles_hold_equally_many_real_speeds_and_an_unreached_overflow():
    real = walks(20)
    edges = kinematics.speed_edges(real, FPS, bins=10)
    counts = np.sum([kinematics.speed_counts(clip, edges, FPS) for clip in real], axis=0)
    assert counts.sum() == 20 * 33 * 3
    np.testing.assert_array_equal(counts[:, 1:-1], 66)
    assert not counts[:, [0, -1]].any()


def test_the_rounding_of_a_format_is_no_distance():
    skeleton, rng, time = load_skeleton("ted_expressive"), np.random.default_rng(0), np.arange(150)[:, None, None] / FPS
    real, other = [], []
    for _ in range(12):
        sways = rng.normal(0, 0.2, (3, 1, skeleton.num_bones, 3))
        waves = sum(sway * np.sin(rate * time + rng.uniform(0, 6)) for sway, rate in zip(sways, (1, 3, 7), strict=True))
        motion = normalize(skeleton.mean_directions + waves)
        real.append(directions_to_positions(skeleton, motion))
        other.append(directions_to_positions(skeleton, motion + rng.uniform(-1e-6, 1e-6, motion.shape)))
    assert hellinger(other, real, FPS) < 0.005


def test_hellinger_distance_orders_motions_and_is_free_of_scale():
    real, alike, faster = walks(20), walks(20), walks(20, scale=0.04)
    near, far = (hellinger(clips, real, FPS) for clips in (alike, faster))
    assert hellinger(real, real, FPS) == pytest.approx(0, abs=1e-7)
    assert near < 0.2 < far < 1
    bigger, reference = ([100 * clip for clip in clips] for clips in (faster, real))
    assert hellinger(bigger, reference, FPS) == pytest.approx(far)
    still = [np.ones((34, 3, 3))]
    assert hellinger(still, real, FPS) == pytest.approx(np.sqrt(1 - np.sqrt(1 / 50)), abs=3e-3)
    assert hellinger([np.arange(34.0)[:, None, None] * np.ones((1, 3, 3))], real, FPS) == 1


def test_a_joint_that_never_moves_does_not_dilute_the_distance():
    real, other = walks(5), walks(5, scale=0.04)
    with_root, reference = ([np.pad(clip, ((0, 0), (1, 0), (0, 0))) for clip in clips] for clips in (other, real))
    expected = hellinger(other, real, FPS)
    assert hellinger(with_root, reference, FPS) == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(3))
def test_canonical_correlation_is_scikit_learns(seed):
    from sklearn.cross_decomposition import CCA

    rng = np.random.default_rng(seed)
    shared = rng.normal(size=(400, 1))
    x = np.concatenate([shared + rng.normal(size=(400, 2)), rng.normal(size=(400, 4))], axis=1)
    y = np.concatenate([shared + 0.5 * rng.normal(size=(400, 1)), rng.normal(size=(400, 2))], axis=1)
    projections = CCA(n_components=1, tol=1e-9, max_iter=5000).fit(x, y).transform(x, y)
    expected = np.corrcoef(projections[0][:, 0], projections[1][:, 0])[0, 1]
    assert cca([x], [y], shrinkage=0) == pytest.approx(expected, abs=1e-6)


def test_canonical_correlation_survives_constant_and_repeated_dimensions():
    x, y = RNG.normal(size=(300, 4)), RNG.normal(size=(300, 4))
    plain = cca([x], [y], shrinkage=0)
    awkward = [np.concatenate([side, np.ones((300, 2)), side[:, :1]], axis=1) for side in (x, y)]
    assert cca([awkward[0]], [awkward[1]], shrinkage=0) == pytest.approx(plain)
    assert cca([np.ones((300, 4))], [y]) == 0


def test_held_out_sources_show_no_relation_where_there_is_none():
    sources = [f"s{i // 2}" for i in range(12)]
    real, other = walks(12, joints=10), walks(12, joints=10)
    assert cca(other, real) > 0.9  # thirty drifting dimensions fit whatever they are given
    assert abs(cca(other, real, sources)) < 0.5
    linear = [clip @ Rotation.from_rotvec([1.0, 2.0, 3.0]).as_matrix() * 3 + 1 for clip in real]
    assert cca(linear, real, sources) == pytest.approx(1, abs=1e-3)


def test_a_source_is_fitted_or_scored_but_not_both():
    sources, real = ["a", "b", "a", "b"], walks(4)
    generated = [clip + RNG.normal(0, 0.1, clip.shape) for clip in real]
    pairs = reconstruction.canonical_pairs(generated, real, sources)
    effects = []
    for changed in range(4):
        clips = [RNG.normal(size=clip.shape) if i == changed else clip for i, clip in enumerate(generated)]
        others = reconstruction.canonical_pairs(clips, real, sources)
        effects.append([not np.array_equal(x, y) for x, y in zip(others.values(), pairs.values(), strict=True)])
    # A clip that was fitted changes both scored ones; a scored one only itself.
    assert sorted(effects) == [[False, True], [True, False], [True, True], [True, True]]
    assert effects[0] != effects[1]


def test_too_little_is_undefined_and_warns_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        short = np.ones((0, 2, 3))
        for value in (
            kinematics.acceleration(short, FPS),
            kinematics.jerk(short, FPS),
            kinematics.l1_diversity(short),
            hellinger([short], walks(1, joints=2), FPS),
            hellinger(walks(1, joints=2), [short], FPS),
            cca([short], [short]),
            cca([short, short], [short, short], ["a", "b"]),
        ):
            assert np.isnan(value)
        real = walks(2)
        assert np.isnan(cca(real, real, ["a", "a"]))


def test_arrays_of_another_shape_are_refused():
    flat = np.zeros((40, 15))
    edges = np.ones((5, 10))
    for measure in (
        lambda: kinematics.acceleration(flat, FPS),
        lambda: kinematics.jerk(flat, FPS),
        lambda: kinematics.speed_edges([flat], FPS),
        lambda: kinematics.speed_counts(flat, edges, FPS),
        lambda: kinematics.speed_counts(np.zeros((2, 40, 5, 3)), edges, FPS),
    ):
        with pytest.raises(ValueError, match=r"of the shape .*; expected \(T, joints, 3\)"):
            measure()
    with pytest.raises(ValueError, match=r"shapes \(5, 12\) and \(1, 12\)"):
        kinematics.histogram_distance(np.ones((5, 12)), np.ones((1, 12)))


def test_values_that_are_not_numbers_have_no_score():
    broken, real = walks(2)
    broken[10, 1, 2] = np.nan
    angles = np.tile([0.5, 2.0], (10, 1))
    angles[3, 0] = np.nan
    scores = [
        kinematics.acceleration(broken, FPS),
        kinematics.jerk(broken, FPS),
        kinematics.l1_diversity(broken),
        hellinger([broken], [real], FPS),
        hellinger([np.full_like(real, np.nan)], [np.zeros_like(real)], FPS),
        hellinger([real], [broken], FPS),
        *violations(angles),
        *[function(broken, real) for function in (reconstruction.joint_mae, reconstruction.pck)],
    ]
    assert np.isnan(scores).all()


def test_motion_that_stands_still_has_zeros():
    still = np.full((34, 3, 3), 0.1, np.float32)
    assert kinematics.acceleration(still, FPS) == kinematics.jerk(still, FPS) == kinematics.l1_diversity(still) == 0
    assert hellinger([still], [still], FPS) == 0
    assert cca([still], [still]) == 0


ANGLES_RNG = np.random.default_rng(0)
TRAINING = np.stack([np.linspace(0, 1, 1001), np.linspace(1, 3, 1001)], axis=1)
LIMITS = kinematics.training_limits(TRAINING)


def violations(angles, limits=LIMITS) -> kinematics.Violations:
    return kinematics.violations(kinematics.violation_counts(angles, limits))


def test_violations_by_hand():
    np.testing.assert_allclose(LIMITS, [[0.001, 1.002], [0.999, 2.998]])
    angles = np.tile([0.5, 2.0], (10, 1))
    angles[1, 0], angles[2, 0], angles[2, 1], angles[3, 1] = -0.1, 1.2, 3.05, 9
    angles[4] = [0.001, 2.998]  # on the limits
    assert violations(angles) == pytest.approx((0.2, 0.2, 0.3))


def test_few_of_the_training_frames_violate_their_own_limits():
    found = violations(ANGLES_RNG.permutation(TRAINING))
    assert found.mean == pytest.approx(0.002, abs=1e-4)


def test_counts_of_clips_add_up():
    clips = [ANGLES_RNG.normal(1, 1, (frames, 2)) for frames in (9, 20, 3, 30)]
    counts = np.stack([kinematics.violation_counts(clip, LIMITS) for clip in clips])
    found = kinematics.violations(counts.sum(axis=0))
    assert found == violations(np.concatenate(clips))
    assert 0 < found.mean < found.any < 1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_turning_the_body_changes_nothing(seed):
    skeleton, rng = load_skeleton("ted_expressive"), np.random.default_rng(seed)
    directions = normalize(skeleton.mean_directions + rng.normal(0, 0.3, (30, skeleton.num_bones, 3)))
    limits = kinematics.training_limits(joint_angles(skeleton, directions[:20]))
    turned = directions @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T
    expected = violations(joint_angles(skeleton, directions), limits)
    assert expected.any > 0
    found = violations(joint_angles(skeleton, turned), limits)
    assert found == pytest.approx(expected)


def test_undefined_without_frames():
    found = violations(np.zeros((0, 2)))
    assert np.isnan([found.mean, found.worst, found.any]).all()

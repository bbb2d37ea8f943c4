"""What tells two motions apart is found, and nothing where there is nothing; hands and head of motion known by hand."""

import math

import numpy as np
import pytest

from ha2g_jax.evaluation.motion_folders import read_directions
from ha2g_jax.metrics import giveaway, hands
from ha2g_jax.metrics.giveaway import Windows, area_under_curve, discriminant, told_apart
from ha2g_jax.metrics.hands import UpperBody
from ha2g_jax.skeleton import directions_to_positions, load_skeleton

FPS = 15.0
SIZE = len(giveaway.feature_names())


def swinging(seconds: float, sizes: tuple[float, float], period: float = 2.0, seed: int = 0) -> UpperBody:
    """Wrists that swing to the side by sizes in metres around 0.3 m from the middle, with noise of 1 mm."""
    time = np.arange(round(seconds * FPS)) / FPS
    wrists = np.random.default_rng(seed).normal(0, 1e-3, (len(time), 2, 3))
    wrists[..., 0] += (0.3, -0.3) + np.sin(2 * np.pi * time / period)[:, None] * sizes
    shoulders = np.broadcast_to([[0.2, -0.3, 0], [-0.2, -0.3, 0]], wrists.shape)
    ahead = np.broadcast_to([0.0, -1.0, -1.0], (len(time), 3))
    return UpperBody(wrists, shoulders, ahead, ahead, FPS)


def area(person: Windows, system: Windows, group: str = giveaway.ALL) -> float:
    found = told_apart(person, system, group)
    assert found is not None
    return found.value


def drawn(mean: float, seed: int, recordings: int = 8) -> Windows:
    """Ten windows of each recording, whose first feature has this mean and unit variance, the others the mean 0."""
    features = np.random.default_rng(seed).normal(size=(10 * recordings, SIZE))
    features[:, 0] += mean
    recording = np.repeat(np.arange(recordings), 10)
    return Windows(features, recording, recording, np.tile(np.arange(10) * 5.0, recordings))


def test_two_gaussians_have_the_area_of_their_distance():
    first, second = drawn(0, 1, 40), drawn(1, 2, 40)
    expected = (1 + math.erf(1 / 2)) / 2  # of one feature: Phi(1 / sqrt 2)
    assert area(first, second, "bimanual") == pytest.approx(expected, abs=0.05)
    nothing = told_apart(first, second, "extent")
    assert nothing is not None and abs(nothing.value - 0.5) < 3 * nothing.error < 0.3


def test_a_single_recording_is_divided_by_time_and_leaks_nothing():
    # Features that drift over the recording tell moments apart, and nothing about who moves.
    drift = np.repeat(np.random.default_rng(0).normal(size=(8, SIZE)), 5, axis=0)
    noise = np.random.default_rng(1).normal(0, 0.1, (2, *drift.shape))
    none, starts = np.zeros(40, int), np.arange(40) * 2.5
    person, system = (Windows(drift + side, none, none, starts) for side in noise)
    assert abs(area(person, system) - 0.5) < 0.2
    assert area(person, system._replace(features=system.features + 1)) > 0.95
    few = Windows(drift[:1], none[:1], none[:1], starts[:1])
    assert told_apart(few, few) is None


def test_the_area_counts_pairs():
    assert area_under_curve(np.array([0.0, 1.0]), np.array([1.0, 2.0])) == pytest.approx(3.5 / 4)


@pytest.mark.parametrize("count", [4, 400])
def test_the_discriminant_survives_more_features_than_samples(count):
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, count, 30))
    second[:, 0] += 20
    weights = discriminant(first, second)
    assert np.isfinite(weights).all() and np.argmax(np.abs(weights)) == 0


def test_groups_see_what_they_are_named_for():
    def windows(sizes: tuple[float, float], period: float) -> Windows:
        return giveaway.windows_of([swinging(30, sizes, period, seed) for seed in range(4)], np.arange(4), np.arange(4))

    person = windows((0.1, -0.1), 2)
    assert area(person, windows((0.1, -0.1), 1), "rhythm") == 1
    assert area(person, windows((0.1, -0.1), 1), "place") < 0.9
    assert area(person, windows((0.1, 0.0), 2), "bimanual") == 1


def test_a_head_without_length_for_some_frames_has_no_turns_there():
    body = swinging(30, (0.1, -0.1))
    head = np.where(np.arange(len(body.head))[:, None] // 10 == 1, 0, body.head)
    body = body._replace(head=head)
    assert np.isfinite(giveaway.windows_of([body], np.zeros(1), np.zeros(1)).features).all()


def test_hands_by_hand():
    body = swinging(60, (0.2, -0.2))
    assert hands.lateral_spread(body) == pytest.approx(100 * 0.2 / np.sqrt(2), rel=0.02)
    assert hands.slower_wrist(body) == pytest.approx(4 * 0.2 / 2, rel=0.03)  # four times the size in each period
    assert hands.hand_distances(body).mean() == pytest.approx(60, rel=0.02)
    assert hands.nearest_segment(body) < 1  # the next period is alike
    assert hands.both_moving(body) > 0.7 and hands.one_moving(body) < 0.1
    one = swinging(60, (0.2, 0.0))
    assert hands.both_moving(one) < 0.05 and hands.one_moving(one) > 0.7
    assert math.isnan(hands.nearest_segment(body.cut(0, 45)))


def test_the_head_deviates_by_its_turns_alike_in_both_skeletons():
    angles = np.radians(10) * np.sin(np.linspace(0, 20 * np.pi, 1000))
    turned = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], axis=-1)
    assert hands.spread_of_directions(turned) == pytest.approx(10 / np.sqrt(2), rel=0.01)
    for name in ("ted_expressive", "ted_gesture"):
        skeleton = load_skeleton(name)
        body = hands.upper_body(skeleton, skeleton.mean_pose[None], FPS)
        assert (
            body.wrists[0, 0, 0] > 0 > body.wrists[0, 1, 0] and (body.wrists[0, :, 2] < body.shoulders[0, :, 2]).all()
        )


def test_a_person_of_a_recording_has_the_values_of_the_page(private_data):
    motion = read_directions(private_data / "zeroeggs_067" / "067_Speech_2_x_1_0.mixamo.bvh", "ted_expressive")
    skeleton = load_skeleton("ted_expressive")
    body = hands.upper_body(skeleton, directions_to_positions(skeleton, motion.directions), FPS)
    assert hands.slower_wrist(body) == pytest.approx(0.61, abs=0.01)
    assert hands.both_moving(body) == pytest.approx(0.70, abs=0.01)
    assert hands.lateral_spread(body) == pytest.approx(17.3, abs=0.1)
    assert hands.hand_distances(body).mean() == pytest.approx(82, abs=0.5)
    assert hands.nearest_segment(body) == pytest.approx(25.5, abs=0.5)

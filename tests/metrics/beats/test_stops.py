"""The angle change rate is that of the paper at any frame rate; BC by hand, and how jitter wins it."""

import numpy as np
import pytest

from ha2g_jax.metrics.beats import stops
from ha2g_jax.metrics.beats.stops import beat_consistency, consistency, low_samples
from ha2g_jax.skeleton import load_skeleton, normalize


def motions(name: str, lengths: list[int]) -> list[np.ndarray]:
    skeleton, rng = load_skeleton(name), np.random.default_rng(1)
    shape = (skeleton.num_bones, 3)
    return [normalize(skeleton.mean_directions[None] + 0.2 * rng.normal(size=(n, *shape))) for n in lengths]


def plain_angles(skeleton, motion: np.ndarray) -> np.ndarray:
    """(T, pairs) over pi, pair by pair."""
    normals = [np.cross(motion[:, first], motion[:, second]) for first, second in skeleton.palms]
    vectors = [*np.moveaxis(motion, 1, 0), *normals]
    units = [vector / np.linalg.norm(vector, axis=-1, keepdims=True) for vector in vectors]
    pairs = [np.sum(units[first] * units[second], axis=-1) for first, second in skeleton.angle_pairs]
    return np.arccos(np.clip(np.stack(pairs, axis=1), -1, 1)) / np.pi


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
def test_mean_change_and_rate_follow_their_equations(name):
    skeleton = load_skeleton(name)
    clips = motions(name, [5, 34, 1, 900, 2, 34])
    changes = [np.abs(np.diff(plain_angles(skeleton, clip), axis=0)) for clip in clips]
    change = stops.mean_angle_change(skeleton, clips)
    np.testing.assert_allclose(change, np.concatenate(changes).mean(axis=0), rtol=1e-9)
    rates = stops.angle_change_rates(skeleton, clips, change)
    assert [len(rate) for rate in rates] == [4, 33, 0, 899, 1, 33]
    longer = stops.angle_change_rates(skeleton, [3 * clip for clip in clips], change)
    for rate, other, true in zip(rates, longer, changes, strict=True):
        np.testing.assert_allclose(rate, (true / change[None]).mean(axis=1), rtol=1e-9)
        np.testing.assert_allclose(rate, other, rtol=1e-9)
    assert np.concatenate(rates).mean() == pytest.approx(1)


def test_the_rate_is_in_units_of_the_change_at_the_frame_rate_of_the_motion():
    skeleton = load_skeleton("ted_expressive")
    rng = np.random.default_rng(0)
    phases, sizes = rng.uniform(0, 6, (2, skeleton.num_bones, 3))

    def motion(fps):
        time = np.arange(round(6 * fps))[:, None, None] / fps
        return normalize(skeleton.mean_directions[None] + 0.03 * sizes[None] * np.sin(2 * time + phases[None]))

    own = [stops.mean_angle_change(skeleton, [motion(fps)]) for fps in (15, 60)]
    np.testing.assert_allclose(own[0] / own[1], 4, rtol=0.05)
    (fast,) = stops.angle_change_rates(skeleton, [motion(60)], own[1])
    assert fast.mean() == pytest.approx(1)


def test_a_rigid_pair_is_left_out():
    skeleton = load_skeleton("ted_gesture")
    (clip,) = motions("ted_gesture", [30])
    change = np.array([0.01, 0.0, 1e-9, 0.02])
    changes = np.abs(np.diff(plain_angles(skeleton, clip), axis=0))
    expected = (changes[:, 0] / 0.01 + changes[:, 3] / 0.02) / 2
    np.testing.assert_allclose(stops.angle_change_rates(skeleton, [clip], change), [expected], rtol=1e-9)
    assert not stops.angle_change_rates(skeleton, [clip], np.zeros(4))[0].any()


def test_angles_are_exact_at_parallel_bones():
    skeleton = load_skeleton("ted_gesture")
    angles = np.array([0.0, 1e-4, 3e-4])
    clip = np.zeros((3, skeleton.num_bones, 3))
    clip[..., 0] = 1
    clip[:, 4, :2] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    change = stops.mean_angle_change(skeleton, [clip])
    np.testing.assert_allclose(change, np.array([1.5e-4, 1.5e-4, 0, 0]) / np.pi, rtol=1e-4)


FPS = 10


def test_the_examples_of_supplement_e():
    """A rate of 0.2, 0.1, 0.2 is a beat; 0.11, 0.1, 0.11, 0.1, 0.11 has none that exceeds the threshold."""
    assert low_samples(np.array([0.2, 0.1, 0.2]), 0.03).tolist() == [1]
    assert low_samples(np.array([0.11, 0.1, 0.11, 0.1, 0.11]), 0.03).tolist() == []
    assert low_samples(np.array([0.11, 0.1, 0.2]), 0.03).tolist() == [1], "a rise on one side is enough"
    assert low_samples(np.array([0.5, 0.9, 0.9, 1, 0.98, 0.99, 1]), 0.015).tolist() == [4], "no strict minimum, no rise"
    assert low_samples(np.array([0.3, 0.1]), 0.03).tolist() == low_samples(np.zeros(0), 0.03).tolist() == []


def test_bc_is_the_mean_of_the_kernel_over_all_onsets():
    rate = np.ones(30)
    rate[[10, 20]] = 0.5  # stops between frames 10 and 11, and 20 and 21
    onsets = [np.array([1.05, 1.95, 2.75]), np.array([0.8]), np.zeros(0)]
    found = consistency([rate, np.ones(30), rate], onsets, FPS)
    distances = np.array([0, 0.1, 0.7, np.inf])  # the second clip has no beat, the third no onset
    assert beat_consistency(found) == pytest.approx(np.exp(-(distances**2) / (2 * 0.1**2)).mean())
    assert np.isnan(beat_consistency(consistency([rate], [np.zeros(0)], FPS)))

"""Frames between those of the model do not depend on how they arrived, and come as soon as they can."""

import numpy as np
import pytest
from apps.live.standins import FPS, poses

from ha2g_jax.apps.live.frames import Interpolation
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import normalize


def interpolated(frames, target, cuts=()):
    interpolation = Interpolation(FPS, target)
    parts = [interpolation.add(part) for part in np.split(frames, list(cuts))]
    return np.concatenate([*parts, interpolation.end()])


@pytest.mark.parametrize("target", [15, 24, 30, 60])
def test_each_frame_lies_between_its_two_neighbours_in_time(skeleton, target):
    frames = poses(skeleton, 20)
    found = interpolated(frames, target)
    assert found.dtype == np.float32 and len(found) == round(20 * target / FPS)
    for number, pose in enumerate(found):
        time = min(number * FPS / target, 19)
        before, after = frames[int(time)], frames[min(int(time) + 1, 19)]
        np.testing.assert_allclose(pose, normalize(before + (time % 1) * (after - before)), atol=1e-6)


@pytest.mark.parametrize("target", [24, 60])
def test_how_frames_arrive_does_not_matter(skeleton, target):
    frames = poses(skeleton, 20)
    for cuts in ([0, 1, 1, 5, 19], range(20)):
        np.testing.assert_array_equal(interpolated(frames, target, cuts), interpolated(frames, target))


@pytest.mark.parametrize("target", [15, 24, 30, 50, 60])
def test_no_frame_waits_longer_than_stated(skeleton, target):
    interpolation, number, waits = Interpolation(FPS, target), 0, []
    for taken, pose in enumerate(poses(skeleton, 40)):
        for _ in interpolation.add(pose[None]):
            waits.append(taken / FPS - number / target)
            number += 1
    assert min(waits) >= 0
    assert max(waits) == pytest.approx(interpolation.delay)


@pytest.mark.parametrize("target", [0, 14, 121])
def test_other_rates_are_refused(target):
    with pytest.raises(UserError, match="expected 15, the rate of the model, to 120"):
        Interpolation(FPS, target)

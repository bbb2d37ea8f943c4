"""Windows cover the frames with none to spare, and join without a step."""

import numpy as np
import pytest

from ha2g_jax.motion.windows import RunningJoin, ease_start, join_windows, num_windows, window_stride


@pytest.mark.parametrize("frames", range(1, 200, 7))
def test_windows_cover_the_frames_and_no_window_is_idle(frames):
    count = num_windows(frames, 34, 20)
    assert 34 + 20 * (count - 1) >= frames
    assert count == 1 or 34 + 20 * (count - 2) < frames


@pytest.mark.parametrize("window", [17, 34, 68])
def test_a_window_generates_again_the_last_third_of_the_one_before(window):
    assert window_stride(34, 4) == 20
    for overlap in range(1, window):
        stride = window_stride(window, overlap)
        assert 1 <= stride <= window - overlap and (window - overlap - stride) <= (window - overlap + 2) / 3


def circle(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None].astype(np.float32)


@pytest.mark.parametrize("stride", [1, 20, 26, 29, 30])
def test_joining_cuts_of_one_motion_gives_it_back(stride):
    motion = circle(np.linspace(0, 6, 34 + 2 * stride))
    windows = np.stack([motion[start : start + 34] for start in (0, stride, 2 * stride)])
    np.testing.assert_allclose(join_windows(windows, 4, stride), motion, atol=1e-6)


@pytest.mark.parametrize(("stride", "start"), [(20, 24), (30, 30)])
def test_the_fade_turns_in_fifths_and_stays_on_the_sphere(stride, start):
    """After the seed pose of the later window, or in it where the windows have nothing else in common."""
    windows = np.zeros((2, 34, 1, 3), np.float32)
    windows[0, ..., 0] = windows[1, ..., 1] = 1  # x, then y
    joined = join_windows(windows, 4, stride)
    assert joined.shape == (34 + stride, 1, 3)
    angles = np.degrees(np.arctan2(joined[:, 0, 1], joined[:, 0, 0]))
    np.testing.assert_allclose(angles[start - 2 : start + 6], [0, 0, 18, 36, 54, 72, 90, 90], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(joined, axis=-1), 1, atol=1e-6)


def test_easing_leaves_a_start_without_a_step_alone():
    motion = circle(np.linspace(0, 6, 94))
    np.testing.assert_allclose(ease_start(motion, 34, 4), motion, atol=1e-6)


def test_a_step_after_the_start_becomes_a_course_of_ten_frames():
    """The motion moves off by 0.3 rad in its first own frame, 4."""
    angle = 0.02 * np.arange(34)
    angle[4:] += 0.3
    eased = ease_start(circle(angle), 34, 4)
    kept = [*range(4), *range(14, 34)]
    np.testing.assert_array_equal(eased[kept], circle(angle)[kept])
    steps = np.diff(np.arctan2(eased[:20, 0, 1], eased[:20, 0, 0]))
    assert steps[3] == pytest.approx(0.02, abs=1e-5)  # it goes on as it went
    assert steps.min() > 0.019
    assert steps.max() < 0.02 + 1.875 * 0.3 / 10 + 1e-3  # minimum jerk over 10 frames
    assert np.abs(np.diff(steps)).max() < 0.02 + 1e-3


def test_easing_leaves_a_start_alone_that_is_like_the_frames_after_it():
    """A restless motion without a step there, beside one with a step far beyond its own jitter."""
    angle = np.random.default_rng(0).normal(0, 0.05, 34).cumsum()
    angle[3:6] = angle[2] + np.array([0.01, 0.03, 0.06])
    np.testing.assert_array_equal(ease_start(circle(angle), 34, 4), circle(angle))
    stepped = np.where(np.arange(34) < 4, angle, angle + 1.0)
    eased = ease_start(circle(stepped), 34, 4)
    step = np.arctan2(eased[4, 0, 1], eased[4, 0, 0]) - angle[3]
    assert 0.02 < abs(step) < 0.25


def test_one_given_frame_has_no_frame_before_it():
    angle = np.array([0.0, *(0.5 + 0.02 * np.arange(33))])
    eased = ease_start(circle(angle), 34, 1)
    assert np.arctan2(eased[1, 0, 1], eased[1, 0, 0]) == pytest.approx(0.01, abs=1e-5)


def test_short_windows_and_motions_are_eased():
    for frames, window, overlap in (
        (40, 8, 4),
        (40, 9, 4),
        (40, 10, 7),
        (40, 34, 1),
        (1, 34, 4),
        (5, 34, 4),
        (6, 34, 4),
    ):
        motion = circle(np.random.default_rng(0).normal(0, 0.1, frames).cumsum())
        eased = ease_start(motion, window, overlap)
        assert eased.shape == motion.shape
        np.testing.assert_allclose(np.linalg.norm(eased, axis=-1), 1, atol=1e-5)


def wandering(seed: int, windows: int = 4) -> np.ndarray:
    """Windows of 34 frames of 3 bones that move at random and do not agree."""
    steps = np.random.default_rng(seed).normal(0, 0.05, (windows, 34, 3, 3)).cumsum(axis=1) + 1
    return (steps / np.linalg.norm(steps, axis=-1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize(
    ("hop", "look_ahead", "fade"),
    [(1, 0, 2), (2, 0, 3), (3, 0, 4), (10, 0, 4), (26, 0, 4), (2, 4, 3), (1, 8, 6), (2, 8, 6), (2, 30, 6), (3, 8, 4)],
)
def test_a_shorter_hop_goes_over_from_what_was_expected(hop, look_ahead, fade):
    """Windows that stand still at an angle: the step is spread over frames, more of them where more is heard ahead."""
    join = RunningJoin(34, 4, hop, 4, look_ahead)
    angles = [0.0] + [0.5] * 12
    shown = np.concatenate([join.add(np.repeat(circle(np.array([angle])), 34, axis=0))[:hop] for angle in angles])
    found = np.arctan2(shown[:, 0, 1], shown[:, 0, 0])
    np.testing.assert_allclose(found[: hop + 1], [*[0] * hop, 0.5 / (fade + 1)], atol=1e-6)
    assert (np.diff(found) >= -1e-6).all() and abs(found[-1] - 0.5) < 0.01


def test_a_short_hop_leaves_windows_that_agree_as_they_are():
    motion = circle(np.arange(60) * 0.05)
    join = RunningJoin(34, 4, 1, 4)
    shown = [join.add(motion[start : start + 34])[:1] for start in range(20)]
    np.testing.assert_allclose(np.concatenate(shown), motion[4:24], atol=1e-6)

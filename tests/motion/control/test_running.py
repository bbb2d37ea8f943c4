"""Controls of a stream do to each frame what those of a whole motion do, as far as a frame can know."""

import numpy as np
import pytest

from ha2g_jax.motion import control
from ha2g_jax.motion.control import Controls
from ha2g_jax.motion.control.effects import Ramp, RunningControls
from ha2g_jax.skeleton import mirror_directions

FPS = 15


def _one_by_one(skeleton, motion: np.ndarray, controls: Controls) -> np.ndarray:
    running = RunningControls(skeleton, FPS, controls)
    return np.concatenate([running.apply(motion[frame : frame + 1], controls) for frame in range(len(motion))])


def test_neutral_controls_change_no_byte(skeleton, gestures):
    motion = gestures(skeleton, 2)
    assert _one_by_one(skeleton, motion, Controls()).tobytes() == motion.tobytes()


@pytest.mark.parametrize(
    "controls",
    [
        Controls(extent=1.4),
        Controls(extent=0.4),
        Controls(handedness="left"),
        Controls(mirror=True),
        Controls(extent=0.7, handedness="right", mirror=True),
    ],
)
def test_controls_of_a_frame_are_those_of_the_motion(skeleton, gestures, controls):
    motion = gestures(skeleton, 3)
    expected = control.apply(skeleton, motion, FPS, controls)
    np.testing.assert_allclose(_one_by_one(skeleton, motion, controls), expected, atol=1e-5)


@pytest.mark.parametrize(("energy", "low", "high"), [(0, 0, 0.25), (0.5, 0.4, 0.65), (1.5, 1.3, 1.6)])
def test_energy_scales_the_speed(skeleton, gestures, energy, low, high):
    motion = gestures(skeleton, 10)
    livelier = _one_by_one(skeleton, motion, Controls(energy=energy))
    speeds = [np.linalg.norm(np.diff(frames[60:], axis=0), axis=-1).mean() for frames in (livelier, motion)]
    assert low <= speeds[0] / speeds[1] <= high
    np.testing.assert_allclose(np.linalg.norm(livelier, axis=-1), 1, atol=1e-5)


def test_frames_together_are_those_one_by_one(skeleton, gestures):
    motion, controls = gestures(skeleton, 3), Controls(energy=1.4, handedness="left")
    together = RunningControls(skeleton, FPS, controls).apply(motion, controls)
    np.testing.assert_array_equal(together, _one_by_one(skeleton, motion, controls))


def test_a_change_is_eased(skeleton, gestures):
    """A motion that stands still moves from one side to the other in steps that begin and end small."""
    still = np.repeat(gestures(skeleton, 1)[:1], 12, axis=0)
    running = RunningControls(skeleton, FPS)
    running.apply(still[:2], Controls())
    moved = running.apply(still, Controls(mirror=True))
    np.testing.assert_allclose(moved[8:], mirror_directions(skeleton, still[8:]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), 1, atol=1e-5)
    way = np.linalg.norm(np.diff(np.concatenate([still[:1], moved]), axis=0), axis=-1).max(axis=1)
    assert way[0] < way[3] / 3 and way[7] < way[4] / 3


def test_a_ramp_takes_half_a_second_and_may_be_turned_back():
    ramp, up, down = Ramp(np.zeros(1), FPS), np.ones(1), np.zeros(1)
    assert [ramp.step(down)[0] for _ in range(3)] == [0, 0, 0]
    rising = [ramp.step(up)[0] for _ in range(9)]
    assert rising == sorted(rising) and rising[6] < 1 == rising[7] == rising[8]
    falling = [ramp.step(down)[0] for _ in range(4)]
    again = [ramp.step(up)[0] for _ in range(8)]
    assert 0 < falling[-1] < 1 and 0 < again[0] - falling[-1] < 0.1 and again[-1] == 1

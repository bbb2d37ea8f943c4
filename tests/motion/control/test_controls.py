"""Neutral controls change no bit, wrong ones are one line, and what is asked is noted."""

import json
import re

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion import control
from ha2g_jax.motion.control import Controls, Pin, Span
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

FPS = 15


def test_neutral_controls_give_the_very_input(skeleton, gestures):
    motion = gestures(skeleton)
    assert control.apply(skeleton, motion, FPS, Controls()) is motion
    assert control.describe(Controls()) == {}


def test_all_at_once(skeleton, gestures):
    motion = gestures(skeleton)
    before = motion.copy()
    asked = Controls(1.4, 0.8, "left", True, (Pin(1, 2),), (Span(8, 9),))
    changed = control.apply(skeleton, motion, FPS, asked)
    assert changed.shape == motion.shape
    np.testing.assert_allclose(np.linalg.norm(changed, axis=-1), 1, atol=1e-5)
    np.testing.assert_array_equal(motion, before)  # the input is left as it was
    rest = control.rest_pose(skeleton)
    np.testing.assert_array_equal(changed[15:31], np.broadcast_to(rest, changed[15:31].shape))
    described = json.loads(json.dumps(control.describe(asked)))
    assert described["pins"] == [{"start": 1, "end": 2, "pose": "rest"}]
    assert set(described) == {"energy", "extent", "handedness", "mirror", "pins", "mutes"}


MISTAKES = {
    "energy": (Controls(energy=2.5), "the energy is 2.5; expected 0 to 2"),
    "late": (Controls(pins=(Pin(13, 14),)), "after the end of the motion at 12.0333 s"),
    "overlap": (Controls(pins=(Pin(2, 4), Pin(3, 5))), "overlaps the one at 3 s"),
    "skeleton": (Controls(pins=(Pin(1, 2, None, "wave", "other"),)), "wave has the skeleton other"),
    "pose": (Controls(pins=(Pin(1, 2, np.zeros((9, 3)), "wave"),)), "vectors that are not finite or 0"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line(gestures, name):
    asked, message = MISTAKES[name]
    skeleton = load_skeleton("ted_gesture")
    with pytest.raises(UserError, match=re.escape(message)) as caught:
        control.apply(skeleton, gestures(skeleton), FPS, asked)
    assert "\n" not in str(caught.value)


@pytest.fixture
def wave(gestures, tmp_path):
    skeleton = load_skeleton("ted_gesture")
    path = tmp_path / "wave@home.npz"
    Motion.from_directions(skeleton, gestures(skeleton), FPS).save(path)
    return path


def test_a_pin_is_read_with_the_pose_of_a_moment(wave):
    motion = Motion.load(wave)
    pinned = control.read_pin(f"2:3.5:{wave}@2.2")
    assert pinned[:2] == (2, 3.5)
    assert pinned.pose is not None
    np.testing.assert_allclose(pinned.pose, motion.directions[33], atol=1e-6)
    assert pinned[3:5] == ("wave@home.npz@2.2", "ted_gesture")
    first = control.read_pin(f"2:2:{wave}").pose
    assert first is not None
    np.testing.assert_array_equal(first, motion.directions[0])
    assert control.read_pin("0:1:rest") == Pin(0, 1)
    assert control.read_mute("0.5:1e1") == Span(0.5, 10)


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (control.read_pin, "2:3", "START:END:POSE"),
        (control.read_pin, "a:3:rest", "'a' in 'a:3:rest' is not a time"),
        *((control.read_pin, f"2:3:{{wave}}@{time}", f"has no pose at {time} s") for time in ("99", "-1", "nan")),
        *((control.read_mute, text, text) for text in ("2", "2:", "2:x")),
    ],
)
def test_a_pin_or_mute_that_is_none_is_one_line(wave, read, text, message):
    with pytest.raises(UserError, match=re.escape(message)):
        read(text.format(wave=wave))

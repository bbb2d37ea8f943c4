"""A motion that has no pose is refused in one line that names what is wrong and where."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion import solver
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import SKELETONS, load_skeleton


def motion(name: str = "ted_gesture", frames: int = 3) -> Motion:
    skeleton = load_skeleton(name)
    return Motion.from_directions(skeleton, np.tile(skeleton.mean_directions, (frames, 1, 1)), 15)


def with_value(array: np.ndarray, frame: int, place: int, value: float) -> np.ndarray:
    array = array.copy()
    array[frame, place] = value
    return array


@pytest.mark.parametrize("name", SKELETONS)
def test_the_mean_pose_is_accepted_and_comes_back(name):
    good = motion(name, 1)
    good.check()
    found = solver.directions_of(solver.animate(good), load_skeleton(name))
    np.testing.assert_allclose(found, good.directions, atol=1e-3)


GOOD = motion()
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "NaN": ({"directions": with_value(GOOD.directions, 2, 4, np.nan)}, "bone to left_elbow in frame 2"),
    "infinity": ({"positions": with_value(GOOD.positions, 1, 3, np.inf)}, "position of head in frame 1"),
    "zero": (
        {"directions": with_value(GOOD.directions, 1, 8, 0)},
        "right_wrist in frame 1 has a direction of length 0",
    ),
    "far": ({"positions": with_value(GOOD.positions, 1, 3, 1e9)}, "1e[+]09 m away"),
    "joints": ({"joint_names": ("spine", "skull", *GOOD.joint_names[2:])}, "'skull' for neck"),
    "too few joints": ({"joint_names": GOOD.joint_names[:5]}, "5 joints, not the 10"),
    "bones": ({"directions": GOOD.directions[:, :5]}, r"shape \(3, 5, 3\)"),
    "frames": ({"positions": GOOD.positions[:2]}, r"positions are float32 of shape \(2, 10, 3\)"),
    "integers": ({"directions": GOOD.directions.astype(int)}, "directions are int64"),
    "no frames": ({"directions": GOOD.directions[:0], "positions": GOOD.positions[:0]}, "0 frames; expected 1 to"),
    "rate": ({"fps": 0.0}, "0.0 frames per second"),
    "rate that is no number": ({"fps": float("nan")}, "nan frames per second"),
    "skeleton": ({"meta": {"skeleton": "horse"}}, "skeleton 'horse'; expected ted_expressive or ted_gesture"),
    "no skeleton": ({"meta": {}}, "skeleton 'None'"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_named_in_one_line(case):
    changes, message = BAD[case]
    with pytest.raises(UserError, match=message) as raised:
        solver.animate(dataclasses.replace(GOOD, **changes))
    assert "\n" not in str(raised.value)
    assert any(word in str(raised.value) for word in ("expected", "generate", "give"))


def test_ten_million_frames_are_refused_before_anything_is_computed():
    many = {
        key: np.broadcast_to(value[:1], (10_000_000, *value.shape[1:]))
        for key, value in (("directions", GOOD.directions), ("positions", GOOD.positions))
    }
    with pytest.raises(UserError, match="10000000 frames; expected 1 to 1000000"):
        dataclasses.replace(GOOD, **many).check()

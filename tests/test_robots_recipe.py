"""The recipe of docs/robots.md: Pepper's arms, posed by its angles, point where the motion's do."""

import pathlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ha2g_jax.motion import rotations, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


@pytest.fixture(scope="module")
def recipe() -> dict:
    text = (pathlib.Path(__file__).parent.parent / "docs" / "robots.md").read_text()
    names: dict = {}
    for block in text.split("```python\n")[1:]:
        exec(block.split("```")[0], names)
    return names


def pepper(angles: dict, letter: str, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) directions of upper arm and forearm in the chest's axes, by the joints' order and axes in the URDF."""
    upper = Rotation.from_rotvec(angles[f"{letter}ShoulderPitch"][:, None] * [0, 1, 0])
    upper = upper * Rotation.from_rotvec(angles[f"{letter}ShoulderRoll"][:, None] * [0, 0, 1])
    fore = upper * Rotation.from_rotvec([0, tilt, 0])
    fore = fore * Rotation.from_rotvec(angles[f"{letter}ElbowYaw"][:, None] * [1, 0, 0])
    fore = fore * Rotation.from_rotvec(angles[f"{letter}ElbowRoll"][:, None] * [0, 0, 1])
    return upper.apply([1, 0, 0]), fore.apply([1, 0, 0])


def test_arms_point_where_the_motions_do(recipe, tmp_path):
    time = np.arange(20)[:, None] / 15
    directions = np.repeat(SKELETON.mean_directions[None], 20, axis=0)
    for side, out in (("left", 1), ("right", -1)):  # ahead and a little out; y is down and -z ahead in a motion
        upper = np.concatenate(
            [out * (0.4 + 0.2 * np.sin(3 * time)), 0.8 + 0 * time, -0.5 - 0.2 * np.cos(2 * time)], axis=1
        )
        fore = np.concatenate([-out * 0.3 * np.sin(2 * time), -0.2 + 0.3 * np.cos(3 * time), -0.9 + 0 * time], axis=1)
        directions[:, SKELETON.bone("nose"), 0] = 0.3 * np.sin(4 * time[:, 0])
        directions[:, SKELETON.bone(f"{side}_elbow")], directions[:, SKELETON.bone(f"{side}_wrist")] = upper, fore
    motion = Motion.from_directions(SKELETON, directions, 15)
    export(motion, tmp_path / "m.json")
    angles, fps = recipe["pepper_angles"](tmp_path / "m.json")
    assert fps == 15
    animation = solver.animate(motion)
    chest = rotations.conjugate(animation.rotations[:, 0])
    head = world(animation)[0][:, animation.armature.joint("head")]
    ours = rotations.rotate(rotations.multiply(chest, head), np.array([0.0, 0.0, 1.0]))[:, [2, 0, 1]]
    turned = Rotation.from_euler("ZY", np.stack([angles["HeadYaw"], angles["HeadPitch"]], axis=1))
    np.testing.assert_allclose(turned.apply([1, 0, 0]), ours, atol=1e-3)
    for side, letter in (("left", "L"), ("right", "R")):
        found = pepper(angles, letter, recipe["ELBOW_TILT"])
        for end, bone in zip(("elbow", "wrist"), found, strict=True):
            ours = rotations.rotate(chest, motion.directions[:, SKELETON.bone(f"{side}_{end}")] * [1, -1, -1])
            angle = np.degrees(np.arccos(np.clip(np.sum(ours[:, [2, 0, 1]] * bone, axis=1), -1, 1)))
            assert angle.max() < 0.2, (side, end)
    for name, (low, high, _) in recipe["LIMITS"].items():
        assert ((angles[name] >= low) & (angles[name] <= high)).all()


def test_a_motion_that_is_too_fast_is_played_slower(recipe):
    angles = {name: np.zeros(3) for name in recipe["LIMITS"]}
    assert recipe["slower"](angles, 15) == 1
    angles["LShoulderPitch"] = np.array([0, 1, 0])
    assert recipe["slower"](angles, 15) == pytest.approx(15 / 7.33998)

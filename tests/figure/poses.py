"""Poses for the tests of the figure, and where the background of their images is."""

from collections.abc import Mapping

import numpy as np

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.figure.shapes import project

GREEN = figure.DEFAULT_LOOK._replace(background=(0, 255, 0))
Bones = Mapping[str, tuple[float, float, float]]


def posed(skeleton: skeletons.Skeleton, bones: Bones) -> np.ndarray:
    """(joints, 3) mean pose with directions of some bones, by the joint at their ends; x is the person's left."""
    turn = -1 if skeleton.name == "ted_gesture" else 1
    directions = skeleton.mean_directions.copy()
    for joint, direction in bones.items():
        directions[skeleton.bone(joint)] = np.array(direction) * (turn, 1, turn)
    return skeletons.directions_to_positions(skeleton, directions)


WIDE = {"left_elbow": (1, 0, 0), "left_wrist": (1, 0, 0), "right_elbow": (-1, 0, 0), "right_wrist": (-1, 0, 0)}
POSES: dict[str, Bones] = {
    "crossed": {"left_elbow": (0.2, 0.9, -0.4), "left_wrist": (-0.9, -0.4, -0.3)}
    | {"right_elbow": (-0.2, 0.9, -0.3), "right_wrist": (0.9, -0.4, -0.3)},
    "to the camera": {"left_elbow": (0, 0.1, -1), "left_wrist": (0, 0, -1), "right_elbow": (0, -0.1, -1)}
    | {"right_wrist": (0, 0.02, -1)},
    "away": {
        "left_elbow": (0, 0.1, 1),
        "left_wrist": (0.02, 0, 1),
        "right_elbow": (0, 1, 0),
        "right_wrist": (0, -1, 0),
    },
    "up": {"left_elbow": (0.1, -1, 0), "left_wrist": (0, -1, 0), "right_elbow": (-1, -1, 0), "right_wrist": (1, -1, 0)},
    "shrug": {"left_shoulder": (1, -0.5, 0), "right_shoulder": (-1, -0.5, 0.2), "neck": (0.3, -1, -0.2)},
    "turned": {"left_shoulder": (0.3, 0.1, 1), "right_shoulder": (-0.3, 0.1, -1)},
}


def random_poses(name: str, count: int) -> np.ndarray:
    """(count, joints, 3) poses about the mean."""
    skeleton = skeletons.load_skeleton(name)
    noise = np.random.default_rng(0).normal(0, 0.3, (count, skeleton.num_bones, 3))
    return skeletons.directions_to_positions(skeleton, skeleton.mean_directions + noise)


def poses_of(name: str) -> np.ndarray:
    """(T, joints, 3) poses by name, poses about the mean, and poses with arms and hands in any direction."""
    skeleton = skeletons.load_skeleton(name)
    random = np.random.default_rng(1)
    directions = skeleton.mean_directions + random.normal(0, 0.1, (40, skeleton.num_bones, 3))
    limbs = [skeleton.bone(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]
    limbs += [bone for bone, (_, end) in enumerate(skeleton.bones) if skeleton.joints[end][-2:] in ("_1", "_2", "_3")]
    directions[:, limbs] = random.normal(size=(40, len(limbs), 3))
    named = [posed(skeleton, bones) for bones in POSES.values()]
    return np.concatenate([named, random_poses(name, 10), skeletons.directions_to_positions(skeleton, directions)])


def is_background(picture: np.ndarray) -> np.ndarray:
    """Where the `GREEN` of the background is more than half of a pixel."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return green - np.maximum(red, blue) > 110


def pixels_of(places: np.ndarray, size: int, view: figure.View) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of places (..., 3) about the spine, in which the person faces -z."""
    scale, spine = view.place(size, size)
    x, y = np.moveaxis(np.floor(project(places) * scale + spine).astype(int), -1, 0)
    return y, x

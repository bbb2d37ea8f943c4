"""Reads the upper body of a motion capture in BVH, to hold Talk against a real speaker."""

import os
import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.talk.anatomy import axis_rotation
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import Skeleton, directions_to_positions, positions_to_directions

# Joint of TED-Expressive: joint of the Mixamo skeleton, "Side" standing for Left or Right.
_JOINTS = {"spine": "Spine3", "neck": "Neck", "shoulder": "SideArm", "elbow": "SideForeArm", "wrist": "SideHand"}
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
_TO_METRES = 0.01
_Y_DOWN = np.array([1.0, -1.0, -1.0])  # BVH: y up, facing +z


class _Joint(NamedTuple):
    name: str
    parent: int
    offset: tuple[float, ...]
    channels: tuple[str, ...]


def read_bvh(path: str | os.PathLike, skeleton: Skeleton, fps: float) -> np.ndarray:
    """Positions (T, joints, 3) in metres, y down, the root at the origin, with the bone lengths of `skeleton`.

    Takes the joint names of Mixamo and centimetres. BVH has no face: the head keeps the mean pose.

    Raises:
        UserError: no BVH, or one with other joints.
    """
    try:
        hierarchy, motion = pathlib.Path(path).read_text().split("MOTION")
        joints = _read_hierarchy(hierarchy.split())
        _, frame_time, *rows = motion.strip().splitlines()
        values = np.array([row.split() for row in rows if row.strip()], float)
        source_fps = 1 / float(frame_time.split(":")[1])
    except (OSError, ValueError, IndexError) as error:
        raise UserError(f"{path} cannot be read as BVH ({error}); give a motion capture file with fingers") from error
    names = [joint.name for joint in joints]
    wanted = _source_names()
    if missing := sorted(set(wanted.values()) - set(names)):
        raise UserError(f"{path} lacks the joints {', '.join(missing[:4])}; give a BVH with the joint names of Mixamo")
    moments = np.arange(0, len(values), source_fps / fps)
    values = values[np.clip(np.round(moments).astype(int), 0, len(values) - 1)]
    world = _forward(joints, values) * _TO_METRES * _Y_DOWN
    positions = np.empty((len(world), skeleton.num_joints, 3))
    for index, joint in enumerate(skeleton.joints):
        if joint in wanted:
            positions[:, index] = world[:, names.index(wanted[joint])]
        else:
            neck = skeleton.joint("neck")
            positions[:, index] = positions[:, neck] + (skeleton.mean_pose[index] - skeleton.mean_pose[neck])
    return directions_to_positions(skeleton, positions_to_directions(skeleton, positions)).astype(np.float32)


def _source_names() -> dict[str, str]:
    names = {joint: source for joint, source in _JOINTS.items() if "Side" not in source}
    for side in ("left", "right"):
        parts = {joint: source for joint, source in _JOINTS.items() if "Side" in source}
        parts |= {f"{finger.lower()}_{part}": f"SideHand{finger}{part}" for finger in _FINGERS for part in (1, 2, 3)}
        names |= {f"{side}_{joint}": source.replace("Side", side.title()) for joint, source in parts.items()}
    return names


def _read_hierarchy(tokens: list[str]) -> list[_Joint]:
    joints: list[_Joint] = []
    open_joints: list[int] = []
    name = ""
    position = 0
    while position < len(tokens):
        token = tokens[position]
        if token in ("ROOT", "JOINT", "End"):
            name = tokens[position + 1]
        elif token == "{":
            joints.append(_Joint(name, open_joints[-1] if open_joints else -1, (), ()))
            open_joints.append(len(joints) - 1)
        elif token == "}":
            open_joints.pop()
        elif token == "OFFSET":
            offset = tuple(float(value) for value in tokens[position + 1 : position + 4])
            joints[open_joints[-1]] = joints[open_joints[-1]]._replace(offset=offset)
        elif token == "CHANNELS":
            channels = tuple(tokens[position + 2 : position + 2 + int(tokens[position + 1])])
            joints[open_joints[-1]] = joints[open_joints[-1]]._replace(channels=channels)
        position += 1
    return joints


def _forward(joints: list[_Joint], values: np.ndarray) -> np.ndarray:
    """World positions (T, joints, 3) of channel values (T, channels)."""
    positions = np.zeros((len(values), len(joints), 3))
    rotations = np.zeros((len(values), len(joints), 3, 3))
    column = 0
    for index, joint in enumerate(joints):
        offset = np.tile(joint.offset, (len(values), 1))
        rotation = np.tile(np.eye(3), (len(values), 1, 1))
        for channel in joint.channels:
            axis = "XYZ".index(channel[0])
            if channel.endswith("position"):
                offset[:, axis] = values[:, column]
            else:
                rotation = rotation @ axis_rotation(axis, np.deg2rad(values[:, column]))
            column += 1
        if joint.parent < 0:
            positions[:, index], rotations[:, index] = offset, rotation
        else:
            turn = rotations[:, joint.parent]
            positions[:, index] = positions[:, joint.parent] + np.einsum("tij,tj->ti", turn, offset)
            rotations[:, index] = turn @ rotation
    return positions

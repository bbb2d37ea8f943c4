"""Reader of the motion of a BVH file as joints of a skeleton, in metres and in the skeleton's axes, with a face."""

import os
import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.mocap.axes import find_up, to_skeleton_axes
from ha2g_jax.data.mocap.bvh import read_bvh
from ha2g_jax.data.mocap.face import add_face
from ha2g_jax.data.mocap.joint_maps import AUTO, HEAD, choose_map
from ha2g_jax.data.mocap.kinematics import world_motion
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_SOUND_SECONDS
from ha2g_jax.skeleton import Skeleton

MAX_MINUTES = 2 * MAX_SOUND_SECONDS / 60  # length of a motion: audio must have at least half the length of its motion

_UNITS = (0.001, 0.01, 0.0254, 1.0)  # millimetres, centimetres, inches, metres
_ARM = 0.55  # metres from shoulder to wrist of an adult
_ARM_RANGE = (0.3, 1.0)


class Motion(NamedTuple):
    """The motion of a BVH file, and how the file was interpreted.

    Attributes:
        positions: (T, joints, 3) metres in the skeleton's axes, float32.
        seconds: length of the motion in seconds.
        joint_map: name of the joint map that was used.
        unit: metres in one unit of the file.
        up: axis of the file that points up.
    """

    positions: np.ndarray
    seconds: float
    joint_map: str
    unit: float
    up: str


def read_motion(
    path: str | os.PathLike,
    skeleton: Skeleton,
    *,
    fps: float,
    joint_map: str = AUTO,
    unit: float | None = None,
) -> Motion:
    """Read the motion of a BVH file as joints of a skeleton.

    Args:
        path: path of a BVH file.
        skeleton: skeleton of the result.
        fps: frames per second of the result.
        joint_map: "auto", one of `joint_maps.MAPS` or the path of a YAML file.
        unit: metres in one unit of the file; None uses the unit of the joint map, or else that among millimetres,
            centimetres, inches and metres for which the arms have a length closest to an adult's.

    Raises:
        UserError: the file is not BVH or longer than two hours, its joints do not fit the map, or its arms do not
            have a person's length.
    """
    path = pathlib.Path(path)
    bvh = read_bvh(path)
    if (minutes := bvh.seconds / 60) > MAX_MINUTES:
        raise UserError(
            f"{shown(path)} has {minutes:.0f} minutes of motion; expected at most {MAX_MINUTES:.0f}: cut the file"
        )
    names, places = choose_map(bvh.joints, skeleton, joint_map, path)
    own = [joint for joint in places if joint != HEAD]
    try:
        world, rotations = world_motion(bvh, fps, [*(places[joint] for joint in own), places[HEAD]])
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error
    positions = np.zeros((len(world), skeleton.num_joints, 3))
    positions[:, [skeleton.joint(joint) for joint in own]] = world[:, :-1]
    unit = _find_unit(positions, skeleton, unit or names.unit, path)
    positions *= unit
    up = names.up or find_up(positions, skeleton)
    try:
        positions = add_face(positions, world[:, -1] * unit, rotations[-1], skeleton, up=up)
        positions = to_skeleton_axes(positions, skeleton, up=up)
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error
    return Motion(positions.astype(np.float32), bvh.seconds, names.name, unit, up)


def _find_unit(positions: np.ndarray, skeleton: Skeleton, unit: float | None, path: pathlib.Path) -> float:
    """Return the metres in one unit, checked or found by the median length of the arms."""
    arms = [[skeleton.joint(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")] for side in ("left", "right")]
    bones = np.linalg.norm(np.diff(positions[:, arms], axis=2), axis=-1)
    length = float(np.median(bones.sum(axis=-1)))
    metres = unit or min(_UNITS, key=lambda metres: abs(np.log(max(length * metres, 1e-12) / _ARM)))
    if not _ARM_RANGE[0] <= length * metres <= _ARM_RANGE[1]:
        raise UserError(
            f"{shown(path)} has arms {length:.4g} units long from shoulder to wrist, "
            f"{length * metres:.4g} m for a unit of "
            f"{metres:g} m; expected about {_ARM} m: give the metres in one unit (--unit)"
        )
    return metres

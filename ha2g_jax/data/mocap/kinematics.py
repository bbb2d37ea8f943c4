"""Forward kinematics of a BVH motion at any frame rate."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.data.mocap.bvh import Bvh
from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_POSED_JOINTS

_AXES = "XYZ"


def world_motion(bvh: Bvh, fps: float, joints: Sequence[int]) -> tuple[np.ndarray, list[Rotation]]:
    """Compute positions and rotations of joints by forward kinematics, at another frame rate.

    Between two frames, local rotations are interpolated on the sphere and local positions linearly, so that a bone
    without position channels keeps its length.

    Args:
        bvh: contents of a BVH file.
        fps: frames per second of the result; frame k is at k / fps seconds, up to the last frame of the file.
        joints: n indices of joints of the file; only these and the joints above them are computed.

    Returns:
        (T, n, 3) positions in units of the file and n times T rotations, both in the file's coordinates.

    Raises:
        UserError: the joints times the frames of the result are more than `MAX_POSED_JOINTS`.
    """
    last = len(bvh.motion) - 1
    num_frames = int(last * fps / bvh.fps + 1e-6) + 1
    needed = _with_parents(bvh.parents, joints)
    check_size(len(needed), num_frames)
    moments = np.minimum(np.arange(num_frames) * (bvh.fps / fps), last)
    before = np.floor(moments).astype(int)
    after, weight = np.minimum(before + 1, last), (moments - before)[:, None]
    places: dict[int, np.ndarray] = {}
    rotations: dict[int, Rotation] = {}
    column = 0
    for joint, (parent, channels) in enumerate(zip(bvh.parents, bvh.channels, strict=True)):
        values = bvh.motion[:, column : column + len(channels)]
        column += len(channels)
        if joint not in needed:
            continue
        first, second = (_local(bvh.offsets[joint], channels, values[frames]) for frames in (before, after))
        place = first[0] + weight * (second[0] - first[0])
        rotation = first[1] * Rotation.from_rotvec(weight * (first[1].inv() * second[1]).as_rotvec())
        if parent >= 0:
            place = places[parent] + rotations[parent].apply(place)
            rotation = rotations[parent] * rotation
        places[joint], rotations[joint] = place, rotation
    return np.stack([places[joint] for joint in joints], axis=1), [rotations[joint] for joint in joints]


def check_size(num_joints: int, num_frames: int) -> None:
    """Check that a motion is not too large to be computed.

    Args:
        num_joints: number of joints.
        num_frames: number of frames at the new rate.

    Raises:
        UserError: there are more than `MAX_POSED_JOINTS` in all frames together.
    """
    if num_joints * num_frames > MAX_POSED_JOINTS:
        raise UserError(
            f"{num_joints} joints in {num_frames} frames, {num_joints * num_frames:,} together; expected at most "
            f"{MAX_POSED_JOINTS:,}: cut the file"
        )


def _with_parents(parents: Sequence[int], joints: Sequence[int]) -> set[int]:
    """Return the joints and all joints above them."""
    needed: set[int] = set()
    for joint in joints:
        while joint >= 0 and joint not in needed:
            needed.add(joint)
            joint = parents[joint]
    return needed


def _local(offset: np.ndarray, channels: tuple[str, ...], values: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """Return the position (T, 3) and rotation of a joint relative to its parent; position channels replace the
    offset."""
    place = np.tile(offset, (len(values), 1))
    order, angles = "", []
    for channel, value in zip(channels, values.T, strict=True):
        if channel.endswith("position"):
            place[:, _AXES.index(channel[0])] = value
        else:
            order += channel[0]  # upper case: intrinsic rotations
            angles.append(value)
    if not order:
        return place, Rotation.identity(len(values))
    return place, Rotation.from_euler(order, np.stack(angles, axis=-1), degrees=True)

"""Forward kinematics of a BVH motion at any frame rate."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_POSED_JOINTS
from ha2g_jax.motion.readers.bvh import Bvh

_AXES = "XYZ"


def world_motion(bvh: Bvh, fps: float, joints: Sequence[int]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Compute positions and rotations of joints by forward kinematics, at another frame rate.

    Between two frames, local rotations are interpolated on the sphere and local positions linearly, so that a bone
    without position channels keeps its length.

    Args:
        bvh: contents of a BVH file.
        fps: frames per second of the result; frame k is at k / fps seconds, up to the last frame of the file.
        joints: n indices of joints of the file; only these and the joints above them are computed.

    Returns:
        (T, n, 3) positions in units of the file and n times (T, 3, 3) rotations, both in the file's coordinates.

    Raises:
        UserError: the joints times the frames of the result are more than `MAX_POSED_JOINTS`.
    """
    last = len(bvh.motion) - 1
    num_frames = int(last * fps / bvh.fps + 1e-6) + 1
    needed = _with_parents(bvh.parents, joints)
    check_size(len(needed), num_frames)
    moments = np.minimum(np.arange(num_frames) * (bvh.fps / fps), last)
    # A slow file has many frames of the result between the same two of its own, which are converted once.
    starts, place_of = np.unique(np.floor(moments).astype(int), return_inverse=True)
    weight = (moments - starts[place_of])[:, None]
    # The rotation of a joint matters if it is asked for or moves another joint.
    above = {bvh.parents[joint] for joint in needed} | {*joints}
    places: dict[int, np.ndarray] = {}
    rotations: dict[int, np.ndarray] = {}
    column = 0
    for joint, (parent, channels) in enumerate(zip(bvh.parents, bvh.channels, strict=True)):
        values = bvh.motion[:, column : column + len(channels)]
        column += len(channels)
        if joint not in needed:
            continue
        before, after = (values[frames] for frames in (starts, np.minimum(starts + 1, last)))
        place = _places(bvh.offsets[joint], channels, before)[place_of]
        place += weight * (_places(bvh.offsets[joint], channels, after)[place_of] - place)
        places[joint] = place if parent < 0 else places[parent] + _apply(rotations[parent], place)
        if joint in above:
            first, second = _rotations(channels, before), _rotations(channels, after)
            turn = (first.inv() * second).as_rotvec()[place_of]
            begin = Rotation.from_quat(first.as_quat()[place_of])
            rotation = (begin * Rotation.from_rotvec(weight * turn)).as_matrix()
            rotations[joint] = rotation if parent < 0 else rotations[parent] @ rotation
    return np.stack([places[joint] for joint in joints], axis=1), [rotations[joint] for joint in joints]


def _apply(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (rotations @ vectors[:, :, None])[:, :, 0]


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


def _places(offset: np.ndarray, channels: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """Return the position (T, 3) of a joint relative to its parent; position channels replace the offset."""
    place = np.tile(offset, (len(values), 1))
    for channel, value in zip(channels, values.T, strict=True):
        if channel.endswith("position"):
            place[:, _AXES.index(channel[0])] = value
    return place


def _rotations(channels: tuple[str, ...], values: np.ndarray) -> Rotation:
    """Return the T rotations of a joint relative to its parent."""
    turning = [index for index, channel in enumerate(channels) if channel.endswith("rotation")]
    if not turning:
        return Rotation.identity(len(values))
    order = "".join(channels[index][0] for index in turning)  # upper case: intrinsic rotations
    return Rotation.from_euler(order, values[:, turning], degrees=True)

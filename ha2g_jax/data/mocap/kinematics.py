"""Forward kinematics of a BVH motion at any frame rate."""

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.data.mocap.bvh import Bvh

_AXES = "XYZ"


def world_motion(bvh: Bvh, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute positions and rotations of all joints by forward kinematics, at another frame rate.

    Between two frames, local rotations are interpolated on the sphere and local positions linearly, so that a bone
    without position channels keeps its length.

    Args:
        bvh: contents of a BVH file.
        fps: frames per second of the result; frame k is at k / fps seconds, up to the last frame of the file.

    Returns:
        (T, joints, 3) positions in units of the file and (T, joints, 3, 3) rotations, both in the file's coordinates.
    """
    last = len(bvh.motion) - 1
    moments = np.minimum(np.arange(int(last * fps / bvh.fps + 1e-6) + 1) * (bvh.fps / fps), last)
    before = np.floor(moments).astype(int)
    after, weight = np.minimum(before + 1, last), (moments - before)[:, None]
    positions = np.empty((len(moments), len(bvh.joints), 3))
    rotations: list[Rotation] = []
    column = 0
    for joint, (parent, channels) in enumerate(zip(bvh.parents, bvh.channels, strict=True)):
        values = bvh.motion[:, column : column + len(channels)]
        column += len(channels)
        first, second = (_local(bvh.offsets[joint], channels, values[frames]) for frames in (before, after))
        place = first[0] + weight * (second[0] - first[0])
        rotation = first[1] * Rotation.from_rotvec(weight * (first[1].inv() * second[1]).as_rotvec())
        if parent >= 0:
            place = positions[:, parent] + rotations[parent].apply(place)
            rotation = rotations[parent] * rotation
        positions[:, joint] = place
        rotations.append(rotation)
    return positions, np.stack([rotation.as_matrix() for rotation in rotations], axis=1)


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

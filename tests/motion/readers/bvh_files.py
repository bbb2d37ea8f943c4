"""Writes BVH files: of any joints, and of a made-up person in any naming, unit, way up and order of rotations."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_TO_UP = {  # rotations that take y up, facing +z, to the way up of the key
    "y": np.eye(3),
    "-y": np.diag([-1.0, -1.0, 1.0]),
    "z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


def body(with_fingers: bool = True) -> dict[str, tuple[str, tuple[float, float, float]]]:
    """Joint: (parent, offset in metres) of a person in T pose, y up, facing +z, the left at +x."""
    joints = {
        "hips": ("", (0.0, 0.9, 0.0)),
        "spine": ("hips", (0.0, 0.35, 0.0)),
        "neck": ("spine", (0.0, 0.17, 0.0)),
        "head": ("neck", (0.0, 0.10, 0.02)),
    }
    for side, sign in (("left", 1), ("right", -1)):
        joints[f"{side}_shoulder"] = ("spine", (sign * 0.15, 0.13, 0.0))
        joints[f"{side}_elbow"] = (f"{side}_shoulder", (sign * 0.29, 0.0, 0.0))
        joints[f"{side}_wrist"] = (f"{side}_elbow", (sign * 0.26, 0.0, 0.0))
        for place, finger in enumerate(FINGERS if with_fingers else ()):
            joints[f"{side}_{finger}_1"] = (f"{side}_wrist", (sign * 0.09, 0.0, 0.03 - 0.015 * place))
            for part in (2, 3):
                joints[f"{side}_{finger}_{part}"] = (f"{side}_{finger}_{part - 1}", (sign * 0.03, 0.0, 0.0))
    return joints


def swing(seconds: float, fps: float, with_fingers: bool = True) -> dict[str, np.ndarray]:
    """Joint: (T, 3) degrees about x, y and z: arms that swing, hands that open, a head that looks about."""
    times = np.arange(round(seconds * fps)) / fps
    waves = np.stack([np.sin(2 * np.pi * rate * times) for rate in (0.5, 0.7, 0.9)], axis=-1)
    return {
        joint: (3 + 12 * ("shoulder" in joint)) * np.roll(waves, i, axis=1)
        for i, joint in enumerate(body(with_fingers))
    }


def bvh(
    joint_angles: Mapping[str, np.ndarray],
    *,
    name: Callable[[str], str] = str,
    per_metre: float = 100.0,
    up: str = "y",
    order: str = "ZYX",
    fps: float = 30.0,
) -> str:
    """A BVH file.

    Args:
        joint_angles: (T, 3) degrees about x, y and z by joint; without those of the fingers there are no fingers.
        name: of a joint in the file.
        per_metre: units in a metre.
        up: "y", "-y", "z" or "-z".
        order: of the rotation channels.
        fps: frames per second.
    """
    joints = {joint: place for joint, place in body().items() if joint in joint_angles}
    offsets = np.array([offset for _, offset in joints.values()]) @ _TO_UP[up].T * per_metre
    angles = np.stack([joint_angles[joint] for joint in joints], axis=1)[..., ["XYZ".index(axis) for axis in order]]
    parents = [list(joints).index(parent) if parent else -1 for parent, _ in joints.values()]
    root = np.tile(offsets[0], (len(angles), 1))
    return write([name(joint) for joint in joints], parents, offsets, angles, root, order=order, fps=fps)


def write(
    names: Sequence[str],
    parents: Sequence[int],
    offsets: np.ndarray,
    angles: np.ndarray,
    root: np.ndarray,
    *,
    order: str,
    fps: float = 30.0,
) -> str:
    """A BVH file of joints with offsets (J, 3), degrees (T, J, 3) in the order of the channels and a root (T, 3)."""
    lines, columns = ["HIERARCHY"], [root]

    def add(joint: int, pad: str) -> None:
        columns.append(angles[:, joint])
        channels = " ".join(f"{axis}rotation" for axis in order)
        lines.extend([f"{pad}{'JOINT' if pad else 'ROOT'} {names[joint]}", pad + "{"])
        lines.append(f"{pad}  OFFSET " + " ".join(f"{value:.6f}" for value in offsets[joint]))
        lines.append(f"{pad}  CHANNELS {'3' if pad else '6 Xposition Yposition Zposition'} {channels}")
        children = [child for child, parent in enumerate(parents) if parent == joint]
        for child in children:
            add(child, pad + "  ")
        if not children:
            lines.extend([f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET 0 0 0", pad + "  }"])
        lines.append(pad + "}")

    add(0, "")
    rows = [" ".join(f"{value:.6f}" for value in row) for row in np.concatenate(columns, axis=1)]
    return "\n".join([*lines, "MOTION", f"Frames: {len(rows)}", f"Frame Time: {1 / fps:.8f}", *rows]) + "\n"


def first_frames(text: str, count: int) -> str:
    head, motion = text.split("MOTION")
    _, rate, *rows = motion.strip().splitlines()[: 2 + count]
    return "\n".join([f"{head}MOTION", f"Frames: {count}", rate, *rows]) + "\n"

"""BVH files: centimetres, y up, facing +z; with all rotations zero the figure is in the rest pose of the rig."""

import pathlib
from collections.abc import Iterator

import numpy as np

from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, relative, rest_positions, world
from ha2g_jax.progress import progress_bar

_CENTIMETRES = 100.0
_TIP = 2.0  # centimetres from the last joint of a chain to its end site
_ORDER = "ZXY"
_CHANNELS = "Zrotation Xrotation Yrotation"
_BLOCK = 2000  # frames formatted at a time


def write(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.bvh` file.

    Every joint has three rotations in the order Z, X, Y, in degrees, unwrapped over time. The root also has its
    position, and an offset of zero, so that the result is the same in programs that add the two and in others. A BVH
    has no axes of joints: at rest all joints have the axes of the world, whatever the axes of the rig.
    """
    armature = animation.armature
    _, places = rest_positions(armature)
    order = _depth_first(armature)
    angles = _angles(animation)[:, order]
    root = _CENTIMETRES * animation.translation
    with whole_file(path) as temporary, temporary.open("w", newline="\n") as file:
        file.write("HIERARCHY\n" + "\n".join(_hierarchy(armature, _CENTIMETRES * places, 0, 0)) + "\n")
        frame_time = f"{1 / animation.fps:.10f}"  # enough decimals to tell 125 from 120
        file.write(f"MOTION\nFrames: {animation.num_frames}\nFrame Time: {frame_time}\n")
        line = " ".join(["%.6f"] * 3 + ["%.5f"] * (3 * len(order))) + "\n"
        with progress_bar("writing BVH", animation.num_frames, "frame", is_part=True) as bar:
            for start in range(0, animation.num_frames, _BLOCK):
                frames = slice(start, start + _BLOCK)
                values = np.concatenate([root[frames], angles[frames].reshape(-1, 3 * len(order))], axis=1)
                # Adding zero changes -0.0 to 0.0.
                file.writelines(line % tuple(row) for row in (np.round(values, 6) + 0.0).tolist())
                bar.update(len(values))


def _angles(animation: Animation) -> np.ndarray:
    """Return (T, J, 3) angles in degrees of joints whose axes at rest are those of the world."""
    rotated, _ = world(animation)
    at_rest, _ = rest_positions(animation.armature)
    local = relative(rotations.multiply(rotated, rotations.conjugate(at_rest)), animation.armature.parents)
    return np.unwrap(rotations.to_euler(local, _ORDER), period=360, axis=0)


def _depth_first(armature: Armature, joint: int = 0) -> list[int]:
    """Return the indices of the joints in the order of the hierarchy, which is also that of the channels."""
    return [joint, *(index for child in _children(armature, joint) for index in _depth_first(armature, child))]


def _children(armature: Armature, joint: int) -> list[int]:
    return [index for index, parent in enumerate(armature.parents) if parent == joint]


def _hierarchy(armature: Armature, places: np.ndarray, joint: int, depth: int) -> Iterator[str]:
    """Yield the lines of a joint and all joints below it, from positions (J, 3) in centimetres."""
    indent, parent = "\t" * depth, armature.parents[joint]
    bone = places[joint] - places[parent] if parent >= 0 else np.zeros(3)
    yield f"{indent}{'JOINT' if parent >= 0 else 'ROOT'} {armature.joints[joint]}"
    yield f"{indent}{{"
    yield f"{indent}\tOFFSET {_numbers(bone)}"
    channels = f"3 {_CHANNELS}" if parent >= 0 else f"6 Xposition Yposition Zposition {_CHANNELS}"
    yield f"{indent}\tCHANNELS {channels}"
    children = _children(armature, joint)
    for child in children:
        yield from _hierarchy(armature, places, child, depth + 1)
    if not children:
        tip = _TIP * rotations.unit(bone) if np.linalg.norm(bone) > 0 else np.array([0.0, _TIP, 0.0])
        yield from (f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_numbers(tip)}", f"{indent}\t}}")
    yield f"{indent}}}"


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in np.round(values, 6) + 0.0)

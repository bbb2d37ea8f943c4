"""JSON and CSV tables of the positions, directions and rotations of every joint, for programs of the user."""

import json
import pathlib
from collections.abc import Iterator

import numpy as np
from tqdm import tqdm

from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, world

_AXES = {"units": "metres", "x": "the figure's left", "y": "up", "z": "ahead of the figure"}
_QUATERNIONS = "x, y, z, w, relative to the parent's axes, the rest rotation included"
_MILLIONTHS, _BLOCK = 6, 500
_POSITION, _DIRECTION, _ROTATION = "xyz", ("dx", "dy", "dz"), ("qx", "qy", "qz", "qw")


def write_json(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.json` file: an object with the armature and a list of frames, one frame on each line.

    Fields: `rig`, `fps`, `axes`, `quaternions`, `meta`; `joints`, a list of `name`, `parent` (an index, -1 for the
    root), `offset` and `rest` as in `armature.Armature`; `frames`, each with `time` in seconds and for every joint its
    `positions` [x, y, z] in metres, its `directions` [x, y, z], the unit vector in the world from its parent to it
    (zero for the root and for joints at the position of their parent), and its `rotations` [x, y, z, w].

    Args:
        path: file to write.
        animation: animation of any rig.

    Raises:
        UserError: the file cannot be written.
    """
    armature = animation.armature
    rows = zip(armature.joints, armature.parents, _rounded(armature.offsets), _rounded(armature.rest), strict=True)
    head = {
        "rig": armature.name,
        "fps": animation.fps,
        "axes": _AXES,
        "quaternions": _QUATERNIONS,
        "meta": animation.meta,
        "joints": [dict(zip(("name", "parent", "offset", "rest"), row, strict=True)) for row in rows],
    }
    start = json.dumps(head, indent=1, sort_keys=True).removesuffix("\n}")
    with whole_file(path) as temporary, temporary.open("w", newline="\n") as file:
        file.write(f'{start},\n "frames": [')
        for index, (positions, directions, local) in enumerate(_frames(animation)):
            frame = {
                "time": round(index / animation.fps, _MILLIONTHS),
                "positions": positions,
                "directions": directions,
                "rotations": local,
            }
            file.write(",\n  " if index else "\n  ")
            file.write(json.dumps(frame, separators=(",", ":")))
        file.write("\n ]\n}\n")


def write_csv(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.csv` file: a line of names, then one line for each frame.

    The columns are `frame`, `time` in seconds, and ten for every joint: NAME_x, NAME_y, NAME_z, its position in
    metres; NAME_dx, NAME_dy, NAME_dz, the unit vector from its parent to it; NAME_qx, NAME_qy, NAME_qz, NAME_qw, its
    rotation. The values are those of `write_json`.

    Args:
        path: file to write.
        animation: animation of any rig.

    Raises:
        UserError: the file cannot be written.
    """
    fields = (*_POSITION, *_DIRECTION, *_ROTATION)
    names = ["frame", "time", *(f"{joint}_{field}" for joint in animation.armature.joints for field in fields)]
    with whole_file(path) as temporary, temporary.open("w", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for index, frame in enumerate(_frames(animation)):
            values = [str(value) for joint in zip(*frame, strict=True) for part in joint for value in part]
            time = round(index / animation.fps, _MILLIONTHS)
            file.write(",".join([str(index), str(time), *values]) + "\n")


def _frames(animation: Animation) -> Iterator[tuple[list, list, list]]:
    """Yield lists of the positions, directions and rotations of each frame, rounded to six decimals."""
    _, positions = world(animation)
    parents = np.array([max(parent, 0) for parent in animation.armature.parents])
    starts = range(0, animation.num_frames, _BLOCK)
    for start in tqdm(starts, desc="frames", unit="block", disable=None if len(starts) > 1 else True, leave=False):
        frames = slice(start, start + _BLOCK)
        bones = positions[frames] - positions[frames][:, parents]
        # A bone of length 0 has no direction; forward kinematics leaves rounding errors of it.
        bones = np.where(np.linalg.norm(bones, axis=-1, keepdims=True) > 1e-9, bones, 0.0)
        parts = (positions[frames], rotations.unit(bones), animation.rotations[frames])
        yield from zip(*(_rounded(part) for part in parts), strict=True)


def _rounded(values: np.ndarray) -> list:
    return (np.round(values, _MILLIONTHS) + 0.0).tolist()

"""JSON and CSV tables of the positions, directions and rotations of every joint, and arrays of SMPL-X."""

import json
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, world
from ha2g_jax.progress import progress_bar

_AXES = {"units": "metres", "x": "the figure's left", "y": "up", "z": "ahead of the figure"}
_QUATERNIONS = "x, y, z, w, relative to the parent's axes, the rest rotation included"
_MILLIONTHS, _BLOCK = 6, 500
_POSITION, _DIRECTION, _ROTATION = "xyz", ("dx", "dy", "dz"), ("qx", "qy", "qz", "qw")
_NUM_BETAS = 16


def write_json(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.json` file: an object with the armature and a list of frames, one frame on each line.

    Fields: `rig`, `fps`, `axes`, `quaternions`, `meta`; `joints`, a list of `name`, `parent` (an index, -1 for the
    root), `offset` and `rest` as in `armature.Armature`; `frames`, each with `time` in seconds and for every joint its
    `positions` [x, y, z] in metres, its `directions` [x, y, z], the unit vector in the world from its parent to it
    (zero for the root and for joints at the position of their parent), and its `rotations` [x, y, z, w].
    """
    head = describe_joints(animation.armature, animation.fps) | {"meta": animation.meta}
    start = json.dumps(head, indent=1, sort_keys=True).removesuffix("\n}")
    with whole_file(path) as temporary, temporary.open("w", newline="\n") as file:
        file.write(f'{start},\n "frames": [')
        for index, pose in enumerate(describe_poses(animation)):
            frame = {"time": round(index / animation.fps, _MILLIONTHS), **pose}
            file.write(",\n  " if index else "\n  ")
            file.write(json.dumps(frame, separators=(",", ":")))
        file.write("\n ]\n}\n")


def write_csv(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.csv` file: a line of names, then one line for each frame.

    The columns are `frame`, `time` in seconds, and ten for every joint: NAME_x, NAME_y, NAME_z, its position in
    metres; NAME_dx, NAME_dy, NAME_dz, the unit vector from its parent to it; NAME_qx, NAME_qy, NAME_qz, NAME_qw, its
    rotation. The values are those of `write_json`.
    """
    fields = (*_POSITION, *_DIRECTION, *_ROTATION)
    names = ["frame", "time", *(f"{joint}_{field}" for joint in animation.armature.joints for field in fields)]
    with whole_file(path) as temporary, temporary.open("w", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for index, pose in enumerate(describe_poses(animation)):
            values = [str(value) for joint in zip(*pose.values(), strict=True) for part in joint for value in part]
            time = round(index / animation.fps, _MILLIONTHS)
            file.write(",".join([str(index), str(time), *values]) + "\n")


def describe_joints(armature: Armature, fps: float) -> dict[str, Any]:
    """Return `rig`, `fps`, `axes`, `quaternions` and `joints` of `write_json`."""
    rows = zip(armature.joints, armature.parents, _rounded(armature.offsets), _rounded(armature.rest), strict=True)
    return {
        "rig": armature.name,
        "fps": fps,
        "axes": _AXES,
        "quaternions": _QUATERNIONS,
        "joints": [dict(zip(("name", "parent", "offset", "rest"), row, strict=True)) for row in rows],
    }


def describe_poses(animation: Animation) -> Iterator[dict[str, list]]:
    """Yield `positions`, `directions` and `rotations` of each frame as in `write_json`, rounded to six decimals."""
    _, positions = world(animation)
    parents = np.array([max(parent, 0) for parent in animation.armature.parents])
    with progress_bar("writing frames", animation.num_frames, "frame", is_part=True) as bar:
        for start in range(0, animation.num_frames, _BLOCK):
            frames = slice(start, start + _BLOCK)
            bones = positions[frames] - positions[frames][:, parents]
            # A bone of length 0 has no direction; forward kinematics leaves rounding errors of it.
            bones = np.where(np.linalg.norm(bones, axis=-1, keepdims=True) > 1e-9, bones, 0.0)
            parts = (positions[frames], rotations.unit(bones), animation.rotations[frames])
            for pose in zip(*(_rounded(part) for part in parts), strict=True):
                yield dict(zip(("positions", "directions", "rotations"), pose, strict=True))
            bar.update(len(positions[frames]))


def _rounded(values: np.ndarray) -> list:
    return (np.round(values, _MILLIONTHS) + 0.0).tolist()


def write_smplx(
    path: str | pathlib.Path, animation: Animation, *, moves: bool = False, face: Mapping[str, np.ndarray] | None = None
) -> None:
    """Write an `.npz` file of the poses of an animation of the rig smplx, with the names of AMASS and BEAT2.

    Fields: `poses` (T, 165) float32, axis-angle vectors in radians of the 55 joints, each relative to its parent, with
    zero for the flat hand (flat_hand_mean=True); hips and legs are zero unless the motion has them, jaw and eyes are
    zero except for the jaw of `face`. `trans` (T, 3) float32 metres, zero unless the root moves, y up, facing +z.
    `betas` (16,) zero, the mean shape. `mocap_frame_rate` frames per second, `gender` "neutral", `surface_model_type`
    "smplx", `joint_names` (55,). `expressions` (T, n) and `arkit` (T, 52) of `face`, if it has them.
    """
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            **arrays_of(animation, moves=moves, face=face or {}),
            betas=np.zeros(_NUM_BETAS, np.float32),
            mocap_frame_rate=np.float64(animation.fps),
            gender=np.array("neutral"),
            surface_model_type=np.array("smplx"),
            joint_names=np.array(animation.armature.joints),
        )


def arrays_of(animation: Animation, *, moves: bool, face: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the arrays of `write_smplx` that change over time; the jaw of the face is in the poses."""
    vectors, frames = rotations.to_vector(animation.rotations), animation.num_frames
    if "jaw" in face:
        vectors[:, animation.armature.joint("jaw")] = face["jaw"]
    return {
        "poses": vectors.reshape(frames, -1).astype(np.float32),
        "trans": animation.translation.astype(np.float32) if moves else np.zeros((frames, 3), np.float32),
        **{name: values for name, values in face.items() if name != "jaw"},
    }

"""Reading of motion of any system as a `Motion`, whatever the file: the kind is found by its content.

| kind | file |
|---|---|
| own | `.npz` that `ha2g generate` or `Motion.save` wrote |
| BVH | `.bvh` of any skeleton that a joint map knows |
| SMPL-X | `.npz` in the layouts of `motion.readers.smplx_arrays`, `.npy` of joint positions |
| directions | `.npy` of direction vectors (T, 126), (T, 42, 3), (T, 27), (T, 9, 3), whole or less the mean |
| positions | `.npz` or `.json` with `positions` (T, J, 3), `fps` and `joint_names`; `.npy` (T, 43, 3) or (T, 10, 3) |

Nothing is unpickled, and sizes are checked before anything is unpacked.
"""

import os
import pathlib

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_MOTION_FPS, MIN_MOTION_FPS
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.content import SUFFIXES, read_content
from ha2g_jax.motion.readers.kinds import KINDS, Options, borders_of, find_kind
from ha2g_jax.skeleton import load_skeleton

__all__ = ["KINDS", "SUFFIXES", "borders_of", "find_skeleton", "read_motion"]


def read_motion(
    path: str | os.PathLike,
    *,
    skeleton: str | None = None,
    fps: float | None = None,
    source_fps: float | None = None,
    joint_map: str = joint_maps.AUTO,
) -> Motion:
    """Read the motion of a file of any kind.

    Args:
        path: path of the file.
        skeleton: skeleton of the result, "ted_expressive" or "ted_gesture"; by default the first that the file fits.
        fps: frames per second of the result; None keeps those of the file. A motion of our own keeps its rate.
        source_fps: frames per second of a file that does not say it; direction vectors have 15 by default.
        joint_map: names of the joints in the file: "auto", one of `joint_maps.MAPS` or the path of a YAML file.

    Returns:
        The motion; `meta["read_from"]` says of a file of others how it was read: "kind", "fps" of the file and more.

    Raises:
        UserError: the file cannot be read, is of no kind, or does not hold a motion.
    """
    path = pathlib.Path(path)
    if source_fps is not None and not MIN_MOTION_FPS <= source_fps <= MAX_MOTION_FPS:
        raise UserError(f"{source_fps:g} frames per second of the file; expected {MIN_MOTION_FPS} to {MAX_MOTION_FPS}")
    options = Options(fps, source_fps, joint_map)
    content = read_content(path)
    kind = find_kind(content)
    motion = kind.read(content, load_skeleton(skeleton or kind.find_skeleton(content, options)), options)
    try:
        motion.check()
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error
    return motion


def find_skeleton(path: str | os.PathLike, joint_map: str = joint_maps.AUTO) -> str:
    """Return the name of the first skeleton whose joints a file has.

    Raises:
        UserError: none of them, or the file cannot be read.
    """
    content = read_content(pathlib.Path(path))
    return find_kind(content).find_skeleton(content, Options(joint_map=joint_map))

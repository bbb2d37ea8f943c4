"""Export of a motion to files of other programs: metres (centimetres in BVH), y up, facing +z, with the left at +x."""

import dataclasses
import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.formats.fbx import find_blender
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.rigs import retarget

__all__ = ["FBX", "SUFFIXES", "choose_rig", "export"]

SUFFIXES = (".bvh", ".glb", ".vrma", ".json", ".csv", ".npz")
FBX = ".fbx"  # written by Blender

# Formats that do not take every rig. The first rig of a list replaces the default.
_RIGS = {".vrma": ("vrm",), ".npz": (rigs.OWN, "smplx")}


def export(motion: Motion, path: str | pathlib.Path, *, rig: str = rigs.OWN) -> None:
    """Write a motion to a file in the format that the suffix of the path names.

    `.bvh`, `.glb`, `.json`, `.csv` and `.fbx`, which needs Blender, take any rig. `.vrma` always has the rig vrm.
    `.npz` is the file of `Motion.save`, or with the rig smplx a file of SMPL-X poses. Pelvis, legs and position of the
    person are written if the motion has them, and its face only to `.npz`; the floor is at y = 0 except in SMPL-X. In
    `.glb` and `.vrma` the name and the length in seconds of the speech are "speech" and "duration" of `motion.meta`.
    The same motion gives the same bytes, except in `.fbx`. The file is written atomically.

    Args:
        path: file whose suffix is one of `SUFFIXES`, or `FBX`.
        rig: name of the rig whose joints the file has, one of `rigs.RIGS`.

    Raises:
        UserError: the suffix or the rig is unknown, the format does not take the rig, the motion is not valid (see
            `Motion.check`), there is no Blender for `FBX`, or the file cannot be written.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    target = choose_rig(path, rig)
    motion.check()
    if suffix == ".npz" and rig == rigs.OWN:
        motion.save(path)
        return
    animation = solver.animate(motion)
    if motion.lower is not None and suffix != ".npz":  # SMPL-X keeps the height that `trans` had
        floor = np.array([0.0, motion.lower.floor, 0.0])
        animation = dataclasses.replace(animation, translation=animation.translation - floor)
    animation = retarget(animation, target)
    from ha2g_jax.motion.formats import bvh, fbx, gltf, tables  # glTF's library takes a sixth of a second

    if suffix == ".bvh":
        bvh.write(path, animation)
    elif suffix == ".glb":
        gltf.write_glb(path, animation)
    elif suffix == FBX:
        fbx.write(path, animation)
    elif suffix == ".vrma":
        gltf.write_vrma(path, animation)
    elif suffix == ".json":
        tables.write_json(path, animation)
    elif suffix == ".csv":
        tables.write_csv(path, animation)
    else:
        tables.write_smplx(path, animation, moves=motion.lower is not None, face=motion.face)


def choose_rig(path: pathlib.Path, rig: str) -> rigs.Rig:
    """Return the rig of a file: the one of that name, or for `.vrma` vrm instead of the default.

    Raises:
        UserError: the suffix of the path or the rig is unknown, the format does not take the rig, or there is no
            Blender for `FBX`.
    """
    suffix = path.suffix.lower()
    if suffix not in (*SUFFIXES, FBX):
        found = suffix or "no suffix"
        raise UserError(f"cannot write {path.name}: {found}; expected one of {', '.join((*SUFFIXES, FBX))}")
    if suffix == FBX:
        find_blender()
    allowed = _RIGS.get(suffix, rigs.RIGS)
    target = rigs.load_rig(allowed[0] if rig == rigs.OWN and rig not in allowed else rig)
    if target.name not in allowed:
        raise UserError(f"{path.name} takes the rig {' or '.join(allowed)}, not {rig}; write .glb or .bvh")
    return target

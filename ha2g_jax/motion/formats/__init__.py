"""Files for other programs: one entry, `export`, and a module for each format.

Axes everywhere: y up, the figure faces +z, its left is +x. Metres, in BVH centimetres.
"""

import pathlib
from collections.abc import Callable
from typing import TYPE_CHECKING

from ha2g_jax.errors import UserError
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.formats import bvh, glb, smplx, tables, vrma

if TYPE_CHECKING:
    from ha2g_jax.motion.motion import Motion

__all__ = ["SUFFIXES", "export"]

# Suffix -> what writes (path, animation, facts about the speech).
_WRITERS: dict[str, Callable[..., None]] = {
    ".bvh": lambda path, animation, **_: bvh.write(path, animation),
    ".glb": lambda path, animation, **facts: glb.write(path, animation, **facts),
    ".vrma": lambda path, animation, **facts: vrma.write(path, animation, **facts),
    ".json": lambda path, animation, **_: tables.write_json(path, animation),
    ".csv": lambda path, animation, **_: tables.write_csv(path, animation),
    ".npz": lambda path, animation, **_: smplx.write(path, animation),
}
SUFFIXES = tuple(_WRITERS)


def export(
    motion: "Motion", path: str | pathlib.Path, *, rig: str = rigs.OWN, audio_seconds: float | None = None
) -> None:
    """Writes a motion for another program; the suffix of the name says in which format.

    `.bvh`, `.glb`, `.json` and `.csv` take any rig. `.vrma` is of the rig vrm, which need not be named. `.npz` is the
    motion itself, or with the rig smplx a file of SMPL-X poses. The same motion gives the same bytes, and the file is
    whole or not there.

    Args:
        motion: any motion of this package.
        path: where to.
        rig: one of `rigs.RIGS`.
        audio_seconds: length of the speech, noted in `.glb` and `.vrma`; by default what the motion says of itself.

    Raises:
        UserError: the format, the rig or both together are not known, the motion has values that are no motion, or
            the place cannot be written.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        found = suffix or "no suffix"
        raise UserError(f"cannot write {path.name}: {found}; expected one of {', '.join(SUFFIXES)}")
    if suffix == ".vrma" and rig == rigs.OWN:
        rig = "vrm"
    chosen = rigs.load_rig(rig)
    if suffix == ".vrma" and rig != "vrm":
        raise UserError(f"{path.name} takes the rig vrm, not {rig}; leave the rig out, or write .glb or .bvh")
    if suffix == ".npz" and rig not in (rigs.OWN, "smplx"):
        raise UserError(f"{path.name} takes the rig ha2g or smplx, not {rig}; write .glb or .bvh")
    solver.check(motion)
    if suffix == ".npz" and rig == rigs.OWN:
        motion.save(path)
        return
    animation: Animation = rigs.retarget(solver.animate(motion), chosen)
    seconds = motion.meta.get("duration", motion.num_frames / motion.fps) if audio_seconds is None else audio_seconds
    _WRITERS[suffix](path, animation, duration=seconds, audio_name=motion.meta.get("speech"))

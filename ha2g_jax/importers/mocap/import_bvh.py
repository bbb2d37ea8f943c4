"""Import of BVH motion capture with its audio and words as a corpus."""

import functools
import os
import pathlib

from ha2g_jax.data.import_report import Report
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.mocap.importing import FileMotion, import_files
from ha2g_jax.importers.mocap.options import ImportOptions
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.bvh_joints import read_motion
from ha2g_jax.motion.readers.recordings import find_recordings
from ha2g_jax.skeleton import load_skeleton

_SUFFIX = ".bvh"
_DEFAULTS = ImportOptions()


def import_bvh(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    options: ImportOptions = _DEFAULTS,
    *,
    joint_map: str = joint_maps.AUTO,
    unit: float | str = "auto",
) -> Report:
    """Write a corpus of one BVH file, or of all BVH files in a folder and its subfolders.

    See `recordings.find_recordings` for the audio and the transcript of each file, and `importing.import_files` for
    unusable files and for motion and audio of different lengths.

    Args:
        src: path of a .bvh file or of a folder.
        dst: folder to make.
        options: options of all motion capture formats.
        joint_map: "auto", "mixamo", "zeroeggs", "beat", "genea", "ha2g" or the path of a YAML file; see `joint_maps`.
        unit: metres in one unit of the file; "auto" uses the unit of the joint map, or else millimetres, centimetres,
            inches or metres by the length of the arms.

    Returns:
        The counts of what was kept and left out, which are also stored in the corpus under "import".

    Raises:
        UserError: there is no usable file, `dst` exists, or an option has an invalid value.
    """
    src = pathlib.Path(src)
    recordings = find_recordings(src, _SUFFIX, options)
    if joint_map != joint_maps.AUTO:
        joint_maps.load_map(joint_map)  # report an error of the map once, not for each file
    read = functools.partial(_read, options=options, joint_map=joint_map, unit=_to_metres(unit))
    name = shown(src.resolve().name)
    return import_files(recordings, read, dst, options, name=name, source=f"BVH files: {name}")


def _read(path: pathlib.Path, options: ImportOptions, joint_map: str, unit: float | None) -> FileMotion:
    motion = read_motion(path, load_skeleton(options.skeleton), fps=options.fps, joint_map=joint_map, unit=unit)
    description = f"joint map {motion.joint_map}, unit {motion.unit:g} m, {motion.up} up"
    return FileMotion(motion.positions, motion.seconds, description)


def _to_metres(unit: float | str) -> float | None:
    if unit == "auto":
        return None
    try:
        metres = float(unit)
    except ValueError:
        metres = 0.0
    if not 0 < metres < float("inf"):
        raise UserError(f"unit {str(unit)[:40]!r}; expected auto or metres, such as 0.01 for centimetres")
    return metres

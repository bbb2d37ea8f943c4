"""Imports BVH motion capture with its sound and words as a corpus."""

import functools
import os
import pathlib

from ha2g_jax.data.import_report import Report
from ha2g_jax.data.mocap import joint_maps
from ha2g_jax.data.mocap.importing import FileMotion, import_files
from ha2g_jax.data.mocap.motion import read_motion
from ha2g_jax.data.mocap.sources import find_sources
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton

_SUFFIX = ".bvh"


def import_bvh(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    *,
    joint_map: str = joint_maps.AUTO,
    skeleton: str = "ted_expressive",
    audio: str | os.PathLike | None = None,
    words: str | os.PathLike | None = None,
    speaker: str | None = None,
    split: str = "train",
    unit: float | str = "auto",
    fps: float = 15,
    with_words: bool = True,
    licence: str = "",
) -> Report:
    """Writes a corpus of one BVH file, or of all in a folder and below it, each with the sound and words beside it.

    For broken files, and motion and sound of different lengths, see `importing.import_files`.

    Args:
        src: a .bvh file, or a folder.
        dst: folder to make.
        joint_map: "auto", "mixamo", "zeroeggs", "beat" or the path of a YAML file; see `joint_maps`.
        skeleton: "ted_expressive", or "ted_gesture" for files without fingers.
        audio: the sound of the only file; any format of `read_audio`.
        words: the transcript of the only file.
        speaker: name of the speaker of all files; by default the folder of a file where `src` has subfolders, else the
            file's name.
        split: name of the split to write.
        unit: metres in one unit of the file; "auto" for what the map says, or else mm, cm, inch or m by the length of
            the arms.
        fps: frames per second of the corpus.
        with_words: whether a recording needs a transcript; without one, its windows need no words.
        licence: of the data, noted in the corpus.

    Returns:
        What was kept and left out; also in the corpus, under "import".

    Raises:
        UserError: no file, or none that can be used, or `dst` exists, or an option has no such value.
    """
    src = pathlib.Path(src)
    sources = find_sources(
        src,
        _SUFFIX,
        audio=None if audio is None else pathlib.Path(audio),
        words=None if words is None else pathlib.Path(words),
        speaker=speaker,
    )
    if joint_map != joint_maps.AUTO:
        joint_maps.load_map(joint_map)  # a fault of the map is said once, not for each file
    read = functools.partial(_read, skeleton=skeleton, fps=fps, joint_map=joint_map, unit=_to_metres(unit))
    name = src.resolve().name
    metadata = {"name": name, "source": f"BVH files: {name}", "licence": licence}
    return import_files(
        sources, read, dst, skeleton=skeleton, fps=fps, split=split, with_words=with_words, metadata=metadata
    )


def _read(path: pathlib.Path, skeleton: str, fps: float, joint_map: str, unit: float | None) -> FileMotion:
    motion = read_motion(path, load_skeleton(skeleton), fps=fps, joint_map=joint_map, unit=unit)
    understood = f"joint map {motion.joint_map}, unit {motion.unit:g} m, {motion.up} up"
    return FileMotion(motion.positions, motion.seconds, understood)


def _to_metres(unit: float | str) -> float | None:
    if unit == "auto":
        return None
    try:
        metres = float(unit)
    except ValueError:
        metres = 0.0
    if not 0 < metres < float("inf"):
        raise UserError(f"unit {unit!r}; expected auto or metres, such as 0.01 for centimetres")
    return metres

"""Import of motion capture, BVH and SMPL-X, with its audio and words as a corpus."""

import collections
import functools
import os
import pathlib
import re

from ha2g_jax.data.recording import Report
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.mocap.importing import FileMotion, ImportOptions, import_files
from ha2g_jax.limits import MAX_MOTION_FPS, MIN_MOTION_FPS
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.body import UPS
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.motion.readers.recordings import AUDIO_SUFFIXES, MotionRecording, find_embody, find_recordings
from ha2g_jax.motion.readers.smplx import AUTO, read_smplx
from ha2g_jax.motion.readers.smplx_arrays import SEAMLESS_NAME
from ha2g_jax.motion.readers.smplx_body import Body, read_body_model, template
from ha2g_jax.skeleton import load_skeleton

_TIMED_WORDS = ".textgrid"
# BEAT2 names a recording NUMBER_SPEAKER_..., and has separate folders for motion, audio and words.
_BEAT_NAME = re.compile(r"\d+_([A-Za-z]+)(_\d+){3}")
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
        joint_map: "auto", "mixamo", "zeroeggs", "beat", "genea", "ha2g" or the path of a file; see `joint_maps`.
        unit: metres in one unit of the file; "auto" uses the unit of the joint map, or else millimetres, centimetres,
            inches or metres by the length of the arms.

    Returns:
        The counts of what was kept and left out, which are also stored in the corpus under "import".

    Raises:
        UserError: there is no usable file, `dst` exists, or an option has an invalid value.
    """
    src = pathlib.Path(src)
    recordings = find_recordings(src, ".bvh", speaker=options.speaker, audio=options.audio, words=options.words)
    if joint_map != joint_maps.AUTO:
        joint_maps.load_map(joint_map)  # report an error of the map once, not for each file
    read = functools.partial(_read_bvh, options=options, joint_map=joint_map, unit=_to_metres(unit))
    name = shown(src.resolve().name)
    return import_files(recordings, read, dst, options, name=name, source=f"BVH files: {name}")


def _read_bvh(path: pathlib.Path, options: ImportOptions, joint_map: str, unit: float | None) -> FileMotion:
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


def import_smplx(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    options: ImportOptions = _DEFAULTS,
    *,
    model: str | os.PathLike | None = None,
    up: str = AUTO,
    source_fps: float | None = None,
) -> Report:
    """Write a corpus of one file of SMPL-X motion, or of all .npz files in a folder and its subfolders.

    Audio and words lie beside the motion and have its stem. If there are none, audio files and TextGrids of that stem
    are searched for in all of `src`, for the folders of BEAT2. In a folder of Embody 3D each person of a capture is a
    recording. See `smplx.read_smplx` for the formats, and `importing.import_files` for unusable files and for motion
    and audio of different lengths.

    Args:
        src: path of a .npz file, of a .npy file of joint positions, or of a folder.
        options: options of all motion capture formats. By default the speaker is taken from a file name of the form
            of BEAT2 or Seamless Interaction, else as described in `recordings.find_recordings`.
        model: path of an SMPL-X body model (.npz), for joints of the person's shape; None for the neutral template.
        up: axis of the files that points up, one of `body.UPS`, or "auto".
        source_fps: frames per second of the files; None uses the rate stored in each file.

    Returns:
        The counts of what was kept and left out, which are also stored in the corpus under "import".

    Raises:
        UserError: there is no usable file, `dst` exists, or an option has an invalid value.
    """
    src = pathlib.Path(src)
    if up not in (AUTO, *UPS):
        raise UserError(f"up {up!r}; expected {AUTO} or one of {', '.join(UPS)}")
    if source_fps is not None and not MIN_MOTION_FPS <= source_fps <= MAX_MOTION_FPS:
        raise UserError(f"{source_fps:g} frames per second of the files; expected {MIN_MOTION_FPS} to {MAX_MOTION_FPS}")
    recordings = find_embody(src, options.speaker) if src.is_dir() else []
    if recordings and (options.audio is not None or options.words is not None):
        raise UserError(f"{shown(src)} has captures of Embody 3D with their own sound; leave out --audio and --words")
    if not recordings:
        recordings = find_recordings(src, ".npz", speaker=options.speaker, audio=options.audio, words=options.words)
        if src.is_dir():
            recordings = _with_folders_of_beat(recordings, src)
        if options.speaker is None:
            recordings = [_with_speaker_of_name(recording) for recording in recordings]
    body = template() if model is None else read_body_model(model)
    read = functools.partial(_read_smplx, options=options, body=body, source_fps=source_fps, up=up)
    joints = "neutral template" if model is None else f"body model {shown(pathlib.Path(model).name)}"
    name = shown(src.resolve().name)
    return import_files(recordings, read, dst, options, name=name, source=f"SMPL-X files: {name}, {joints}")


def _read_smplx(
    path: pathlib.Path, options: ImportOptions, body: Body, source_fps: float | None, up: str
) -> FileMotion:
    skeleton = load_skeleton(options.skeleton)
    motion = read_smplx(path, skeleton, body, fps=options.fps, source_fps=source_fps, up=up)
    return FileMotion(motion.positions, motion.seconds, f"{motion.kind}, {motion.up} up", motion.is_good)


def _with_folders_of_beat(recordings: list[MotionRecording], root: pathlib.Path) -> list[MotionRecording]:
    """Add audio and words from other folders to the recordings, if exactly one file has the name."""
    found: dict[tuple[str, bool], list[pathlib.Path]] = collections.defaultdict(list)
    for path in sorted(root.rglob("*")):
        suffix = path.suffix.lower()
        if suffix in AUDIO_SUFFIXES or suffix == _TIMED_WORDS:
            found[path.stem, suffix == _TIMED_WORDS].append(path)

    def elsewhere(recording: MotionRecording, is_words: bool) -> pathlib.Path | None:
        paths = found[recording.path.stem, is_words]
        return paths[0] if len(paths) == 1 and paths[0].parent != recording.path.parent else None

    return [
        recording._replace(
            audio=recording.audio or elsewhere(recording, False), words=recording.words or elsewhere(recording, True)
        )
        for recording in recordings
    ]


def _with_speaker_of_name(recording: MotionRecording) -> MotionRecording:
    stem = recording.path.stem
    name = _BEAT_NAME.fullmatch(stem) or SEAMLESS_NAME.fullmatch(stem)
    return recording._replace(speaker=name.group(1)) if name else recording

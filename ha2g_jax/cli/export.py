"""The command `ha2g export`: arguments only. The suffix of the file decides what is written."""

import argparse
import collections
import dataclasses
import functools
import pathlib
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from ha2g_jax.cli.parser import add_reading, reading, refuse_others
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import resolved, shown
from ha2g_jax.files.writing import check_kept, do_each

if TYPE_CHECKING:
    import numpy as np

    from ha2g_jax.motion.motion import Motion

_FPS = 30  # frames per second at which motion of other programs is shown
_MOST_DIFFERENCE = 0.5  # seconds by which motion and sound may differ in length without a warning

# Options that have an effect, by the suffix of the file to write.
_OPTIONS = {
    ".mp4": ("audio", "names", "size", "camera", "fps"),
    ".html": ("audio", "words", "names", "camera"),
    ".png": ("words", "names", "size", "count"),
    ".svg": ("words", "names", "size", "count"),
    **dict.fromkeys((".glb", ".vrma"), ("rig", "audio")),
    **dict.fromkeys((".bvh", ".json", ".csv", ".npz", ".fbx"), ("rig",)),
}
_EVERY = sum(_OPTIONS.values(), ())


def add_commands(commands: Any) -> None:
    """Add `export` to the commands of a parser."""
    export = commands.add_parser("export", help="write motion for Blender, Unity, Unreal or a robot, as video or page")
    export.description = (
        "Write motion in the format that the suffix of the file names: .bvh, .glb, .vrma, .json, .csv or .npz for "
        "other programs; .fbx, for which Blender or bpy must be installed; .mp4, a video; .html, a page that shows the "
        "motion in a browser and works offline; .png or .svg, a figure of key frames, as in a paper. Video, page and "
        "figure take several motions, side by side. With --format each motion becomes a file in the folder OUT."
    )
    export.add_argument(
        "motions", type=pathlib.Path, nargs="+", metavar="MOTION", help="motion of ha2g or of other programs"
    )
    export.add_argument(
        "-o", "--out", type=pathlib.Path, required=True, help="file to write, or with --format a folder"
    )
    export.add_argument(
        "--format",
        metavar="SUFFIX",
        help="write each motion, or those of a folder, in this format, for example bvh; of files of one name in a "
        "folder, one is the motion: .npz before .bvh, .glb, .vrma, .json, .csv and .npy",
    )
    export.add_argument(
        "--rig", help="joints of the file: ha2g, mixamo, smplx, unity, unreal or vrm (default: ha2g; .vrma: vrm)"
    )
    export.add_argument(
        "--audio", type=pathlib.Path, help="the speech, for video and page; its length, for .glb and .vrma"
    )
    export.add_argument("--words", type=pathlib.Path, help="transcript or FILE#SPEAKER, for page and figure")
    export.add_argument(
        "--names", nargs="+", metavar="NAME", help="names of the motions (default: the names of the files)"
    )
    export.add_argument(
        "--size", metavar="WIDTHxHEIGHT", help="pixels of the video (1920x1080), or of a key frame, one number (240)"
    )
    add_camera(export)
    export.add_argument("--fps", type=float, help="frames per second of the video, 1 to 240 (default: 30)")
    export.add_argument("--count", type=int, help="number of key frames (default: 8)")
    add_reading(export)
    export.set_defaults(run=_export)


def add_camera(command: argparse.ArgumentParser) -> None:
    """Add the camera of videos and pages."""
    command.add_argument(
        "--camera",
        choices=("body", "close"),
        help="what video and page show: body, to the hips and lowest hands, or upper body and hands (default: body)",
    )


def _export(arguments: argparse.Namespace) -> None:
    if arguments.format is not None:
        _export_each(arguments, "." + arguments.format.lower().removeprefix("."))
        return
    if folders := [path for path in arguments.motions if path.is_dir()]:
        raise UserError(f"{shown(folders[0])} is a folder; name the format of its motions with --format")
    suffix = arguments.out.suffix.lower()
    if suffix not in _OPTIONS:
        raise UserError(
            f"cannot write {shown(arguments.out)}: {suffix or 'no suffix'}; expected one of {', '.join(_OPTIONS)}"
        )
    refuse_others(arguments, _OPTIONS[suffix], _EVERY, suffix)
    from ha2g_jax.features.words import split_speaker

    words = None if arguments.words is None else split_speaker(arguments.words)[0]
    check_kept(
        [arguments.out],
        [*arguments.motions, arguments.audio, words, _joint_map(arguments)],
    )
    from ha2g_jax.motion.readers import check_reading

    check_reading(arguments.motions, **reading(arguments))
    if "rig" in _OPTIONS[suffix]:
        _export_motion(arguments, suffix)
    elif suffix == ".mp4":
        _write_video(arguments)
    elif suffix == ".html":
        _write_page(arguments)
    else:
        _draw_key_frames(arguments)
    print(arguments.out)


def _joint_map(arguments: argparse.Namespace) -> pathlib.Path | None:
    return None if arguments.joint_map is None else pathlib.Path(arguments.joint_map)  # or a name, which is no result


def _export_motion(arguments: argparse.Namespace, suffix: str) -> None:
    from ha2g_jax.motion import formats, rigs
    from ha2g_jax.motion.readers import read_motion

    if len(arguments.motions) > 1:
        raise UserError(f"{suffix} holds one motion, not {len(arguments.motions)}; export them one by one")
    motion = read_motion(arguments.motions[0], **reading(arguments))
    if arguments.audio is not None:
        seconds = _seconds(_read_audio(arguments.audio))
        _compare_lengths({shown(arguments.motions[0].name): motion}, seconds)
        motion = dataclasses.replace(
            motion, meta=motion.meta | {"speech": shown(arguments.audio.name), "duration": seconds}
        )
    formats.export(motion, arguments.out, rig=arguments.rig or rigs.OWN)


def _export_each(arguments: argparse.Namespace, suffix: str) -> None:
    """Write the motions, and those in folders, to files of their names; failures are named and counted at the end."""
    from ha2g_jax.evaluation.motion_folders import list_motions
    from ha2g_jax.motion import formats, rigs
    from ha2g_jax.motion.readers import check_reading, read_motion

    kinds = [suffix for suffix, names in _OPTIONS.items() if "rig" in names]
    if suffix not in kinds:
        raise UserError(f"--format {shown(arguments.format)} is not a format of motion; expected {', '.join(kinds)}")
    if arguments.out.suffix.lower() in _OPTIONS or arguments.out.is_file():
        raise UserError(f"{shown(arguments.out)} would be a folder, for the motions in the format {suffix}")
    refuse_others(arguments, ("rig",), _EVERY, f"--format {suffix}")
    files = [path for path in arguments.motions if not path.is_dir()]
    tasks = dict(zip(names_of(files), files, strict=True))
    for name in map(pathlib.Path, tasks):
        if name.is_absolute() or ".." in name.parts:
            raise UserError(f"two motions would be written to {shown(name.stem)}{suffix}; export them one by one")
    for folder in (path for path in arguments.motions if path.is_dir()):
        for name, path in list_motions(folder).items():
            if (first := tasks.setdefault(name, path)) != path:
                two = f"{shown(first)} and {shown(path)} would both be written to"
                raise UserError(f"{two} {shown(path.stem)}{suffix}; export them one by one")
    outs = {arguments.out / f"{name}{suffix}": path for name, path in tasks.items()}
    check_kept(list(outs), [*outs.values(), _joint_map(arguments)])
    check_reading(list(outs.values()), **reading(arguments))
    rig = arguments.rig or rigs.OWN
    formats.choose_rig(next(iter(outs)), rig)

    def export(path: pathlib.Path, out: pathlib.Path) -> None:
        formats.export(read_motion(path, **reading(arguments)), out, rig=rig)
        tqdm.write(str(out))

    do_each("exporting", [(path, functools.partial(export, path, out)) for out, path in outs.items()])


def _write_video(arguments: argparse.Namespace) -> None:
    from ha2g_jax.motion.formats.video import write_video

    motions = _load(arguments)
    audio = _read_audio(arguments.audio) if arguments.audio else None
    if audio is not None:
        _compare_lengths(motions, _seconds(audio))
    write_video(
        arguments.out,
        _one_or_named(motions, arguments),
        audio,
        size=read_size(arguments.size or "1920x1080"),
        camera=arguments.camera or "body",
        fps=arguments.fps,
    )


def _write_page(arguments: argparse.Namespace) -> None:
    from ha2g_jax.features import words as transcripts
    from ha2g_jax.viewer import view

    motions, words, camera = _load(arguments), arguments.words, arguments.camera or "body"
    if arguments.audio is None:
        page = view(motions, words=transcripts.read_words(words) if words else (), camera=camera)
    else:
        audio = _read_audio(arguments.audio)
        _compare_lengths(motions, _seconds(audio))
        spoken = transcripts.words_of(audio, words, recognise=None, media=arguments.audio) if words else ()
        page = view(motions, audio, words=spoken, camera=camera)
    page.save(arguments.out)


def _draw_key_frames(arguments: argparse.Namespace) -> None:
    from ha2g_jax.features.words import read_words
    from ha2g_jax.motion.formats import keyframes

    size = read_size(arguments.size or "240")
    if not isinstance(size, int):
        raise UserError(f"the size of a key frame is one number of pixels, not {arguments.size}")
    motions = _load(arguments)
    words = read_words(arguments.words) if arguments.words else ()
    count = 8 if arguments.count is None else arguments.count
    keyframes.write(arguments.out, _one_or_named(motions, arguments), count=count, words=words, size=size)


def read_size(text: str) -> int | tuple[int, int]:
    """Parse the size of a video in pixels, WIDTHxHEIGHT such as "1920x1080", or one number for both.

    Raises:
        UserError: the text has another form.
    """
    size = re.fullmatch(r"(\d{1,5})(?:[xX×](\d{1,5}))?", text)
    if size is None:
        raise UserError(f"the size is '{shown(text)}'; give WIDTHxHEIGHT, such as 1920x1080, or one number")
    return (int(size[1]), int(size[2])) if size[2] else int(size[1])


def _load(arguments: argparse.Namespace) -> dict[str, "Motion"]:
    from ha2g_jax.motion.readers import read_motion

    paths, names = arguments.motions, arguments.names or names_of(arguments.motions)
    if len(names) != len(paths):
        raise UserError(f"{len(names)} names for {len(paths)} motions; give one each")
    names = [shown(name) for name in names]
    if len(set(names)) < len(names):
        raise UserError("two motions have the same name, as it is shown; give different names with --names")
    fps = max(_FPS, arguments.fps or 0)
    return {name: read_motion(path, fps=fps, **reading(arguments)) for name, path in zip(names, paths, strict=True)}


def names_of(paths: Sequence[pathlib.Path]) -> list[str]:
    """Choose a name for each file: its stem, with its folder where two are equal, then its suffix, or else its path.

    Raises:
        UserError: a file is given twice.
    """
    names = [path.stem for path in paths]
    for name in (
        lambda path: f"{resolved(path.parent).name}/{path.stem}",
        lambda path: f"{resolved(path.parent).name}/{path.name}",
        str,
    ):
        counts = collections.Counter(names)
        names = [old if counts[old] == 1 else name(path) for old, path in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        raise UserError(f"{shown(', '.join(map(str, paths)))} contains a motion twice; give each file once")
    return names


def _one_or_named(motions: dict[str, "Motion"], arguments: argparse.Namespace) -> "Motion | dict[str, Motion]":
    return motions if len(motions) > 1 or arguments.names else next(iter(motions.values()))


def _read_audio(path: pathlib.Path) -> "np.ndarray":
    from ha2g_jax.features.audio import read_audio

    return read_audio(path)


def _seconds(audio: "np.ndarray") -> float:
    from ha2g_jax.features.audio import SAMPLE_RATE

    return len(audio) / SAMPLE_RATE


def _compare_lengths(motions: dict[str, "Motion"], seconds: float) -> None:
    """Print a warning if the lengths differ: a shorter motion stands still at its end, and a longer one is cut."""
    from ha2g_jax.motion.readers.recordings import other_rate

    for name, motion in motions.items():
        length = motion.num_frames / motion.fps
        if abs(length - seconds) > _MOST_DIFFERENCE:
            rate = other_rate(length, motion.meta.get("read_from", {}).get("fps"), seconds)
            print(f"ha2g: {name} lasts {length:.1f} s, the sound {seconds:.1f} s{rate}", file=sys.stderr)

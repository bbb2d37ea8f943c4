"""The commands `ha2g export`, `ha2g video` and `ha2g keyframes`: arguments only."""

import argparse
import pathlib
import re
from typing import TYPE_CHECKING, Any

from ha2g_jax.cli.parser import add_reading
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import check_kept

if TYPE_CHECKING:
    import numpy as np

    from ha2g_jax.motion.motion import Motion

_MOST_DIFFERENCE = 0.5  # seconds by which motion and sound may differ in length without a warning


def add_commands(commands: Any) -> None:
    """Add the commands `export`, `video` and `keyframes` to a parser.

    Args:
        commands: subparsers of the parser of `ha2g`.
    """
    export = commands.add_parser("export", help="export motion for Blender, Unity, Unreal, three.js or a robot")
    export.add_argument("motion", type=pathlib.Path, metavar="MOTION", help="motion of ha2g or of others")
    add_reading(export)
    export.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        required=True,
        metavar="FILE",
        help="file to write; its suffix is the format: .bvh, .glb, .vrma, .json, .csv or .npz",
    )
    export.add_argument(
        "--rig",
        default="ha2g",
        help="joints of the file: ha2g, mixamo, smplx, unity, unreal, vrm or a new one of assets/rigs (default: ha2g)",
    )
    export.add_argument("--audio", type=pathlib.Path, help="the speech, whose length is stored in .glb and .vrma")
    export.set_defaults(run=_export)

    video = commands.add_parser("video", help="write an .mp4 of one motion, or of several side by side, with the sound")
    _add_motions(video)
    video.add_argument("--audio", type=pathlib.Path, help="the speech (default: a silent video)")
    video.add_argument("-o", "--out", type=pathlib.Path, required=True, metavar="FILE", help=".mp4 file to write")
    video.add_argument(
        "--size", default="1920x1080", metavar="WIDTHxHEIGHT", help="size in pixels (default: 1920x1080)"
    )
    video.add_argument("--workers", type=int, help="threads that draw and encode (default: one for each core)")
    video.set_defaults(run=_video)

    keyframes = commands.add_parser("keyframes", help="draw a figure of key frames with the words, as in a paper")
    _add_motions(keyframes)
    keyframes.add_argument(
        "-o", "--out", type=pathlib.Path, required=True, metavar="FILE", help=".png or .svg file to write"
    )
    keyframes.add_argument("--words", type=pathlib.Path, help="a transcript with times: TextGrid, JSON, SRT, VTT, TSV")
    keyframes.add_argument("--count", type=int, default=8, help="number of key frames (default: 8)")
    keyframes.add_argument("--size", type=int, default=240, help="side of each picture in pixels (default: 240)")
    keyframes.set_defaults(run=_keyframes)


def _add_motions(command: argparse.ArgumentParser) -> None:
    command.add_argument("motions", type=pathlib.Path, nargs="+", metavar="MOTION", help="motion of ha2g or of others")
    add_reading(command)
    command.add_argument(
        "--names", nargs="+", metavar="NAME", help="names of the motions (default: the names of the files)"
    )


def _export(arguments: argparse.Namespace) -> None:
    from ha2g_jax.motion import formats
    from ha2g_jax.motion.readers import read_motion

    check_kept([arguments.out], [arguments.motion, arguments.audio])
    motion = read_motion(arguments.motion, joint_map=arguments.joint_map, source_fps=arguments.source_fps)
    seconds = _seconds(_read_audio(arguments.audio)) if arguments.audio else None
    formats.export(motion, arguments.out, rig=arguments.rig, audio_seconds=seconds)
    print(arguments.out)


def _video(arguments: argparse.Namespace) -> None:
    from ha2g_jax.motion.video import write_video

    check_kept([arguments.out], [*arguments.motions, arguments.audio])
    if arguments.out.suffix.lower() != ".mp4":
        raise UserError(f"a video is written as .mp4; name it {arguments.out.stem}.mp4")
    if arguments.workers is not None and arguments.workers < 1:
        raise UserError(f"{arguments.workers} workers; give 1 or more")
    motions = _load(arguments)
    audio = _read_audio(arguments.audio) if arguments.audio else None
    if audio is not None:
        _compare_lengths(motions, _seconds(audio))
    write_video(
        arguments.out,
        motions if len(motions) > 1 or arguments.names else next(iter(motions.values())),
        audio,
        size=read_size(arguments.size),
        workers=arguments.workers,
    )
    print(arguments.out)


def _keyframes(arguments: argparse.Namespace) -> None:
    from ha2g_jax.features import words as transcripts
    from ha2g_jax.motion import keyframes

    check_kept([arguments.out], [*arguments.motions, arguments.words])
    motions = _load(arguments)
    words = transcripts.read_words(arguments.words) if arguments.words else ()
    keyframes.write(
        arguments.out,
        motions if len(motions) > 1 or arguments.names else next(iter(motions.values())),
        count=arguments.count,
        words=words,
        size=arguments.size,
    )
    print(arguments.out)


def read_size(text: str) -> int | tuple[int, int]:
    """Parse the size of a video.

    Args:
        text: WIDTHxHEIGHT in pixels, such as "1920x1080", or one number for both.

    Returns:
        Width and height in pixels, or the one number.

    Raises:
        UserError: the text has another form.
    """
    size = re.fullmatch(r"(\d{1,5})(?:[xX×](\d{1,5}))?", text)
    if size is None:
        raise UserError(f"the size is '{shown(text)}'; give WIDTHxHEIGHT, such as 1920x1080, or one number")
    return (int(size[1]), int(size[2])) if size[2] else int(size[1])


def _load(arguments: argparse.Namespace) -> dict[str, "Motion"]:
    """Load the motions by name; the names of files with equal names include their folders."""
    from ha2g_jax.viewer.files import names_of, read_shown

    paths, names = arguments.motions, arguments.names
    if names is None:
        names = names_of(paths)
    if len(names) != len(paths):
        raise UserError(f"{len(names)} names for {len(paths)} motions; give one each")
    if len(set(names)) < len(names):
        raise UserError("two motions have the same name; give different names with --names")
    options = {"joint_map": arguments.joint_map, "source_fps": arguments.source_fps}
    return {shown(name): read_shown(path, **options) for name, path in zip(names, paths, strict=True)}


def _read_audio(path: pathlib.Path) -> "np.ndarray":
    from ha2g_jax.features.audio import read_audio

    return read_audio(path)


def _seconds(audio: "np.ndarray") -> float:
    from ha2g_jax.features.audio import SAMPLE_RATE

    return len(audio) / SAMPLE_RATE


def _compare_lengths(motions: dict[str, "Motion"], seconds: float) -> None:
    """Print a warning where the lengths differ: a shorter motion stands still at its end, and a longer one is cut."""
    import sys

    for name, motion in motions.items():
        length = motion.num_frames / motion.fps
        if abs(length - seconds) > _MOST_DIFFERENCE:
            print(f"ha2g: {name} lasts {length:.1f} s, the sound {seconds:.1f} s", file=sys.stderr)

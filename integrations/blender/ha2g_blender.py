"""Loads a motion in Blender without a window, onto an armature or as a new figure, and writes the result.

    blender --background --python ha2g_blender.py -- motion.glb -o scene.blend
    blender --background --python ha2g_blender.py -- motion.glb --open character.fbx -o moving.fbx
    blender --background --python ha2g_blender.py -- motion.glb --audio speech.wav -o film.mp4

Also with the Python of the bpy wheel: python ha2g_blender.py -- motion.glb -o scene.blend
"""

import argparse
import importlib.util
import os
import pathlib
import re
import sys
from collections.abc import Callable

if importlib.util.find_spec("bpy") is None:
    print("ha2g_blender: no Blender here; run it with blender --background --python, or install bpy", file=sys.stderr)
    sys.exit(2)
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from ha2g_motion import bone_names, checks, keys, reading, scene
from ha2g_motion.motion import MotionError

_MIN_SIDE, _MAX_SIDE, _MAX_SAMPLES = 4, 65_536, 1 << 24  # of Blender, which takes another number as the nearest one


def main(argv: list[str]) -> int:
    """Run the script.

    Returns:
        Exit code: 0, or 2 for a mistake of the user.
    """
    arguments = _parser().parse_args(argv)
    try:
        _run(arguments)
    except MotionError as error:
        print(f"ha2g_blender: {error}", file=sys.stderr)
        return 2
    return 0


def _run(arguments: argparse.Namespace) -> None:
    import bpy

    suffix = arguments.out.suffix.lower()
    if suffix not in scene.OUTPUTS:
        raise MotionError(
            f"cannot write {checks.shown(arguments.out.name)}; expected one of {', '.join(scene.OUTPUTS)}"
        )
    opened = bpy.data.filepath or None
    for path in (arguments.motion, arguments.open, arguments.names, arguments.audio, opened):
        if path is not None and os.path.realpath(path) == os.path.realpath(arguments.out):
            raise MotionError(f"the result would overwrite {checks.shown(path)}; choose another path with --out")
    motion = reading.read_motion(arguments.motion)
    seconds = motion.num_frames / motion.fps
    if suffix == ".png" and not 0 <= arguments.time <= seconds:
        raise MotionError(
            f"no pose at {arguments.time:g} s (--time); {checks.shown(arguments.motion)} lasts {seconds:.2f} s"
        )
    humanoid: dict[str, str] = {}
    is_figure = arguments.open is None and arguments.rig is None and not bpy.data.filepath
    if arguments.open is not None:
        humanoid = scene.open_file(arguments.open)
    elif is_figure:
        scene.clear()
    stage = bpy.context.scene
    scene.set_time(stage, motion, start=arguments.start, keep_rate=arguments.keep_rate)
    place = {"start": arguments.start, "rate": scene.rate(stage)}
    if is_figure:
        armature = keys.make_figure(motion, **place)
    else:
        armature = scene.find_armature(arguments.rig)
        names = None if arguments.names is None else bone_names.read_names(arguments.names)
        used = keys.apply_motion(motion, armature, names=names, humanoid=humanoid, **place)
        print(f"{len(used)} bones of {armature.name} move")
    if arguments.audio is not None:
        scene.add_sound(stage, arguments.audio, arguments.start)
    scene.write(
        arguments.out,
        armature,
        size=arguments.size,
        samples=arguments.samples,
        engine=arguments.engine,
        seconds=arguments.time,
        start=arguments.start,
    )
    print(checks.shown(arguments.out))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="ha2g_blender", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("motion", type=pathlib.Path, help=f"a file of ha2g export: {', '.join(reading.SUFFIXES)}")
    parser.add_argument(
        "-o", "--out", type=pathlib.Path, required=True, help=f"file to write: {', '.join(scene.OUTPUTS)}"
    )
    parser.add_argument("--open", type=pathlib.Path, help=f"a character: {', '.join(scene.CHARACTERS)}")
    parser.add_argument("--rig", help="name of the armature to move, where the character has several")
    parser.add_argument("--names", type=pathlib.Path, help='JSON of your bone names: {"BONE": "JOINT"}')
    parser.add_argument("--audio", type=pathlib.Path, help="the speech, for the scene and an .mp4")
    parser.add_argument(
        "--start", type=_whole(0, scene.MAX_FRAME), default=0, help="frame of the first pose (default: 0)"
    )
    parser.add_argument("--keep-rate", action="store_true", help="keep the scene's frame rate, not the motion's")
    parser.add_argument(
        "--size",
        type=_size,
        default=(640, 640),
        metavar="WxH",
        help="size of images in pixels; one number for both (default: 640x640)",
    )
    parser.add_argument(
        "--samples", type=_whole(1, _MAX_SAMPLES), default=8, help="rays per pixel of Cycles (default: 8)"
    )
    parser.add_argument("--engine", default="CYCLES", help="CYCLES (default) or another render engine of Blender")
    parser.add_argument("--time", type=float, default=0.0, metavar="SECONDS", help="time of a .png (default: 0)")
    return parser


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})(?:[xX](\d{1,5}))?", text)
    size = (int(found[1]), int(found[2] or found[1])) if found else (0, 0)
    if not _MIN_SIDE <= min(size) <= max(size) <= _MAX_SIDE:
        raise argparse.ArgumentTypeError(
            f"{text[:40]!r} is not a size; give WxH or one number, {_MIN_SIDE} to {_MAX_SIDE} pixels"
        )
    return size


def _whole(least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not (re.fullmatch(r"\d{1,9}", text) and least <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from {least} to {most}")
        return int(text)

    return read


if __name__ == "__main__":
    own = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(own))

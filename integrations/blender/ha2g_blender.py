"""Loads a motion in Blender without a window, onto an armature or as a new figure, and writes the result.

    blender --background --python ha2g_blender.py -- motion.glb -o scene.blend
    blender --background --python ha2g_blender.py -- motion.glb --open character.fbx -o moving.fbx
    blender --background --python ha2g_blender.py -- motion.glb --audio speech.wav -o film.mp4

Also with the Python of the bpy wheel: python ha2g_blender.py -- motion.glb -o scene.blend
"""

import argparse
import importlib.util
import pathlib
import sys

if importlib.util.find_spec("bpy") is None:
    print("ha2g_blender: no Blender here; run it with blender --background --python, or install bpy", file=sys.stderr)
    sys.exit(2)
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from ha2g_motion import bone_names, checks, keys, reading, scene
from ha2g_motion.motion import MotionError


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
    motion = reading.read_motion(arguments.motion)
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
    parser.add_argument("--start", type=int, default=0, help="frame of the first pose (default: 0)")
    parser.add_argument("--keep-rate", action="store_true", help="keep the scene's frame rate, not the motion's")
    parser.add_argument(
        "--size", type=_size, default=(640, 640), metavar="WxH", help="size of images in pixels (default: 640x640)"
    )
    parser.add_argument("--samples", type=int, default=8, help="rays per pixel of Cycles (default: 8)")
    parser.add_argument("--engine", default="CYCLES", help="CYCLES (default) or another render engine of Blender")
    parser.add_argument("--time", type=float, default=0.0, metavar="SECONDS", help="time of a .png (default: 0)")
    return parser


def _size(text: str) -> tuple[int, int]:
    width, height = (int(part) for part in text.lower().split("x"))
    return width, height


if __name__ == "__main__":
    own = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(own))

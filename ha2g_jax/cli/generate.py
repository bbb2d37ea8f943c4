"""The commands `ha2g generate` and `speakers`: arguments only; each calls one function of the package."""

import argparse
import dataclasses
import json
import pathlib
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from ha2g_jax.cli.export import add_camera, read_size
from ha2g_jax.cli.parser import MODEL, read_seed, refuse_others
from ha2g_jax.progress import stage

if TYPE_CHECKING:
    from ha2g_jax.motion.control import Controls
    from ha2g_jax.synthesis import Style


def add_commands(commands: Any) -> None:
    """Add `generate` and `speakers` to the commands of a parser."""
    command = commands.add_parser("generate", help="generate motion and a video from speech files")
    command.description = "Generate motion from speech files, and write it in one format, or as motion and video."
    command.add_argument(
        "speech",
        type=pathlib.Path,
        nargs="+",
        metavar="SPEECH",
        help="audio or video file with sound; several files, or a folder, whose files with sound are taken",
    )
    command.add_argument(
        "-o",
        "--out",
        help="file to write; its suffix is the format: .mp4, .html, .bvh, .glb, .fbx (by Blender), .vrma, .json, .csv "
        "or .npz; a name without a suffix for OUT.npz and OUT.mp4; for several files, a folder (default: "
        "SPEECH_gestures.npz and .mp4, beside the speech)",
    )
    command.add_argument(
        "--format", metavar="SUFFIX", help="write this format where OUT names none, for example bvh (default: npz, mp4)"
    )
    command.add_argument("--rig", help="joints of .bvh, .glb, .json, .csv or .npz, as of ha2g export (default: ha2g)")
    command.add_argument(
        "--checkpoint",
        default="demo",
        help=f"{MODEL}, or an .onnx of ha2g model onnx (default: demo)",
    )
    command.add_argument(
        "--backend",
        choices=("jax", "onnx"),
        help="what computes the motion: onnx starts in under a second; it takes an .onnx, 'demo' or a model folder "
        "(default: onnx for an .onnx, else jax)",
    )
    command.add_argument("--seed", type=read_seed, default=0, help="seed of all random choices (default: 0)")
    command.add_argument(
        "--takes",
        type=int,
        default=1,
        metavar="N",
        help="make N takes, with the seeds SEED, SEED+1 and so on, each in its own files, and a page to choose from",
    )
    command.add_argument(
        "--fps",
        type=float,
        help="frames per second of motion and video, 1 to 240 (default: the model's, 30 in a video)",
    )
    command.add_argument(
        "--words",
        type=pathlib.Path,
        help="transcript, or FILE#SPEAKER, for a model or cues with words and for .html (default: that of the speech)",
    )
    command.add_argument(
        "--size", metavar="WIDTHxHEIGHT", help="pixels of the video; one number for both (default: 720)"
    )
    add_camera(command)
    add_style(command)
    _add_controls(command)
    command.set_defaults(run=run)

    speakers = commands.add_parser("speakers", help="list the speakers of a model, and how they move, if known")
    speakers.description = "List the speakers of a model, which ha2g generate takes as --speaker and --style."
    speakers.add_argument("--checkpoint", default="demo", help=f"{MODEL} (default: demo)")
    speakers.add_argument("--json", action="store_true", help="print JSON instead of a table")
    speakers.set_defaults(run=_list_speakers)


STYLE = ("speaker", "style", "reference_image", "style_seed", "variation")
"""Options of `add_style`."""


def add_style(command: argparse.ArgumentParser) -> None:
    """Add the arguments that `read_style` reads."""
    group = command.add_argument_group("style of the motion")
    style = group.add_mutually_exclusive_group()
    style.add_argument("--speaker", help="name of a speaker of the training data")
    style.add_argument("--style", metavar="A:0.3,B:0.7", help="mixture of speakers, with weights")
    style.add_argument("--reference-image", type=pathlib.Path, nargs="+", metavar="PNG", help="images of a person")
    style.add_argument("--style-seed", type=read_seed, help="draw a random style with this seed")
    group.add_argument(
        "--variation",
        type=float,
        help="how much another --seed changes the style of a speaker or of images, 0 to 2 (default: 0.3)",
    )


def _add_controls(command: argparse.ArgumentParser) -> None:
    controls = command.add_argument_group(
        "control of the motion",
        "Times are in seconds. The transitions before and after a pose or a mute take half a second each.",
    )
    add_amounts(controls)
    controls.add_argument(
        "--seed-pose", type=pathlib.Path, metavar="NPZ", help="motion whose last frames are continued"
    )
    controls.add_argument(
        "--pin",
        action="append",
        default=[],
        metavar="START:END:POSE",
        help="hold a pose, or pass through it if END is START; POSE is MOTION.npz, MOTION.npz@SECONDS or rest",
    )
    controls.add_argument(
        "--mute", action="append", default=[], metavar="START:END", help="no gestures: only trunk and head move"
    )
    controls.add_argument(
        "--cues",
        type=pathlib.Path,
        metavar="FILE",
        help="gestures on demand, such as a nod or three fingers, at times or on words: lines of JSON in a .jsonl, or "
        "[nod] before a word of an .srt or .vtt",
    )
    controls.add_argument(
        "--smooth", type=float, default=0.0, metavar="SECONDS", help="average poses over a window of this length"
    )


def add_amounts(controls: Any) -> None:
    """Add the arguments that `read_amounts` reads to a group."""
    controls.add_argument(
        "--energy", type=float, default=1.0, help="speed of the motion, 0 to 2: 0 a slow drift, 1 unchanged"
    )
    controls.add_argument(
        "--extent", type=float, default=1.0, help="size of the gestures, 0 to 2: 0 at rest, 1 unchanged"
    )
    controls.add_argument(
        "--handedness", choices=("left", "right", "both"), default="both", help="the other arm rests (default: both)"
    )
    controls.add_argument("--mirror", action="store_true", help="exchange left and right")


def read_style(arguments: argparse.Namespace) -> "Style":
    """Return the style that the arguments of `add_style` request."""
    from ha2g_jax import synthesis

    if not {"speaker", "style", "reference_image"} & arguments.given:
        refuse_others(arguments, (), ("variation",), "a random style, but to that of a speaker or of images")
    style = synthesis.Style(
        speaker=arguments.speaker,
        mixture=None if arguments.style is None else synthesis.read_mixture(arguments.style),
        images=arguments.reference_image,
        seed=arguments.style_seed,
    )
    return style if arguments.variation is None else style._replace(variation=arguments.variation)


def read_amounts(arguments: argparse.Namespace) -> "Controls":
    """Return the controls that the arguments of `add_amounts` request."""
    from ha2g_jax.motion import control

    return control.Controls(
        energy=arguments.energy, extent=arguments.extent, handedness=arguments.handedness, mirror=arguments.mirror
    )


def run(arguments: argparse.Namespace) -> None:
    """Generate the files that the arguments request, and print their paths."""
    with stage("starting"):
        from ha2g_jax.apps.generate import generate_files
        from ha2g_jax.motion import control
        from ha2g_jax.motion.cues.reading import read_cues

    media = arguments.speech[0] if len(arguments.speech) == 1 else None
    controls = dataclasses.replace(
        read_amounts(arguments),
        pins=tuple(control.read_pin(pin) for pin in arguments.pin),
        mutes=tuple(control.read_mute(mute) for mute in arguments.mute),
    )
    generate_files(
        arguments.speech,
        out=arguments.out,
        checkpoint=arguments.checkpoint,
        backend=arguments.backend,
        rig=arguments.rig,
        suffix=None if arguments.format is None else "." + arguments.format.lower().removeprefix("."),
        style=read_style(arguments),
        seed=arguments.seed,
        seed_pose=arguments.seed_pose,
        fps=arguments.fps,
        smoothing=arguments.smooth,
        controls=controls,
        cues=() if arguments.cues is None else read_cues(arguments.cues, media),
        words=arguments.words,
        size=None if arguments.size is None else read_size(arguments.size),
        camera=arguments.camera,
        takes=arguments.takes,
        report=_print_path,
    )


def _print_path(path: pathlib.Path) -> None:
    """Print the path of a file that is complete, above a progress bar on the same terminal."""
    with tqdm.external_write_mode():
        print(path, flush=True)


def _list_speakers(arguments: argparse.Namespace) -> None:
    with stage("loading the model"):
        from ha2g_jax.evaluation import speakers

        rows = speakers.describe_speakers(arguments.checkpoint)
    print(json.dumps(rows, indent=1) if arguments.json else speakers.speakers_as_table(rows))

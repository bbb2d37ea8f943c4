"""The `ha2g generate` command: arguments only; it calls one function of the package."""

import argparse
import pathlib
from typing import Any

from ha2g_jax.cli.export import read_size


def add_command(commands: Any) -> None:
    """Adds `generate` to the commands of a parser."""
    command = commands.add_parser("generate", help="motion and a video from a speech file")
    command.add_argument("speech", type=pathlib.Path, help="any audio or video file with sound")
    command.add_argument("-o", "--out", type=pathlib.Path, help="OUT.npz and OUT.mp4 (default: beside the speech)")
    command.add_argument("--checkpoint", default="demo", help="'demo', a workdir or a model folder")
    command.add_argument("--seed", type=int, default=0, help="seed of everything random")
    command.add_argument("--fps", type=float, help="frames per second of the motion, 1 to 240 (default: the model's)")
    command.add_argument("--words", type=pathlib.Path, help="a transcript, for a baseline that reads words")
    command.add_argument(
        "--size", default="720", metavar="WIDTHxHEIGHT", help="pixels of the video; one number for both (default: 720)"
    )
    _add_style(command)
    _add_controls(command)
    command.set_defaults(run=run)


def _add_style(command: argparse.ArgumentParser) -> None:
    style = command.add_argument_group("who moves").add_mutually_exclusive_group()
    style.add_argument("--speaker", help="a speaker of the training data")
    style.add_argument("--style", metavar="A:0.3,B:0.7", help="a mixture of speakers")
    style.add_argument("--reference-image", type=pathlib.Path, nargs="+", metavar="PNG", help="frames of the speaker")
    style.add_argument("--style-seed", type=int, help="draw a style from the prior with this seed")


def _add_controls(command: argparse.ArgumentParser) -> None:
    controls = command.add_argument_group(
        "control of the motion",
        "Times are in seconds; a motion leaves for a pose half a second before and returns in as much.",
    )
    controls.add_argument("--energy", type=float, default=1.0, help="0 still, 1 as it is, 2 twice as lively")
    controls.add_argument("--extent", type=float, default=1.0, help="0 at rest, 1 as it is, 2 twice as large")
    controls.add_argument(
        "--handedness", choices=("left", "right", "both"), default="both", help="the other arm rests (default: both)"
    )
    controls.add_argument("--mirror", action="store_true", help="what the left hand does, the right hand does")
    controls.add_argument("--seed-pose", type=pathlib.Path, metavar="NPZ", help="a motion to go on from")
    controls.add_argument(
        "--pin",
        action="append",
        default=[],
        metavar="START:END:POSE",
        help="hold a pose, or pass through it where END is START; POSE is MOTION.npz, MOTION.npz@SECONDS or rest",
    )
    controls.add_argument(
        "--mute", action="append", default=[], metavar="START:END", help="no gestures: the arms rest, the head goes on"
    )
    controls.add_argument(
        "--smooth", type=float, default=0.0, metavar="SECONDS", help="average poses over a window of so many seconds"
    )


def run(arguments: argparse.Namespace) -> None:
    """Generates what the arguments ask for and prints the paths of the files."""
    from ha2g_jax import synthesis
    from ha2g_jax.motion import control

    controls = control.Controls(
        energy=arguments.energy,
        extent=arguments.extent,
        handedness=arguments.handedness,
        mirror=arguments.mirror,
        pins=tuple(control.read_pin(pin) for pin in arguments.pin),
        mutes=tuple(control.read_mute(mute) for mute in arguments.mute),
    )
    style = synthesis.Style(
        speaker=arguments.speaker,
        mixture=synthesis.read_mixture(arguments.style) if arguments.style else None,
        images=arguments.reference_image,
        seed=arguments.style_seed,
    )
    paths = synthesis.generate_files(
        arguments.speech,
        out=arguments.out,
        checkpoint=arguments.checkpoint,
        style=style,
        seed=arguments.seed,
        seed_pose=arguments.seed_pose,
        fps=arguments.fps,
        smoothing=arguments.smooth,
        controls=controls,
        words=arguments.words,
        size=read_size(arguments.size),
    )
    for path in paths:
        print(path)

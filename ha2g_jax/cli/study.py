"""The `ha2g study` commands: arguments only."""

import argparse
import pathlib
from typing import Any

from ha2g_jax.cli import study_analysis
from ha2g_jax.cli.parser import add_reading, read_seed
from ha2g_jax.cli.values import positive

_PARTS = ("rating", "preference", "mismatch")


def add_command(commands: Any) -> None:
    """Add the group `study` to the commands of a parser."""
    study = commands.add_parser("study", help="ask people about motion: make a study, analyse its answers")
    study.description = "Studies in which people watch motion in a browser and judge it; see docs/user_study.md."
    parts = study.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_make(parts)
    study_analysis.add_commands(parts)


def _add_make(commands: Any) -> None:
    make = commands.add_parser("make", help="write the site of a study, and the key that says what it shows")
    make.description = (
        "Write a folder with site/, which any static host can serve, and key.json, which is not published: it says "
        "which video is which system."
    )
    make.add_argument(
        "motions", nargs="+", metavar="MOTIONS", help="folder of motion of each system, as DIR or NAME=DIR"
    )
    make.add_argument(
        "-o", "--out", type=pathlib.Path, default=pathlib.Path("study"), help="folder to write (default: study)"
    )
    make.add_argument(
        "--speech", type=pathlib.Path, metavar="DIR", help="folder of the sounds (default: beside the motion)"
    )
    make.add_argument(
        "--protocol",
        nargs="+",
        choices=_PARTS,
        default=[_PARTS[0]],
        help="rating: naturalness, smoothness and synchrony from 1 to 5; preference: two systems on one clip; "
        "mismatch: motion with its own or with other speech (default: rating)",
    )
    make.add_argument("--clips", type=positive, metavar="N", help="number of clips, drawn at random (default: all)")
    make.add_argument("--clip-seconds", type=float, metavar="S", help="length to which longer clips are cut")
    make.add_argument(
        "--per-participant",
        type=positive,
        default=24,
        metavar="N",
        help="items of each part that a participant answers at most (default: 24)",
    )
    make.add_argument(
        "--attention", type=int, default=2, metavar="N", help="attention checks of each participant (default: 2)"
    )
    texts = make.add_argument_group("pages")
    texts.add_argument("--title", help="title that participants see")
    texts.add_argument(
        "--consent", type=pathlib.Path, metavar="FILE", help="text that participants agree to (default: a short one)"
    )
    texts.add_argument(
        "--closing", type=pathlib.Path, metavar="FILE", help="text at the end, such as a completion code"
    )
    texts.add_argument(
        "--post", metavar="URL", help="https:// address that answers are sent to (default: participants save a file)"
    )
    texts.add_argument("--size", type=positive, default=480, metavar="PIXELS", help="side of the videos (default: 480)")
    reading = make.add_argument_group("reading")
    add_reading(reading)
    make.add_argument(
        "--seed", type=read_seed, help="seed of all choices; keep it private (default: drawn, and noted in key.json)"
    )
    make.set_defaults(run=_make)


def _make(arguments: argparse.Namespace) -> None:
    from ha2g_jax.apps.user_study.make import make_study

    names = ("speech", "protocol", "clips", "clip_seconds", "per_participant", "attention", "consent", "closing")
    names += ("post", "size", "joint_map", "source_fps", "seed")
    options = {name: getattr(arguments, name) for name in names}
    if arguments.title is not None:
        options["title"] = arguments.title
    print(make_study(arguments.motions, arguments.out, **options))

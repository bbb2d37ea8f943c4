"""The `ha2g view` command: arguments only."""

import argparse
import pathlib
from typing import Any

from ha2g_jax.cli.parser import add_reading


def add_command(commands: Any) -> None:
    """Add the command `view` to a parser.

    Args:
        commands: subparsers of the parser of `ha2g`.
    """
    view = commands.add_parser("view", help="write a page that shows motion in a browser and works offline")
    view.add_argument(
        "motion", type=pathlib.Path, nargs="+", help="motion of ha2g or of others; several are side by side"
    )
    add_reading(view)
    view.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        default=pathlib.Path("view.html"),
        help=".html file to write (default: view.html)",
    )
    view.add_argument("--audio", type=pathlib.Path, help="any audio or video file with the sound")
    view.add_argument("--words", type=pathlib.Path, help="a transcript, shown below the waveform")
    view.set_defaults(run=_view)


def _view(arguments: argparse.Namespace) -> None:
    from ha2g_jax.viewer.files import view_files

    options = {"joint_map": arguments.joint_map, "source_fps": arguments.source_fps}
    print(view_files(arguments.motion, arguments.out, audio=arguments.audio, words=arguments.words, **options))

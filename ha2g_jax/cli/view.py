"""The `ha2g view` command: arguments only."""

import argparse
import pathlib
from typing import Any


def add_command(commands: Any) -> None:
    """Add `view` to the commands of a parser."""
    view = commands.add_parser("view", help="motion in a browser: one page that works offline")
    view.add_argument(
        "motion", type=pathlib.Path, nargs="+", help=".npz of ha2g generate, or .bvh; several stand side by side"
    )
    view.add_argument("-o", "--out", type=pathlib.Path, default=pathlib.Path("view.html"), help="default: view.html")
    view.add_argument("--audio", type=pathlib.Path, help="any audio or video file with sound")
    view.add_argument("--words", type=pathlib.Path, help="a transcript, shown under the sound")
    view.set_defaults(run=_view)


def _view(arguments: argparse.Namespace) -> None:
    from ha2g_jax.viewer.files import view_files

    print(view_files(arguments.motion, arguments.out, audio=arguments.audio, words=arguments.words))

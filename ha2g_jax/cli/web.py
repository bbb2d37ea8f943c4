"""The command `ha2g web`: arguments only; it calls one function of the package."""

import argparse
import pathlib
from typing import Any


def add_command(commands: Any) -> None:
    """Add `web` to the commands of a parser."""
    web = commands.add_parser("web", help="write a site that generates gestures in the browser, without a server")
    web.description = (
        "Write a folder with a page, its scripts and a model, which any static host can serve. Node.js builds the "
        "scripts once, for which npm needs the network; docs/web.md says how to publish the folder."
    )
    web.add_argument(
        "checkpoint",
        nargs="?",
        default="demo",
        help="'demo', a workdir of ha2g train, a checkpoint in it, or a model folder (default: demo)",
    )
    web.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        default=pathlib.Path("site"),
        metavar="FOLDER",
        help="folder to write; a site that is there is replaced (default: site)",
    )
    web.add_argument(
        "--weights",
        choices=("float32", "float16", "int8"),
        default="float32",
        help="form of the weights in the file of the model; docs/web.md has sizes and times (default: float32)",
    )
    web.add_argument("--license", default="", metavar="TEXT", help="licence of the model, which the page shows")
    web.set_defaults(run=_web)


def _web(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.onnx import reading

    reading.check_extra("onnx")
    from ha2g_jax.apps.web import write_site

    print(write_site(arguments.checkpoint, arguments.out, weights=arguments.weights, license=arguments.license))

"""The commands `ha2g serve` and `web`: arguments only; each calls one function of the package."""

import argparse
import os
import pathlib
from collections.abc import Callable
from typing import Any

from ha2g_jax.apps.serve.settings import Settings
from ha2g_jax.cli.model import add_weights
from ha2g_jax.cli.parser import MODEL, positive

_DEFAULT = Settings()
_MEBIBYTE = 1 << 20
_LIMITS: dict[str, tuple[Callable[[str], float], str]] = {
    "sessions": (positive, "streams at a time"),
    "requests": (positive, "requests for motion at a time"),
    "rate": (float, "requests per minute from one client, 0 for any number"),
    "max_seconds": (float, "seconds of sound of a request"),
    "session_seconds": (float, "seconds that a stream may last"),
    "idle_seconds": (float, "seconds without a message that end a stream"),
    "grace": (float, "seconds for running requests after SIGTERM"),
}


def add_commands(commands: Any) -> None:
    """Add `serve` and `web` to the commands of a parser."""
    serve = commands.add_parser("serve", help="answer requests for motion over HTTP and WebSocket")
    serve.description = (
        "Answer requests for motion over HTTP (POST /v1/motion) and streams over WebSocket (/v1/stream); see "
        "docs/serving.md. SIGTERM ends it when the running requests are done."
    )
    serve.add_argument("--checkpoint", default="demo", help=f"{MODEL} (default: demo)")
    serve.add_argument("--host", default=_DEFAULT.host, help="address to listen at (default: this machine only)")
    serve.add_argument("--port", type=int, default=_DEFAULT.port, help="port, 0 for a free one (default: %(default)g)")
    serve.add_argument(
        "--token",
        help="secret that requests must have, needed for a --host that other machines reach (default: the variable "
        "HA2G_TOKEN, which other users of the machine do not see)",
    )
    serve.add_argument(
        "--origin",
        action="append",
        default=[],
        metavar="URL",
        help="host to answer to, or other web page that may use it",
    )
    serve.add_argument(
        "--workers", type=positive, default=_DEFAULT.workers, help="processes, one for each core (default: %(default)g)"
    )
    limits = serve.add_argument_group("limits", "Each worker has these limits; N workers take N times as much.")
    for name, (kind, text) in _LIMITS.items():
        default = getattr(_DEFAULT, name)
        option = f"--{name.replace('_', '-')}"
        limits.add_argument(option, type=kind, default=default, help=f"{text} (default: %(default)g)")
    limits.add_argument(
        "--max-mebibytes",
        type=positive,
        default=_DEFAULT.max_bytes // _MEBIBYTE,
        help="size of a file (default: %(default)g)",
    )
    serve.set_defaults(run=_serve)

    web = commands.add_parser("web", help="write a site that generates gestures in the browser, without a server")
    web.description = (
        "Write a folder with a page, its scripts and a model, which any static host can serve. Node.js builds the "
        "scripts once, for which npm needs the network; docs/web.md says how to publish the folder."
    )
    web.add_argument("checkpoint", nargs="?", default="demo", help=f"{MODEL} (default: demo)")
    web.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        default=pathlib.Path("site"),
        metavar="FOLDER",
        help="folder to write; an existing site is replaced (default: site)",
    )
    add_weights(web)
    web.set_defaults(run=_web)


def _serve(arguments: argparse.Namespace) -> None:
    from ha2g_jax.apps import serve

    settings = serve.Settings(
        host=arguments.host,
        port=arguments.port,
        token=arguments.token or os.environ.get("HA2G_TOKEN") or None,
        origins=tuple(arguments.origin),
        workers=arguments.workers,
        max_bytes=arguments.max_mebibytes * _MEBIBYTE,
        **{name: getattr(arguments, name) for name in _LIMITS},
    )
    serve.serve(arguments.checkpoint, settings)


def _web(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.onnx.reading import BY
    from ha2g_jax.errors import require

    require("onnx", "onnx", by=BY)
    from ha2g_jax.apps.web.site import write_site

    print(write_site(arguments.checkpoint, arguments.out, weights=arguments.weights, license=arguments.license))

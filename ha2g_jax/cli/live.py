"""The command `ha2g live`: arguments only; it calls one function of the package."""

import argparse
import contextlib
import json
import signal
import sys
from typing import Any

from ha2g_jax.cli import generate
from ha2g_jax.cli.parser import MODEL, read_seed, refuse_others
from ha2g_jax.motion.states import STATES
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD
from ha2g_jax.progress import stage


def add_commands(commands: Any) -> None:
    """Add `live` to the commands of a parser."""
    command = commands.add_parser("live", help="generate motion while someone speaks, and send it to other programs")
    command.description = (
        "Generate motion for sound while it is heard, and send each frame at its time, until the sound ends or Ctrl-C. "
        "docs/live.md describes the messages, and receivers in Unity, Unreal, Blender, Godot and browsers."
    )
    command.add_argument(
        "--source",
        required=True,
        metavar="SOURCE",
        help="a file with sound, heard in real time; stdin, a WAV or raw PCM (16 bits, little-endian, mono); "
        "microphone; or ws://HOST:PORT to listen on, for a program that sends such sound as binary messages",
    )
    command.add_argument(
        "--sink",
        action="append",
        required=True,
        metavar="SINK",
        help="vmc://HOST:PORT, the VMC protocol (port 39539 by default); udp://HOST:PORT, JSON; ws://HOST:PORT to "
        "listen on, JSON for pages that connect; or a file .npz, written at the end; give several for several sinks",
    )
    command.add_argument("--checkpoint", default="demo", help=f"{MODEL} (default: demo)")
    command.add_argument(
        "--rate", type=int, metavar="HZ", help="samples per second of PCM (default: 16000, or those of the microphone)"
    )
    command.add_argument(
        "--channels",
        type=int,
        choices=(1, 2),
        default=1,
        help="2: the left channel is the agent, the right one the person that the agent listens to (default: 1)",
    )
    command.add_argument("--fast", action="store_true", help="take a file as fast as it is computed, not in real time")
    command.add_argument(
        "--delay",
        type=float,
        metavar="SECONDS",
        help="seconds from a moment of the sound to its frame, if you play the sound that much later (default: the "
        "least, (look-ahead + hop) / 15 for a model of 15 frames per second)",
    )
    command.add_argument(
        "--fps",
        type=int,
        help="frames per second that are sent, up to 120; others are interpolated (default: the model's)",
    )
    command.add_argument(
        "--look-ahead",
        type=int,
        default=DEFAULT_LOOK_AHEAD,
        metavar="FRAMES",
        help=f"frames of sound that a frame may use after its time (default: {DEFAULT_LOOK_AHEAD})",
    )
    command.add_argument(
        "--hop",
        type=int,
        default=DEFAULT_HOP,
        metavar="FRAMES",
        help=f"frames computed at once (default: {DEFAULT_HOP})",
    )
    command.add_argument("--seed", type=read_seed, default=0, help="seed of all random choices (default: 0)")
    command.add_argument("--rig", default="ha2g", help="joints of JSON, as of ha2g export (default: ha2g)")
    command.add_argument("--json", action="store_true", help="print the counts of the run as JSON at its end")
    generate.add_style(command)
    controls = command.add_argument_group("control of the motion")
    generate.add_amounts(controls)
    controls.add_argument(
        "--muted", action="store_true", help='begin with resting arms, until the sender of ws:// says {"muted": false}'
    )
    controls.add_argument(
        "--state", choices=STATES, default="auto", help="what the body does without speech (default: auto)"
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run until the sound ends, print the counts, and return 0, or 128 + the number of the signal that ended the run.

    Raises:
        KeyboardInterrupt: the run was ended by Ctrl-C; its recording is written.
    """
    kinds = {sink.partition("://")[0] if "://" in sink else "file" for sink in arguments.sink}
    if arguments.fast:
        refuse_others(arguments, (), ("delay",), "--fast, by which nothing is heard in real time")
    if kinds == {"file"}:
        refuse_others(arguments, (), ("delay", "fps"), "a file alone, which has the frames of the model")
    if kinds <= {"file", "vmc"}:
        refuse_others(arguments, (), ("rig",), "these sinks, but to JSON: udp:// or ws://")
    with stage("starting"):
        from ha2g_jax import synthesis
        from ha2g_jax.apps.live.clock import StopFlag
        from ha2g_jax.apps.live.run import run as run_live
        from ha2g_jax.apps.live.sinks import open_sinks
        from ha2g_jax.apps.live.sources import open_source

    stop = StopFlag()
    source = open_source(arguments.source, arguments.rate, arguments.fast, arguments.channels)
    with contextlib.ExitStack() as stack:
        sinks = open_sinks(arguments.sink, stack, arguments.rig)
        with stage("loading the model"):
            model = synthesis.load(arguments.checkpoint)
        meter = run_live(
            model,
            source,
            sinks,
            look_ahead=arguments.look_ahead,
            hop=arguments.hop,
            style=generate.read_style(arguments),
            seed=arguments.seed,
            controls=generate.read_amounts(arguments),
            muted=arguments.muted,
            state=arguments.state,
            delay=arguments.delay,
            fps=arguments.fps,
            stop=stop,
        )
    print(f"ha2g live: {meter.line()}", file=sys.stderr)
    if arguments.json:
        print(json.dumps(meter.summary(), indent=1), flush=True)
    if stop.signal == signal.SIGINT:
        raise KeyboardInterrupt
    return 128 + stop.signal if stop.signal else 0

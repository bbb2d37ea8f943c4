"""The commands `ha2g genea pack` and `check`: arguments only; each calls one function of the package."""

import argparse
import pathlib
from typing import Any

from ha2g_jax.cli.generate import STYLE, add_style, read_style
from ha2g_jax.cli.parser import READING, add_reading, positive, print_verdict, read_seed, reading, refuse_others


def add_commands(commands: Any) -> None:
    """Add `genea` to the commands of a parser."""
    genea = commands.add_parser("genea", help="write or check the files of a submission to the GENEA leaderboard")
    genea.description = "Write or check the files of a submission to the GENEA leaderboard. See docs/genea.md."
    parts = genea.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_pack(parts)
    check = parts.add_parser("check", help="check a pack")
    check.description = "Check a pack of any system: names, layout, lengths. The exit code is 1 if an error is found."
    check.add_argument("pack", type=pathlib.Path, metavar="PACK", help="folder or .zip of a pack")
    check.add_argument("--speech", type=pathlib.Path, metavar="DIR", help="speech of all clips, for names and lengths")
    check.add_argument("--json", action="store_true", help="print JSON")
    check.set_defaults(run=_check)


def _add_pack(parts: Any) -> None:
    pack = parts.add_parser("pack", help="write five samples of each clip as SMPL-X at 30 frames per second")
    pack.description = "Write samples of each clip of a folder of speech as SMPL-X files at 30 frames per second."
    pack.add_argument("speech", type=pathlib.Path, metavar="SPEECH", help="folder of the speech of all clips")
    pack.add_argument(
        "-o", "--out", type=pathlib.Path, required=True, metavar="PACK", help="folder to write, or a .zip"
    )
    pack.add_argument(
        "--checkpoint", help="'demo', a workdir, a model folder, hf://OWNER/NAME or an .onnx (default: demo)"
    )
    pack.add_argument(
        "--samples",
        type=positive,
        metavar="N",
        help="samples of each clip; the leaderboard takes 5, or 1 (default: 5, or all in --motion)",
    )
    pack.add_argument("--seed", type=read_seed, help="seed of sample 1; sample k has this seed + k - 1 (default: 0)")
    add_style(pack)
    body = pack.add_argument_group("body of the person")
    body.add_argument("--shapes", type=pathlib.Path, metavar="DIR", help="files of BEAT2 with the speakers' shapes")
    body.add_argument(
        "--body-model", type=pathlib.Path, metavar="FILE", help="SMPLX_NEUTRAL.npz, to stand on the floor (default: no)"
    )
    files = pack.add_argument_group("motion of any system")
    files.add_argument("--motion", type=pathlib.Path, metavar="DIR", help="pack these files, CLIP.1.npz and so on")
    add_reading(files)
    pack.set_defaults(run=_pack)


def _pack(arguments: argparse.Namespace) -> None:
    from ha2g_jax.apps.genea.pack import write_pack

    options = reading(arguments)
    if arguments.motion is None:
        refuse_others(arguments, (), READING, "the motion of a model, but to the files of --motion")
        options |= {"checkpoint": arguments.checkpoint or "demo", "seed": arguments.seed or 0}
        options["style"] = read_style(arguments)
    else:
        refuse_others(arguments, (), ("checkpoint", "seed", *STYLE), "--motion, which packs what is there")
    path = write_pack(
        arguments.speech,
        arguments.out,
        motion=arguments.motion,
        samples=arguments.samples,
        shapes=arguments.shapes,
        body_model=arguments.body_model,
        **options,
    )
    print(path)


def _check(arguments: argparse.Namespace) -> int:
    from ha2g_jax.apps.genea.pack import check_pack

    return print_verdict(check_pack(arguments.pack, arguments.speech), arguments.pack, arguments.json)

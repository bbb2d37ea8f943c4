"""The `ha2g data` commands that make, describe, check, merge and divide corpora; arguments only.

Each command calls one function of the package. The commands that import data are in `data_imports`.
"""

import argparse
import json
import pathlib
from typing import Any

from ha2g_jax.cli import data_imports
from ha2g_jax.cli.parser import read_seed
from ha2g_jax.cli.values import positive
from ha2g_jax.errors import UserError

_SPLITS = ("train", "val", "test")


def add_commands(commands: Any) -> None:
    """Add `data` and its subcommands to the commands of a parser."""
    parser = commands.add_parser("data", help="import, make, check and divide data sets")
    parser.description = "Import, make, check and divide data sets (corpora). See docs/data.md."
    data = parser.add_subparsers(required=True, metavar="COMMAND")
    data_imports.add_commands(data)
    for add in (_add_make_talk, _add_inspect_talk, _add_stats, _add_inspect, _add_validate, _add_merge, _add_split):
        add(data)


def _add_make_talk(data: Any) -> None:
    command = data.add_parser("make-talk", help="make the Talk corpus: synthetic speech and gestures")
    command.description = "Make a Talk corpus: synthetic speech and gestures with known causes. See docs/talk.md."
    command.add_argument("out", type=pathlib.Path, metavar="DST", help="folder of the new corpus")
    command.add_argument("--speakers", type=int, default=48, metavar="N", help="number of speakers (default: 48)")
    command.add_argument("--minutes", type=float, default=144, metavar="M", help="minutes of speech (default: 144)")
    command.add_argument("--seed", type=read_seed, default=0, metavar="N", help="seed of the random draws (default: 0)")
    command.add_argument("--workers", type=positive, metavar="N", help="number of processes (default: one per core)")
    command.add_argument("--fps", type=positive, default=15, metavar="N", help="frames per second (default: 15)")
    command.add_argument(
        "--synthesiser",
        choices=("espeak-ng", "flite"),
        default="espeak-ng",
        help="program that speaks; flite is a library of the system, see docs/talk.md (default: espeak-ng)",
    )
    command.set_defaults(run=_make_talk)


def _make_talk(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data.talk import build

    build.make_talk(
        arguments.out,
        speakers=arguments.speakers,
        minutes=arguments.minutes,
        seed=arguments.seed,
        workers=arguments.workers,
        fps=arguments.fps,
        synthesiser=arguments.synthesiser,
    )
    print(arguments.out)


def _add_inspect_talk(data: Any) -> None:
    command = data.add_parser("inspect-talk", help="write a page on a Talk corpus: kinematics, angles, images")
    command.description = "Write an HTML page on the kinematics, angles, causes and images of a Talk corpus."
    command.add_argument("data", type=pathlib.Path, metavar="CORPUS", help="folder of a Talk corpus")
    default = pathlib.Path("talk_report")
    command.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        default=default,
        metavar="FILE",
        help="page to write (default: talk_report.html)",
    )
    command.add_argument(
        "--recording", type=pathlib.Path, metavar="BVH", help="motion capture of a real speaker for comparison"
    )
    command.set_defaults(run=_inspect_talk)


def _inspect_talk(arguments: argparse.Namespace) -> None:
    from ha2g_jax.evaluation.corpus.talk_report import write_report

    print(write_report(arguments.data, arguments.out, recording=arguments.recording))


def _add_stats(data: Any) -> None:
    command = data.add_parser("stats", help="print hours, speakers, words, bone lengths and angles of a corpus")
    command.description = "Print hours, speakers, words, bone lengths and angles of a corpus."
    command.add_argument("data", type=pathlib.Path, metavar="CORPUS", help="folder of a corpus")
    command.add_argument("--json", action="store_true", help="print JSON")
    command.set_defaults(run=_stats)


def _stats(arguments: argparse.Namespace) -> None:
    from ha2g_jax.evaluation.corpus.statistics import as_table, summarise

    summary = summarise(arguments.data)
    print(json.dumps(summary, indent=1) if arguments.json else as_table(summary))


def _add_inspect(data: Any) -> None:
    command = data.add_parser("inspect", help="write a page on a corpus, with statistics and clips to watch")
    command.description = (
        "Write an HTML page on a corpus, with statistics, the report of its import, and clips to watch."
    )
    command.add_argument("data", type=pathlib.Path, metavar="CORPUS", help="folder of a corpus")
    command.add_argument("-o", "--out", type=pathlib.Path, metavar="FILE", help="page to write (default: CORPUS.html)")
    command.add_argument("--samples", type=int, default=4, metavar="N", help="number of clips to watch (default: 4)")
    command.set_defaults(run=_inspect)


def _inspect(arguments: argparse.Namespace) -> None:
    from ha2g_jax.evaluation.corpus.report import write_report

    folder = arguments.data.resolve() if arguments.data.name in ("", "..") else arguments.data
    if not folder.name:
        raise UserError(f"no corpus in {folder}; give the folder of a corpus")
    page = arguments.out or folder.with_name(f"{folder.name}.html")
    print(write_report(arguments.data, page, num_samples=arguments.samples))


def _add_validate(data: Any) -> None:
    command = data.add_parser("validate", help="check every file and record of a corpus")
    command.description = "Check every file and record of a corpus. The exit code is 1 if an error is found."
    command.add_argument("data", type=pathlib.Path, metavar="CORPUS", help="folder of a corpus")
    command.add_argument("--json", action="store_true", help="print JSON")
    command.set_defaults(run=_validate)


def _validate(arguments: argparse.Namespace) -> int:
    from ha2g_jax.data import validation

    verdict = validation.examine(arguments.data)
    if arguments.json:
        print(json.dumps(verdict._asdict(), indent=1))
    else:
        notes = [f"note: {note}" for note in verdict.notes]
        print(*notes, *(verdict.findings or [f"{arguments.data} is valid"]), sep="\n")
    return 1 if verdict.findings else 0


def _add_merge(data: Any) -> None:
    command = data.add_parser("merge", help="merge several corpora of one skeleton and frame rate")
    command.description = "Merge several corpora of one skeleton and frame rate into a new one."
    command.add_argument("src", type=pathlib.Path, nargs="+", metavar="SRC", help="folders of the corpora to merge")
    command.add_argument("dst", type=pathlib.Path, metavar="DST", help="folder of the new corpus")
    command.add_argument("--same-speakers", action="store_true", help="treat speakers of the same name as one person")
    command.set_defaults(run=_merge)


def _merge(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import merge

    merge.merge(arguments.src, arguments.dst, same_speakers=arguments.same_speakers)
    print(arguments.dst)


def _add_split(data: Any) -> None:
    command = data.add_parser("split", help="divide a corpus into training, validation and test splits")
    command.description = (
        "Divide the clips of a corpus into training, validation and test splits. A recording is never divided."
    )
    command.add_argument("src", type=pathlib.Path, metavar="SRC", help="folder of the corpus to divide")
    command.add_argument("dst", type=pathlib.Path, metavar="DST", help="folder of the new corpus")
    command.add_argument(
        "--by",
        choices=("recording", "speaker"),
        default="recording",
        help="unit that is in one split only (default: recording)",
    )
    command.add_argument(
        "--fractions",
        nargs=3,
        type=float,
        default=(0.8, 0.1, 0.1),
        metavar=("TRAIN", "VAL", "TEST"),
        help="fractions of the duration; 0 leaves a split out (default: 0.8 0.1 0.1)",
    )
    command.add_argument("--seed", type=read_seed, default=0, metavar="N", help="seed of the random order (default: 0)")
    command.set_defaults(run=_split)


def _split(arguments: argparse.Namespace) -> None:
    from ha2g_jax.data import division

    fractions: dict[str, float] = dict(zip(_SPLITS, arguments.fractions, strict=True))
    division.divide(arguments.src, arguments.dst, by=arguments.by, fractions=fractions, seed=arguments.seed)
    print(arguments.dst)

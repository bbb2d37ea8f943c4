"""Measure how well gestures fit the speech by the look-ahead of the stream that makes them; train the missing runs.

    python experiments/latency.py --data talk --size study --seeds 3
    python experiments/latency.py --data talk --size debug --seeds 1         # a quick test that everything runs

Two settings of HA2G are compared, trained with hidden ends (data.lookahead) and on whole windows, at look-aheads from
0 to 15 frames and with the whole file. Each setting and seed is a run of its own in WORKDIR, which reproduce.py uses
too. Finished runs are not trained again, and the same command continues an interrupted one.
"""

import argparse
import pathlib
import shlex
import sys
from collections.abc import Sequence

from tables.jobs import Perform, Stopped
from tables.latency_study import study_latency
from tables.request import Request, parse_seeds

from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import stop_signals

WORKDIR = pathlib.Path("runs/reproduce")


def main(argv: Sequence[str] | None = None, perform: Perform | None = None) -> int:
    """Run the script.

    Args:
        argv: command-line arguments; by default those of this process.
        perform: function that trains and scores one run; by default in a process of its own.

    Returns:
        Exit code: 0, 1 if a run failed, 2 for a mistake of the user, 128 + the number of the signal that stopped it.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser().parse_args(argv)
    try:
        request = _request(arguments)
        out = arguments.out or request.workdir / f"{request.data}-{request.size}" / "latency.md"
        command = shlex.join(["python", "experiments/latency.py", *argv])
        with stop_signals() as stop:
            is_whole = study_latency(request, arguments.split, out, command, stop, perform)
    except UserError as error:
        print(f"latency: {error}", file=sys.stderr)
        return 2
    except Stopped as stopped:
        print("stopped; the same command continues", file=sys.stderr)
        return 128 + stopped.number
    print(out)
    return 0 if is_whole else 1


def _request(arguments: argparse.Namespace) -> Request:
    data, _, path = arguments.data.partition(":")
    if data != "talk":
        raise UserError(f"the causes of gestures are known on talk only, not on {data!r}; give --data talk[:DIR]")
    if arguments.jobs < 1:
        raise UserError(f"--jobs is {arguments.jobs}; give 1 or more")
    return Request(
        table="latency",
        data=data,
        size=arguments.size,
        path=path,
        seeds=parse_seeds(arguments.seeds),
        workdir=arguments.workdir,
        jobs=arguments.jobs,
        has_training=not arguments.no_train,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--data", default="talk", metavar="talk[:DIR]", help="the Talk corpus, made on first use")
    parser.add_argument("--size", default="small", choices=configs.SIZES, help="size of the models (default: small)")
    parser.add_argument("--seeds", default="3", help="number of seeds, or a list such as 0,5,7 (default: 3)")
    parser.add_argument("--split", default="test", help="split to score (default: test)")
    parser.add_argument("--out", type=pathlib.Path, help="file of the page (default: WORKDIR/talk-SIZE/latency.md)")
    parser.add_argument(
        "--workdir", type=pathlib.Path, default=WORKDIR, help=f"folder of all runs (default: {WORKDIR})"
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of runs at once, each on a part of the cores")
    parser.add_argument("--no-train", action="store_true", help="score finished runs only")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""Reproduce a table of the paper: train the missing runs, evaluate them, and write the paper's numbers beside ours.

    python experiments/reproduce.py table1 --data talk --size small --seeds 3
    python experiments/reproduce.py table3 --data ted_expressive --path corpora/ted
    python experiments/reproduce.py table1 --data talk --size debug          # a quick test that everything runs

TABLE is table1, table3, table4, table11, table12, figure3 or gesture_ablation. Each row and seed is a run of its own in
WORKDIR, which all tables use; finished runs are not trained again, and the same command continues an interrupted one.
table5 and table10 are statistics of the data, for which nothing is trained.
"""

import argparse
import pathlib
import shlex
import sys
from collections.abc import Sequence

from tables.corpus_tables import CORPUS_TABLES
from tables.jobs import Perform, Stopped, perform_in_process
from tables.paper_tables import TABLES
from tables.reproduce import reproduce
from tables.request import Request, parse_changes, parse_seeds

from ha2g_jax.config import presets
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import stop_signals

WORKDIR = pathlib.Path("runs/reproduce")


def main(argv: Sequence[str] | None = None, perform: Perform = perform_in_process) -> int:
    """Run the script.

    Args:
        argv: command-line arguments; by default those of this process.
        perform: function that trains and scores one run.

    Returns:
        Exit code: 0, 1 if a run failed, 2 for a mistake of the user, 128 + the number of the signal that stopped it.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser().parse_args(argv)
    try:
        request = _request(arguments)
        out = arguments.out or request.workdir / f"{request.data}-{request.size}" / f"{request.table}.md"
        command = shlex.join(["python", "experiments/reproduce.py", *argv])
        with stop_signals() as stop:
            is_whole = reproduce(request, out, command, stop, perform, arguments.keep)
    except UserError as error:
        print(f"reproduce: {error}", file=sys.stderr)
        return 2
    except Stopped as stopped:
        print("stopped; the same command continues", file=sys.stderr)
        return 128 + stopped.number
    print(out)
    return 0 if is_whole else 1


def _request(arguments: argparse.Namespace) -> Request:
    data, _, path = arguments.data.partition(":")
    if path and arguments.path:
        raise UserError(f"--data names the folder {path} and --path {arguments.path}; give one of them")
    if data not in presets.DATA:
        raise UserError(f"no data {data!r}; expected one of {', '.join(presets.DATA)}")
    if arguments.jobs < 1:
        raise UserError(f"--jobs is {arguments.jobs}; give 1 or more")
    return Request(
        table=arguments.table,
        data=data,
        size=arguments.size,
        path=path or arguments.path,
        seeds=parse_seeds(arguments.seeds),
        workdir=arguments.workdir,
        changes=parse_changes(arguments.changes),
        jobs=arguments.jobs,
        has_training=not arguments.no_train,
        has_legacy=arguments.legacy,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    names = (*TABLES, *CORPUS_TABLES)
    parser.add_argument("table", choices=names, metavar="TABLE", help=", ".join(names))
    parser.add_argument("--data", required=True, metavar="NAME[:DIR]", help=f"one of {', '.join(presets.DATA)}")
    parser.add_argument("--path", default="", metavar="DIR", help="folder of the corpus; Talk is made on first use")
    parser.add_argument("--size", default="small", choices=configs.SIZES, help="size of the models (default: small)")
    parser.add_argument("--seeds", default="3", help="number of seeds, or a list such as 0,5,7 (default: 3)")
    parser.add_argument("--out", type=pathlib.Path, help="file of the report (default: WORKDIR/DATA-SIZE/TABLE.md)")
    parser.add_argument(
        "--workdir", type=pathlib.Path, default=WORKDIR, help=f"folder of all runs (default: {WORKDIR})"
    )
    parser.add_argument(
        "--keep",
        type=pathlib.Path,
        metavar="DIR",
        help="copy each finished run to DIR without its weights, to publish or continue the study",
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of runs at once, each on a part of the cores")
    parser.add_argument("--no-train", action="store_true", help="evaluate existing runs only")
    parser.add_argument("--legacy", action="store_true", help="add the scores by the rules of the public release")
    parser.add_argument(
        "--changes",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change of a setting for all rows, such as train.steps=3000; may be given again",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())

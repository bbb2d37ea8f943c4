"""Measure how well gestures fit the speech at several look-aheads of a stream; train the missing runs.

    python experiments/latency.py --data talk --size study --seeds 3
    python experiments/latency.py --data talk --size debug --seeds 1         # a quick test that everything runs

Two settings of HA2G are compared, trained with hidden ends (data.lookahead) and on whole windows, at look-aheads from
0 to 15 frames and with the whole file. Each setting and seed is a separate run in WORKDIR, which reproduce.py uses
too. Finished runs are not trained again, and the same command continues an interrupted one.
"""

import argparse
import functools
import pathlib
import shlex
import sys
import time
from collections.abc import Sequence

import tqdm
from tables.latency_report import Results, all_numbers, as_markdown, figure
from tables.look_aheads import LOOK_AHEADS, TABLE, plan_settings, read_scores
from tables.plan import Request, check_report, parse_data, parse_seeds
from tables.report import describe_work
from tables.runs import DEFAULT_SEEDS, Perform, Stop, add_options, perform_in_process, run_all, run_script
from tables.workdirs import is_finished, record_of

from ha2g_jax.errors import UserError
from ha2g_jax.files.writing import write_text


def main(argv: Sequence[str] | None = None, perform: Perform = perform_in_process) -> int:
    """Run the script and return its exit code, see `run_script`; `perform` trains and scores one run."""
    argv = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser().parse_args(argv)

    def work(stop: Stop) -> bool:
        request = _request(arguments)
        out = arguments.out or request.workdir / f"{request.data}-{request.size}" / "latency.md"
        is_whole = study_latency(request, out, shlex.join(["python", "experiments/latency.py", *argv]), stop, perform)
        print(out)
        return is_whole

    return run_script("latency", work)


def study_latency(
    request: Request, out: pathlib.Path, command: str, stop: Stop, perform: Perform = perform_in_process
) -> bool:
    """Train and score the missing runs and write the page to `out`, with an SVG and all numbers beside it.

    Returns:
        Whether every run has all scores.

    Raises:
        UserError: the request does not fit the data, or the page cannot be written.
        Stopped: a signal came.
    """
    check_report(out)
    start = time.monotonic()
    plan = plan_settings(request)
    if not plan.corpus.has_clips(request.split):
        splits = ", ".join(plan.corpus.splits)
        raise UserError(f"{plan.corpus.path} has no clips in the split {request.split}; give --split one of {splits}")
    missing = [run for run in plan.runs if read_scores(run, plan, request.split) is None]
    failures = {} if request.has_training else {run.name: "not trained" for run in missing if not is_finished(run)}
    missing = [run for run in missing if run.name not in failures]
    there = len(plan.runs) - len(missing) - len(failures)
    tqdm.tqdm.write(f"runs to train or score: {len(missing)}; there already: {there}", file=sys.stderr)
    failures |= run_all(missing, functools.partial(perform, request), stop, "look-ahead", request.jobs)
    scores = {
        name: {run.seed: read_scores(run, plan, request.split) for run in runs} for name, runs in plan.rows.items()
    }
    records = {name: {run.seed: record_of(run, None) for run in runs} for name, runs in plan.rows.items()}
    results = Results(
        request,
        plan.corpus.fps,
        {
            name: {at: {seed: one[at] for seed, one in mine.items() if one is not None} for at in LOOK_AHEADS}
            for name, mine in scores.items()
        },
        {
            name: {
                run.seed: failures.get(run.name, "it ended without scores")
                for run in runs
                if not scores[name][run.seed]
            }
            for name, runs in plan.rows.items()
        },
        records,
        describe_work(
            request,
            plan,
            [record for mine in records.values() for record in mine.values()],
            command,
            time.monotonic() - start,
        ),
    )
    files = {out: as_markdown(results, out.stem)}
    if results.has_scores:
        files |= {out.with_suffix(".svg"): figure(results), out.with_suffix(".csv"): all_numbers(results)}
    for path, text in files.items():
        write_text(path, text)
    return not any(results.failures.values())


def _request(arguments: argparse.Namespace) -> Request:
    data, path = parse_data(arguments.data)
    if data != "talk":
        raise UserError(f"the causes of gestures are known on talk only, not on {data!r}; give --data talk[:DIR]")
    return Request(
        table=TABLE,
        data=data,
        size=arguments.size,
        path=path,
        seeds=parse_seeds(arguments.seeds or DEFAULT_SEEDS),
        workdir=arguments.workdir,
        jobs=arguments.jobs,
        has_training=not arguments.no_train,
        split=arguments.split,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--data", default="talk", metavar="talk[:DIR]", help="the Talk corpus, made on first use")
    parser.add_argument("--split", default="test", help="split to score (default: test)")
    add_options(parser, "WORKDIR/talk-SIZE/latency.md", "small")
    return parser


if __name__ == "__main__":
    sys.exit(main())

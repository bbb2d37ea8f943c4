"""Reproduce a table of the paper: train the missing runs, evaluate them, and write the paper's numbers beside ours.

    python experiments/reproduce.py table1 --data talk --size small --seeds 3
    python experiments/reproduce.py table3 --data ted_expressive:corpora/ted
    python experiments/reproduce.py table1 --data talk --size debug          # a quick test that everything runs
    python experiments/reproduce.py table1_equal --data talk --size small    # with equal inputs and of equal size
    python experiments/reproduce.py factorial --continue --size medium       # the factorial study, where it was left

TABLE is table1, table1_equal, table3, table4, table11, table12, figure3, gesture_ablation or factorial. Each row and
seed is a separate run in WORKDIR, which all tables use; finished runs are not trained again, and the same command
continues an interrupted one. With --continue it starts from the runs that the repository keeps, so that a study can go
on anywhere. table5 and table10 are statistics of the data, for which nothing is trained. Without --size models and
training are the paper's, which take days on one GPU; `ha2g doctor --benchmark --table1` measures the hours on this
machine.
"""

import argparse
import os
import pathlib
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import tqdm
from tables import factorial
from tables.kept_runs import corpus_data, keep_run
from tables.paper_tables import TABLES
from tables.plan import (
    Request,
    TablePlan,
    check_report,
    corpus_path,
    is_counted,
    parse_changes,
    parse_data,
    parse_seeds,
    plan_table,
    read_record,
    scores_kind,
)
from tables.report import Results, all_numbers, as_markdown, describe_work, figure
from tables.runs import DEFAULT_SEEDS, Perform, Stop, add_options, perform_in_process, run_all, run_script
from tables.tables import RowScores, every_number
from tables.workdirs import Record, Run, is_finished

from ha2g_jax.config import presets
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.charts import markdown
from ha2g_jax.evaluation.corpus_statistics import joint_rows, summarise
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import write_text, writing

CORPUS_TABLES = ("table5", "table10")

_HERE = pathlib.Path(__file__).resolve().parent

# Videos, hours and segments of all splits, and fraction of the length of a video that shots of interest take.
_TABLE_5 = {
    "TED Gesture, paper": ("1,766", "106.1", "252,109", "25 %"),
    "TED-Expressive, paper": ("1,764", "100.8", "240,447", "21 %"),
}


def main(argv: Sequence[str] | None = None, perform: Perform = perform_in_process) -> int:
    """Run the script and return its exit code, see `run_script`; `perform` trains and scores one run."""
    argv = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser().parse_args(argv)

    def work(stop: Stop) -> bool:
        request, keep, out = _request(arguments), arguments.keep, arguments.out
        if arguments.resume:
            keep = keep or _HERE / f"{request.table}-runs" / request.size
            out = out or _HERE.parent / "docs" / "results" / f"{request.table}-{request.size}.md"
            if not (keep.exists() or request.has_training):
                raise UserError(f"no runs are kept in {shown(keep)}; leave out --no-train to train them")
            if keep.exists() and keep.resolve() != request.workdir.resolve():
                with writing(request.workdir, f"it would be a copy of {shown(keep)}; choose other folders"):
                    shutil.copytree(keep, request.workdir, dirs_exist_ok=True)
        out = out or request.workdir / f"{request.data}-{request.size}" / f"{request.table}.md"
        command = shlex.join(["python", "experiments/reproduce.py", *argv])
        is_whole = reproduce(request, out, command, stop, perform, keep)
        print(out)
        return is_whole

    return run_script("reproduce", work)


def reproduce(
    request: Request,
    out: pathlib.Path,
    command: str,
    stop: Stop,
    perform: Perform = perform_in_process,
    keep: pathlib.Path | None = None,
) -> bool:
    """Train and score the missing runs of a table and write its page to `out`, with all numbers beside it.

    Args:
        stop: signal that ends the work; the same request then continues it.
        keep: folder of a table to which each finished run is added, see `kept_runs`; None for none.

    Returns:
        Whether every run has scores. A row that lacks an input of the user, such as HA2G-ASR without the weights of
        Whisper, has no run.

    Raises:
        UserError: the request does not fit the data, the auto-encoder failed, the page cannot be written, or `keep`
            has other trainings.
        Stopped: a signal came.
    """
    check_report(out)
    start = time.monotonic()
    if request.table in CORPUS_TABLES:
        if keep is not None or request.changes:
            option = "--changes" if keep is None else "--keep"
            raise UserError(f"nothing is trained for {request.table}; leave out {option}")
        write_text(out, corpus_page(request.table, corpus_path(request), command))
        return True
    plan = plan_table(request)
    runs = [plan.autoencoder, *plan.runs]
    if keep is not None:
        for run in runs:
            _keep(run, plan, request, keep)

    def perform_and_keep(run: Run, worker: int, stop: Stop) -> None:
        perform(request, run, worker, stop)
        if keep is not None:
            _keep(run, plan, request, keep)

    failures = _fill(request, plan, perform_and_keep, stop)
    records = {row: {run.seed: read_record(run, plan, request) for run in mine} for row, mine in plan.rows.items()}
    reasons = {
        row: {
            run.seed: failures.get(run.name, "it ended without scores").replace(f"{run.workdir.parent}{os.sep}", "")
            for run in mine
            if records[row][run.seed].scores is None
        }
        for row, mine in plan.rows.items()
    }
    every = [record for mine in records.values() for record in mine.values()]
    facts = describe_work(request, plan, every, command, time.monotonic() - start)
    facts["pose auto-encoder"] = _describe_autoencoder(read_record(plan.autoencoder, plan, request), every)
    results = Results(request, plan, records, {row: found for row, found in reasons.items() if found}, facts)
    if request.table == factorial.TABLE:
        return _write_factorial(results, out)
    if results.scores:
        write_text(out.with_suffix(".csv"), all_numbers(results))
    chart = out.with_suffix(".svg") if request.table == "figure3" and results.scores else None
    if chart:
        write_text(chart, figure(results))
    write_text(out, as_markdown(results, out.with_suffix(".csv").name, chart.name if chart else None))
    return not results.failures


def _write_factorial(results: Results, out: pathlib.Path) -> bool:
    """Write the page of the factorial study with its numbers, print a summary, and return whether no run failed."""
    request, plan, records, failures, _ = results
    numbers = out.with_suffix(".csv")
    if results.scores:
        more = factorial.all_numbers(request.size, records, results.scores)
        write_text(numbers, every_number(plan.table, results.scores, plan.splits, {}, more))
    write_text(out, factorial.as_markdown(request.size, records, results.scores, failures, numbers.name))
    print(factorial.describe(records))
    return all(reason == factorial.NOT_TRAINED for mine in failures.values() for reason in mine.values())


def _fill(request: Request, plan: TablePlan, perform: Callable[[Run, int, Stop], None], stop: Stop) -> dict[str, str]:
    """Train and score the missing runs; return the names of the runs without scores with the reason."""
    autoencoder = read_record(plan.autoencoder, plan, request)
    is_there = is_finished(plan.autoencoder) or plan.kept.find(plan.autoencoder) is not None
    if request.has_training and not is_there:
        if failed := run_all([plan.autoencoder], perform, stop, "pose auto-encoder"):
            raise UserError(f"the pose auto-encoder was not trained: {failed[plan.autoencoder.name]}")
    elif autoencoder.scored_step is None:
        raise UserError(f"no pose auto-encoder in {plan.autoencoder.workdir}; leave out --no-train to train one")
    # The gate of the factorial study is passed before any comparison; the page has all seeds, not only the requested.
    gate = [plan.rows[row][0] for row in factorial.GATE_ROWS] if request.table == factorial.TABLE else []
    missing = {run.name: run for run in plan.runs if read_record(run, plan, request).scores is None}
    skipped = [name for name, run in missing.items() if run.seed not in request.seeds and run not in gate]
    if not request.has_training:
        skipped += [name for name, run in missing.items() if not is_counted(run, request)]
    failures = dict.fromkeys(skipped, factorial.NOT_TRAINED)
    runs = [run for name, run in missing.items() if name not in failures]
    for row, reason in plan.left_out.items():
        tqdm.tqdm.write(f"{row} is left out: {reason}", file=sys.stderr)
    there = len(plan.runs) - len(missing)
    tqdm.tqdm.write(f"runs to train or score: {len(runs)}; there already: {there}", file=sys.stderr)
    if gate:
        failures |= run_all([run for run in runs if run in gate], perform, stop, "gate", request.jobs)
        runs = [run for run in runs if run not in gate]
        found = [read_record(run, plan, request).scores for run in gate]
        scores: RowScores = {row: {0: each} for row, each in zip(factorial.GATE_ROWS, found, strict=True) if each}
        if not factorial.gate(scores, request.size)[1]:
            return failures | dict.fromkeys((run.name for run in runs), factorial.NOT_TRAINED)
    return failures | run_all(runs, perform, stop, request.table, request.jobs)


def _keep(run: Run, plan: TablePlan, request: Request, folder: pathlib.Path) -> None:
    scores = read_record(run, plan, request).scores
    if scores is not None or run == plan.autoencoder:
        data = corpus_data(plan.corpus.metadata, plan.digest)
        keep_run(run, scores, folder, data, scores_kind(plan, request))


def _describe_autoencoder(record: Record, runs: Sequence[Record]) -> str:
    ids = {run.scores["autoencoder"] for run in runs if run.scores}
    steps = record.config["train"]["steps"]
    known = ", ".join(sorted(each[:16] for each in ids)) or "unknown"
    texts = [f"`{record.name}`, id {known}", f"step {record.scored_step or 0:,} of {steps:,}"]
    error = record.validated("loss/reconstruction")
    if error is not None:
        texts.append(f"reconstruction error {error:.4g} (mean L1 of direction vectors on the validation split)")
    return "; ".join(texts)


def corpus_page(name: str, path: str | os.PathLike, command: str) -> str:
    """Write the page of Table 5 or 10 for a corpus: its statistics beside those that the paper gives.

    Raises:
        UserError: there is no corpus, a record cannot be used, or Table 10 is requested without a training split.
    """
    found = summarise(path)
    if name == "table10" and not found["training"]:
        raise UserError(f"{path} has no training split, which the angles of Table 10 are of")
    title, lines, note = _table_5(found) if name == "table5" else _table_10(found)
    return "\n".join([f"# {title}", "", f"Made by `{command}`.", "", markdown(lines), "", note, ""])


def _table_5(found: dict[str, Any]) -> tuple[str, list[Sequence[str]], str]:
    lines: list[Sequence[str]] = [("data", "videos", "hours", "segments", "ratio of interest")]
    lines += [(name, *numbers) for name, numbers in _TABLE_5.items()]
    for name, counts in [*found["splits"].items(), ("all splits", found["total"])]:
        numbers = (f"{counts['recordings']:,}", f"{counts['hours']:,.3f}", f"{counts['windows']:,}", "-")
        lines.append((f"this corpus, {name}", *numbers))
    note = (
        "A video is a recording here, and a segment a window of 34 frames that starts every 10 frames. A corpus does "
        "not store how long the recordings were before clips were cut from them, so that it has no ratio."
    )
    return "Table 5: size of the data", lines, note


def _table_10(found: dict[str, Any]) -> tuple[str, list[Sequence[str]], str]:
    note = (
        "Angles inside the joint, in degrees, over the frames of the training split that lie in windows. *Published* "
        "are the statistics that were published with TED-Expressive and TED-Gesture, which differ from the paper's "
        'Table 10; its "var" agrees neither with their variances nor, at the elbows, with their standard deviations.'
    )
    return "Table 10: angles of the shoulders and elbows", [*joint_rows(found["training"])], note


def _request(arguments: argparse.Namespace) -> Request:
    is_factorial = arguments.table == factorial.TABLE
    data, path = parse_data(arguments.data or "talk" * is_factorial)
    seeds = parse_seeds(arguments.seeds or (str(factorial.SEEDS) if is_factorial else DEFAULT_SEEDS))
    if is_factorial and data != "talk":
        raise UserError(f"the causes of gestures are known on talk only, not on {data!r}; give --data talk[:DIR]")
    if is_factorial and (arguments.changes or arguments.legacy):
        option = "--changes" if arguments.changes else "--legacy"
        raise UserError(f"the protocol of the factorial study fixes its settings and scores; leave out {option}")
    if is_factorial and not set(seeds) <= {*range(factorial.SEEDS)}:
        raise UserError(f"the factorial study has the seeds 0 to {factorial.SEEDS - 1}, not {arguments.seeds}")
    return Request(
        table=arguments.table,
        data=data,
        size=arguments.size,
        path=path,
        seeds=seeds,
        workdir=arguments.workdir / f"{factorial.TABLE}-{arguments.size}" if is_factorial else arguments.workdir,
        changes=parse_changes(arguments.changes),
        jobs=arguments.jobs,
        has_training=not arguments.no_train,
        has_legacy=arguments.legacy,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    add, names = parser.add_argument, (*TABLES, *CORPUS_TABLES, factorial.TABLE)
    add("table", choices=names, metavar="TABLE", help=", ".join(names))
    add_options(parser, "WORKDIR/DATA-SIZE/TABLE.md", "paper")
    add("--data", metavar="NAME[:DIR]", help=f"one of {', '.join(presets.DATA)}, and the folder")
    add("--keep", type=pathlib.Path, metavar="DIR", help="add each finished run to the table DIR/scores.jsonl")
    help_text = "go on from the runs in --keep (default: experiments/TABLE-runs/SIZE); page in docs/results"
    add("--continue", dest="resume", action="store_true", help=help_text)
    add("--legacy", action="store_true", help="add the scores by the rules of the public release")
    help_text = "change of a setting for all rows, such as train.steps=3000; may be given again"
    add("--changes", action="append", default=[], metavar="KEY=VALUE", help=help_text)
    return parser


if __name__ == "__main__":
    sys.exit(main())

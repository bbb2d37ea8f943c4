"""Reproduction of a table of the paper: training and scoring of missing runs, and the report."""

import os
import pathlib
import sys
import time
from typing import Any

import tqdm

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import Stop
from ha2g_jax.files.reading import reading
from ha2g_jax.files.writing import whole_file
from tables import paper_tables
from tables.corpus_tables import CORPUS_TABLES, corpus_report
from tables.facts import describe_work, run_states, validation_metric
from tables.jobs import Perform, perform_in_process, run_all
from tables.kept_runs import keep_run
from tables.plan import (
    Plan,
    Run,
    checkpoint_step,
    is_finished,
    make_plan,
    read_stored,
    scores_path,
)
from tables.report import as_markdown, figure
from tables.request import Request, check_report, corpus_path
from tables.results import Results

_NOT_TRAINED = "not trained"


def reproduce(
    request: Request,
    out: pathlib.Path,
    command: str,
    stop: Stop,
    perform: Perform = perform_in_process,
    keep: pathlib.Path | None = None,
) -> bool:
    """Train and score the missing runs of a table and write its report, for Figure 3 with an SVG beside it.

    Tables 5 and 10 are statistics of the corpus, for which nothing is trained.

    Args:
        request: request of the user.
        out: Markdown file of the report.
        command: command of the user, for the report.
        stop: signal that ends the work; the same request then continues it.
        perform: function that trains and scores one run.
        keep: folder to which each finished run is copied without weights, see `keep_run`; None for no copies.

    Returns:
        Whether every run has scores. A row that lacks an input of the user, such as HA2G-ASR without the weights of
        Whisper, has no run.

    Raises:
        UserError: the request does not fit the data, the auto-encoder failed, the report cannot be written, or `keep`
            has copies of other trainings.
        Stopped: a signal came.
    """
    check_report(out)
    start = time.monotonic()
    if request.table in CORPUS_TABLES:
        if keep is not None:
            raise UserError(
                f"nothing is trained for {request.table}, so that there is no run to keep; leave out --keep"
            )
        if request.changes:
            raise UserError(f"nothing is trained for {request.table}; leave out --changes")
        report = corpus_report(request.table, corpus_path(request), command)
        with whole_file(out) as path:
            path.write_text(report)
        return True
    paper_tables.table(request.table, request.data)  # before a corpus is made
    folder = corpus_path(request)
    corpus = Corpus.open(folder)
    plan = make_plan(request, folder)
    for split in plan.splits:
        if not corpus.has_clips(split):
            raise UserError(f"{folder} has no clips in the split {split}, which is scored; `ha2g data split` makes one")
    with reading(request.workdir, "a folder of runs, which --workdir names"):
        request.workdir.mkdir(parents=True, exist_ok=True)
    if keep is not None:
        for run in (plan.autoencoder, *plan.runs):
            keep_run(run, plan, request.has_legacy, keep)
        perform = _keeping(perform, plan, keep)
    failures = _fill(request, plan, perform, stop)
    results = _collect(request, plan, corpus, failures)
    facts = describe_work(request, plan.runs, corpus, command, time.monotonic() - start)
    _write(results._replace(facts=facts), out)
    return not results.failures


def _keeping(perform: Perform, plan: Plan, keep: pathlib.Path) -> Perform:
    """Return a function that trains and scores one run by `perform` and copies it to `keep`."""

    def perform_and_keep(request: Request, corpus: pathlib.Path, run: Run, worker: int, stop: Stop) -> None:
        perform(request, corpus, run, worker, stop)
        keep_run(run, plan, request.has_legacy, keep)

    return perform_and_keep


def _fill(request: Request, plan: Plan, perform: Perform, stop: Stop) -> dict[str, str]:
    """Train and score the missing runs; return the names of the runs without scores with the reason."""
    if request.has_training and not is_finished(plan.autoencoder):
        title = "pose auto-encoder"
        if failed := run_all(request, plan.corpus, [plan.autoencoder], perform, stop, title):
            raise UserError(f"the pose auto-encoder was not trained: {failed[plan.autoencoder.name]}")
    if checkpoint_step(plan.autoencoder) is None:
        raise UserError(f"no pose auto-encoder in {plan.autoencoder.workdir}; leave out --no-train to train one")
    runs = {run.name: run for run in plan.runs if _scores(request, plan, run) is None}
    failures = {}
    if not request.has_training:
        failures = {name: _NOT_TRAINED for name, run in runs.items() if checkpoint_step(run) is None}
    missing = [run for name, run in runs.items() if name not in failures]
    there = len({run.name for run in plan.runs}) - len(runs)
    for row, reason in plan.left_out.items():
        tqdm.tqdm.write(f"{row} is left out: {reason}", file=sys.stderr)
    tqdm.tqdm.write(f"runs to train or score: {len(missing)}; there already: {there}", file=sys.stderr)
    return failures | run_all(request, plan.corpus, missing, perform, stop, request.table)


def _scores(request: Request, plan: Plan, run: Run) -> dict[str, Any] | None:
    """Return the scores of a run, or None where the scores or a part of the training are missing."""
    if request.has_training and not is_finished(run):
        return None
    return read_stored(scores_path(run, plan, request.has_legacy))


def _collect(request: Request, plan: Plan, corpus: Corpus, failed: dict[str, str]) -> Results:
    scores: dict[str, dict[int, dict[str, Any]]] = {}
    failures: dict[str, dict[int, str]] = {}
    for row, runs in plan.rows.items():
        for run in runs:
            found = _scores(request, plan, run)
            if found is None:
                reason = failed.get(run.name, "it ended without scores")
                failures.setdefault(row, {})[run.seed] = reason.replace(f"{run.workdir.parent}{os.sep}", "")
            else:
                scores.setdefault(row, {})[run.seed] = found
    return Results(
        table=plan.table,
        name=request.table,
        data=request.data,
        size=request.size,
        splits=plan.splits,
        scores=scores,
        failures=failures,
        left_out=plan.left_out,
        runs=run_states(plan.rows),
        facts={},
        autoencoder=_describe_autoencoder(plan.autoencoder, scores),
        has_legacy=request.has_legacy,
    )


def _describe_autoencoder(run: Run, scores: dict[str, dict[int, dict[str, Any]]]) -> str:
    ids = {one["autoencoder"] for mine in scores.values() for one in mine.values()}
    step = checkpoint_step(run)
    texts = [f"id {', '.join(sorted(ids)) or 'unknown'}", f"step {step:,} of {run.config.train.steps:,}"]
    error = validation_metric(run, "validation/loss/reconstruction", step)
    if error is not None:
        texts.append(f"reconstruction error {error:.4g} (mean L1 of direction vectors on the validation split)")
    return "; ".join([*texts, f"folder `{run.name}`"])


def _write(results: Results, out: pathlib.Path) -> None:
    chart = out.with_suffix(".svg")
    has_chart = results.name == "figure3" and any(results.scores.values())
    if has_chart:
        with whole_file(chart) as path:
            path.write_text(figure(results))
    with whole_file(out) as path:
        path.write_text(as_markdown(results, chart.name if has_chart else None))

"""The study of look-aheads: training and scoring of missing runs, and the page."""

import functools
import pathlib
import sys
import time
from collections.abc import Mapping

import tqdm

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import Stop
from ha2g_jax.files.reading import reading
from ha2g_jax.files.writing import whole_file
from tables.facts import describe_work, run_states
from tables.jobs import Perform, perform_in_process, run_all
from tables.latency_estimates import Scores
from tables.latency_plan import LOOK_AHEADS, plan_settings, scores_path
from tables.latency_report import Results, as_markdown, figure
from tables.plan import Run, is_finished, read_stored
from tables.request import Request, check_report, corpus_path

_WORKER = (sys.executable, "-m", "tables.latency_worker")


def study_latency(
    request: Request, split: str, out: pathlib.Path, command: str, stop: Stop, perform: Perform | None = None
) -> bool:
    """Train and score the missing runs and write the page, with an SVG beside it.

    Args:
        request: request of the user; its table is not used.
        split: split to score.
        out: Markdown file of the page.
        command: command of the user, for the page.
        stop: signal that ends the work; the same request then continues it.
        perform: function that trains and scores one run; by default in a process of its own.

    Returns:
        Whether every run has all scores.

    Raises:
        UserError: the request does not fit the data, or the page cannot be written.
        Stopped: a signal came.
    """
    check_report(out)
    start = time.monotonic()
    folder = corpus_path(request)
    rows = plan_settings(request, folder)
    corpus = Corpus.open(folder)
    if not corpus.has_clips(split):
        raise UserError(f"{folder} has no clips in the split {split}; give --split one of {', '.join(corpus.splits)}")
    with reading(request.workdir, "a folder of runs, which --workdir names"):
        request.workdir.mkdir(parents=True, exist_ok=True)
    runs = [run for same_seed in zip(*rows.values(), strict=True) for run in same_seed]
    missing = [run for run in runs if _scores(run, folder, split) is None]
    failures = {} if request.has_training else {run.name: "not trained" for run in missing if not is_finished(run)}
    missing = [run for run in missing if run.name not in failures]
    message = f"runs to train or score: {len(missing)}; there already: {len(runs) - len(missing) - len(failures)}"
    tqdm.tqdm.write(message, file=sys.stderr)
    perform = perform or functools.partial(perform_in_process, command=_WORKER, options={"split": split})
    failures |= run_all(request, folder, missing, perform, stop, "look-ahead")
    results = _collect(request, split, rows, corpus, failures)
    facts = describe_work(request, runs, corpus, command, time.monotonic() - start)
    _write(results._replace(facts=facts), out)
    return not results.failures


def _scores(run: Run, corpus: pathlib.Path, split: str) -> Mapping[int | None, Scores] | None:
    """Return the scores of a finished run by look-ahead, or None where one is missing."""
    if not is_finished(run):
        return None
    found = {at: read_stored(scores_path(run, corpus, split, at)) for at in LOOK_AHEADS}
    whole = {at: scores for at, scores in found.items() if scores is not None}
    return whole if len(whole) == len(found) else None


def _collect(
    request: Request,
    split: str,
    rows: dict[str, tuple[Run, ...]],
    corpus: Corpus,
    failed: dict[str, str],
) -> Results:
    curves: dict[str, dict[int | None, dict[int, Scores]]] = {name: {at: {} for at in LOOK_AHEADS} for name in rows}
    failures: dict[str, dict[int, str]] = {}
    for name, runs in rows.items():
        for run in runs:
            found = _scores(run, corpus.path, split)
            if found is None:
                failures.setdefault(name, {})[run.seed] = failed.get(run.name, "it ended without scores")
            else:
                for at, scores in found.items():
                    curves[name][at][run.seed] = scores
    return Results(request.size, split, corpus.fps, curves, failures, run_states(rows), {})


def _write(results: Results, out: pathlib.Path) -> None:
    has_scores = any(seeds for curve in results.curves.values() for seeds in curve.values())
    chart = out.with_suffix(".svg")
    if has_scores:
        with whole_file(chart) as path:
            path.write_text(figure(results))
    with whole_file(out) as path:
        path.write_text(as_markdown(results, chart.name if has_scores else None))

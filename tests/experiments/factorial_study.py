"""The factorial study as a command whose training and scoring are stand-ins: python factorial_study.py ARGUMENTS."""

import json
import sys
import time
import zlib

import numpy as np
import reproduce
from tables import factorial, kept_runs
from tables.plan import plan_table, scores_path
from tables.workdirs import is_finished, read_stored

PLANS = {}  # folder of the runs -> plan, which takes a moment to make
SPEAKERS = ("ada", "bea", "cyd", "dot")


def scores(run, oracle=0.9):
    """Scores that depend on the name of a run alone: noise of the seed, effects of coordinator and hierarchy."""
    rng, settings = np.random.default_rng(zlib.crc32(run.name.encode())), run.config
    style = 0.3 if settings.model.inferer.coordinator == "none" else 0.8
    hands = 3.0 if settings.model.inferer.levels else 2.0
    row = {name: 0.6 + 0.01 * rng.normal() for name in ("finger_correlation", "probe_accuracy")}
    row |= {name: style + 0.01 * rng.normal() for name in ("style_handedness", "style_amplitude")}
    row |= {factorial.HANDS_FGD: hands + 0.01 * rng.normal()}
    if settings.model.text.kind == "oracle":
        row["finger_correlation"] = oracle
    talk = {
        "rows": {"model": {name: {"value": value, "low": None, "high": None} for name, value in row.items()}},
        "without_speakers": {name: dict.fromkeys(SPEAKERS, value) for name, value in row.items()},
    }
    split = {"evaluation": {"rows": {}}, "talk": talk}
    return {"model": run.name[-12:], "autoencoder": "cafe", "splits": dict.fromkeys(factorial.SPLITS, split)}


def perform(request, run, worker, stop, seconds=0.02):
    """Stands for a training and its scores; a moment passes between what it writes."""
    plan = PLANS[request.workdir] = PLANS.get(request.workdir) or plan_table(request)
    steps = run.config.train.steps
    if request.has_training and not is_finished(run):
        run.workdir.mkdir(exist_ok=True)
        (run.workdir / "config.json").write_text(run.config.to_json())
        start = {"commit": "abc", "hardware": {"devices": {"abacus": 1}}, "time": str(time.time())}
        (run.workdir / "run.json").write_text(json.dumps({"starts": [start]}))
        (run.workdir / "metrics.jsonl").write_text(f'{{"step": {steps}, "windows_per_second": 2.0}}\n')
        time.sleep(seconds)
        (run.workdir / "latest" / str(steps)).mkdir(parents=True, exist_ok=True)
        (run.workdir / "latest" / str(steps) / "SHA256SUMS").write_text(run.name)
    path = scores_path(run, plan, request)
    if run != plan.autoencoder and path and read_stored(path) is None:
        time.sleep(seconds)
        path.write_text(json.dumps(scores(run)))


def keep_no_weights(run, folder):
    """Stands for the export of the auto-encoder as a model folder."""
    (folder / run.name).mkdir(parents=True, exist_ok=True)
    (folder / run.name / "model.safetensors").write_text("1 2 3")


if __name__ == "__main__":
    kept_runs._keep_weights = keep_no_weights
    sys.exit(reproduce.main(perform=perform))

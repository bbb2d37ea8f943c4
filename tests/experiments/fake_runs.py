"""A study whose training and scoring are stand-ins."""

import json
import threading

from reproduce import reproduce
from tables.plan import plan_table, scores_path
from tables.runs import Stop
from tables.workdirs import is_finished, read_stored

from ha2g_jax.errors import UserError


class FakeRuns:
    """Stands for training and scoring: a row's FGD is its seed plus 1, of HA2G less.

    `unlucky` are words in the names of runs that fail.
    """

    def __init__(self, unlucky=()):
        self.unlucky = unlucky
        self.trained: list[str] = []
        self.scored: list[str] = []
        self.workers: set[int] = set()
        self.barrier: threading.Barrier | None = None

    def __call__(self, request, run, worker, stop):
        self.workers.add(worker)
        if self.barrier:
            self.barrier.wait(10)
        if any(word in run.name for word in self.unlucky):
            raise UserError(f"the loss is\nno number (see {run.workdir}.log)")
        if request.has_training and not is_finished(run):
            self._train(run)
        plan = plan_table(request)
        path = scores_path(run, plan, request)
        if run.name != plan.autoencoder.name and read_stored(path) is None:
            assert path
            self.scored.append(run.name)
            path.write_text(json.dumps(self._scores(run)))

    def _train(self, run):
        steps = run.config.train.steps
        run.workdir.mkdir(exist_ok=True)
        (run.workdir / "config.json").write_text(run.config.to_json())
        for name in ("best", "latest"):
            (run.workdir / name / str(steps)).mkdir(parents=True)
            (run.workdir / name / str(steps) / "SHA256SUMS").write_text(f"{run.name} {steps}")
        lines = [{"step": 1, "loss/total": 2.0}, {"step": 1, "validation/loss/reconstruction": 0.5}]
        lines += [{"step": steps, "loss/total": 1.0}, {"step": steps, "validation/loss/reconstruction": 0.125}]
        (run.workdir / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        start = {"commit": "abc", "hardware": {"devices": {"abacus": 1}}, "host": "desk"}
        (run.workdir / "run.json").write_text(json.dumps({"starts": [start]}))
        self.trained.append(run.name)

    def _scores(self, run):
        value = run.seed + (0.5 if run.config.method == "ha2g" else 1 + 0.01 * run.seed)
        row = {"fgd": {"value": value, "low": value - 0.1, "high": value + 0.1}}
        rows = {"model": row, "ground truth": {"fgd": {"value": 0.0, "low": 0.0, "high": 0.0}}}
        return {
            "model": run.name[-12:],
            "autoencoder": "cafe",
            "splits": {
                "test": {
                    "evaluation": {"rows": rows, "flags": [], "warnings": []},
                    "draws": {"model": [2.0, 1.0], "ground truth": [3.0, 3.0]},
                }
            },
        }


def run_study(request, runs, out=None, stop=None, keep=None):
    out = out or request.workdir / "report.md"
    return reproduce(request, out, "the command", stop or Stop(), runs, keep), out.read_text()

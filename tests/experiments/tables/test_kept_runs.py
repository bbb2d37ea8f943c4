"""Runs are copied without weights, so that a study can be published and continued elsewhere."""

import json
import signal

import pytest
from tables.jobs import Stopped
from tables.plan import is_copy, make_plan

from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import Stop

from .fake_runs import FakeRuns, run_study


def _files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_kept_runs_give_the_same_report_without_weights_and_are_continued(request_, corpus, tmp_path):
    """A study can be published, and continued on another machine, without the weights of its runs."""
    keep = tmp_path / "kept"
    _, report = run_study(request_, FakeRuns(unlucky=("trimodal",)), keep=keep)
    (autoencoder,) = keep.glob("*autoencoder*")
    assert {path.parents[2] for path in keep.rglob("weights")} == {autoencoder}
    assert not [path for path, data in _files(keep).items() if str(tmp_path).encode() in data]
    again = FakeRuns()
    _, from_copies = run_study(request_._replace(workdir=keep, has_training=False), again, tmp_path / "copies.md")
    assert not again.workers
    copies, runs = (make_plan(request_._replace(workdir=folder), corpus).runs[0] for folder in (keep, request_.workdir))
    assert is_copy(copies) and not is_copy(runs)
    found, expected = ([line for line in text.splitlines() if "HA2G" in line] for text in (from_copies, report))
    assert found == expected and "reconstruction error 0.125" in from_copies
    more = FakeRuns()
    assert run_study(request_._replace(workdir=keep), more)[0]
    assert more.trained and all("-trimodal-" in name for name in more.trained)


def test_a_copy_has_what_the_run_has_logged_of_the_validation_split(request_, tmp_path):
    request, runs = request_._replace(table="table12", seeds=(0,)), FakeRuns()
    run_study(request, runs, keep=tmp_path / "kept")
    lines = (tmp_path / "kept" / runs.trained[1] / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line).get("validation/loss/reconstruction") for line in lines] == [0.5, 0.125]


def test_each_run_is_kept_when_it_ends(request_, tmp_path):
    class Stopping(FakeRuns):
        def __call__(self, request, corpus, run, worker, stop):
            super().__call__(request, corpus, run, worker, stop)
            if len(self.scored) == 2:
                stop.number = signal.SIGINT

    runs = Stopping()
    with pytest.raises(Stopped):
        run_study(request_, runs, stop=Stop(), keep=tmp_path / "kept")
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == sorted(runs.trained)


def test_scores_of_another_kind_are_added_to_what_was_kept(request_, tmp_path):
    request, keep = request_._replace(table="table12", seeds=(0,)), tmp_path / "kept"
    run_study(request, FakeRuns(), keep=keep)
    before = _files(keep)
    run_study(request._replace(has_legacy=True), FakeRuns(), keep=keep)
    (added,) = _files(keep).keys() - before.keys()
    assert added.name.startswith("scores-") and before.items() <= _files(keep).items()


def test_two_trainings_of_a_run_are_not_mixed(request_, tmp_path):
    request, keep = request_._replace(table="table12", seeds=(0,)), tmp_path / "kept"
    run_study(request, FakeRuns(), keep=keep)
    (sums,) = keep.glob("*autoencoder*/best/*/SHA256SUMS")
    sums.write_text("other weights")
    before, runs = _files(keep), FakeRuns()
    with pytest.raises(UserError, match="a copy of another training of this run; use another folder"):
        run_study(request, runs, keep=keep)
    assert _files(keep) == before and not runs.workers


def test_keeping_needs_runs(request_, tmp_path):
    with pytest.raises(UserError, match="leave out --keep"):
        run_study(request_._replace(table="table5"), FakeRuns(), keep=tmp_path / "kept")
    assert not (tmp_path / "kept").exists()

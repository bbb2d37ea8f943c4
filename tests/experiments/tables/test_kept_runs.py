"""Finished runs are kept in one table, so that a study can be published and continued elsewhere."""

import json
import pathlib
import signal

import pytest
from tables.kept_runs import FILE, read_kept
from tables.plan import plan_table
from tables.runs import Stop, Stopped

from ha2g_jax.data.corpus import TALK_VERSION
from ha2g_jax.errors import UserError

from ..fake_runs import FakeRuns, run_study


def test_kept_runs_give_the_same_page_without_weights_and_are_continued(request_, tmp_path):
    keep = tmp_path / "kept"
    _, page = run_study(request_, FakeRuns(unlucky=("trimodal",)), keep=keep)
    (autoencoder,) = (path.name for path in keep.iterdir() if path.name != FILE)
    assert [path.name for path in (keep / autoencoder).iterdir()] == ["model.safetensors"]
    text = (keep / FILE).read_text()
    assert str(tmp_path) not in text and "desk" not in text
    again = FakeRuns()
    _, from_table = run_study(request_._replace(workdir=keep, has_training=False), again, tmp_path / "copies.md")
    assert not again.workers
    found, expected = ([line for line in text.splitlines() if "HA2G" in line] for text in (from_table, page))
    assert found == expected and "reconstruction error 0.125" in from_table
    more = FakeRuns()
    assert run_study(request_._replace(workdir=keep), more)[0]
    assert len(more.trained) == 2 and all("-trimodal-" in name for name in more.trained)


def test_the_table_gives_back_every_record(request_, tmp_path):
    """The scores that all runs have alike are stored once; a run twice, or a part of a line, is refused."""
    run_study(request_, FakeRuns(), keep=tmp_path)
    plan, kept = plan_table(request_), read_kept(tmp_path)
    assert {record.name for record in kept.records} == {run.name for run in plan.runs}
    for run in plan.runs:
        record = kept.find(run)
        assert record and record.scores == FakeRuns()._scores(run) and record.config["seed"] == run.seed
        assert [line["validation/loss/reconstruction"] for line in record.validation] == [0.5, 0.125]
    text = (tmp_path / FILE).read_text()
    lines = text.splitlines(keepends=True)
    assert len(lines) == 1 + len(plan.runs)
    for damaged, said in ((text + lines[1], "twice; remove one"), (text[:-9], "is damaged .*; restore")):
        (tmp_path / FILE).write_text(damaged)
        with pytest.raises(UserError, match=said):
            read_kept(tmp_path)


def test_settings_may_come_and_go(request_, tmp_path):
    """A setting that a later version adds or removes does not part a kept run from its row; a changed one does."""
    run_study(request_, FakeRuns(), keep=tmp_path)
    lines = [json.loads(line) for line in (tmp_path / FILE).read_text().splitlines()]
    for line in lines[1:]:
        line["config"]["train"]["forgotten"] = 3
        del line["config"]["train"]["ema"]
    (tmp_path / FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    kept, plan = read_kept(tmp_path), plan_table(request_)
    assert all(kept.find(run) for run in plan.runs)
    changed = plan_table(request_._replace(changes={"train.ema": 0.0}))
    assert not any(kept.find(run) for run in changed.runs)


def test_each_run_is_kept_when_it_ends(request_, tmp_path):
    class Stopping(FakeRuns):
        def __call__(self, request, run, worker, stop):
            super().__call__(request, run, worker, stop)
            if len(self.scored) == 2:
                stop.number = signal.SIGINT

    runs = Stopping()
    with pytest.raises(Stopped):
        run_study(request_, runs, stop=Stop(), keep=tmp_path / "kept")
    kept = read_kept(tmp_path / "kept")
    assert kept.autoencoder and [kept.autoencoder.name, *sorted(runs.scored)] == [
        runs.trained[0],
        *(record.name for record in kept.records),
    ]


@pytest.mark.parametrize("name", [TALK_VERSION, "my recordings"])
def test_a_study_of_talk_goes_on_with_the_corpus_of_another_machine(request_, tmp_path, name):
    """Talk made by the same command may differ in a last bit; of other corpora, only the same bytes are the same."""
    description = pathlib.Path(request_.path, "dataset.json")

    def describe(source, statistics):
        facts = json.loads(description.read_text()) | {"name": name, "source": source, "statistics": statistics}
        description.write_text(json.dumps(facts))

    describe("seed 0", {"lengths": [0.26]})
    keep = tmp_path / "kept"
    run_study(request_, FakeRuns(), keep=keep)
    names = {run.name for run in plan_table(request_).runs}
    describe("seed 0", {"lengths": [0.2600001]})
    there = request_._replace(workdir=keep)
    again = FakeRuns()
    if name == TALK_VERSION:
        assert {run.name for run in plan_table(there).runs} == names
        run_study(there, again, keep=keep)
        assert not again.trained
    else:
        with pytest.raises(UserError, match="another corpus"):
            run_study(there._replace(workdir=tmp_path / "new"), again, keep=keep)
    describe("seed 1", {"lengths": [0.26]})
    assert not plan_table(there).kept.records

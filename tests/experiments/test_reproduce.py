"""A table's runs are trained once, shared, continued and reported; training itself is a stand-in here."""

import json
import os
import shutil
import signal
import threading

import pytest
import reproduce as command
from tables import plan as plan_module
from tables.plan import plan_table, scores_path
from tables.runs import Stopped, stop_signals

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus_statistics import summarise

from .fake_runs import FakeRuns, run_study


def test_everything_is_trained_once_and_reported(request_):
    runs = FakeRuns()
    is_whole, report = run_study(request_, runs)
    assert is_whole
    assert len(runs.trained) == 1 + 5 * 2 and "autoencoder" in runs.trained[0]
    assert runs.scored == runs.trained[1:] and "seed1" not in "".join(runs.scored[:5])
    assert (
        "| HA2G | 5.306, 0.715, 173.9 | 1.000 ±6.353 |" in report
        and "| Trimodal | 12.61, 0.592, 154.1 | 1.505 ±" in report
    )
    assert "id cafe; step " in report and "reconstruction error 0.125" in report
    assert "`the command`" in report and "commit abc; 1 x abacus" in report
    assert str(request_.workdir) not in report
    again = FakeRuns()
    assert run_study(request_, again)[0]
    assert not again.trained and not again.scored and not again.workers


def test_tables_share_runs(request_):
    request = request_._replace(data="bvh", seeds=(0,))
    first = FakeRuns()
    run_study(request, first)
    (full,) = (name for name in first.trained if "-ha2g-" in name)
    for table in ("table11", "table12", "table3"):
        more = FakeRuns()
        run_study(request._replace(table=table), more)
        assert full not in more.trained and not any("autoencoder" in name for name in more.trained)
        assert len(more.trained) == {"table11": 2, "table12": 0, "table3": 6}[table]


def test_a_row_that_another_table_calls_differently_is_the_same_run(request_):
    request = request_._replace(table="table3", seeds=(0,))
    runs = FakeRuns()
    run_study(request, runs)
    (name,) = (name for name in runs.trained if "high-level-feature-only" in name)
    renamed = request.workdir / name.replace("high-level-feature-only", "high-level-only")
    (request.workdir / name).rename(renamed)
    plan = plan_table(request)
    assert plan.rows["high-level feature only"][0].workdir == renamed


def test_changed_settings_and_changed_data_are_other_runs(request_, corpus):
    request = request_._replace(table="table12", seeds=(0,))
    (run,) = plan_table(request).runs
    assert plan_table(request).runs == (run,)
    changed = plan_table(request._replace(changes={"train.steps": 7}))
    assert changed.runs[0].name != run.name and changed.runs[0].config.train.steps == 7
    assert changed.autoencoder.name == plan_table(request).autoencoder.name
    metadata = json.loads((corpus / "dataset.json").read_text())
    (corpus / "dataset.json").write_text(json.dumps(metadata | {"name": "made anew"}))
    assert plan_table(request).runs[0].name != run.name
    moved = corpus.rename(corpus.with_name("elsewhere"))
    (moved / "dataset.json").write_text(json.dumps(metadata))
    assert plan_table(request._replace(path=str(moved))).runs[0].name == run.name


def test_the_recogniser_s_weights_are_of_one_row(request_, corpus):
    request = request_._replace(table="table3", seeds=(0,))
    without, plan = (plan_table(each) for each in (request, request._replace(changes={"model.audio.weights": "w"})))
    assert without.left_out.keys() == plan.rows.keys() - without.rows.keys() == {"HA2G-ASR"} and not plan.left_out
    assert all(plan.rows[row] == runs for row, runs in without.rows.items())
    assert plan.rows["HA2G-ASR"][0].config.model.audio.weights == "w"


def test_a_failed_run_is_reported_and_tried_again(request_):
    is_whole, report = run_study(request_, FakeRuns(unlucky=("trimodal",)))
    assert not is_whole
    assert "- Trimodal, seed 1: failed: the loss is no number (see bvh-debug-trimodal-" in report
    assert "| Trimodal | 12.61, 0.592, 154.1 | - |" in report and "| HA2G | 5.306, 0.715, 173.9 | 1.000 ±" in report
    again = FakeRuns()
    is_whole, report = run_study(request_, again)
    assert is_whole and "failed" not in report
    assert [name.split("-")[2] for name in again.trained] == ["trimodal", "trimodal"]


def test_scores_are_made_anew_when_what_they_depend_on_changes(request_, corpus, monkeypatch):
    request = request_._replace(table="table12", seeds=(0,))
    run_study(request, FakeRuns())
    plan = plan_table(request)
    (run,) = plan.runs
    paths = {scores_path(run, plan, request), scores_path(run, plan, request._replace(has_legacy=True))}
    for name in (run.workdir, plan.autoencoder.workdir):
        (sums,) = (name / "best").glob("*/SHA256SUMS")
        sums.write_text("other weights")
        paths.add(scores_path(run, plan, request))
    monkeypatch.setattr(plan_module, "EVALUATION_VERSION", -1)
    paths.add(scores_path(run, plan, request))
    assert len(paths) == 5
    again = FakeRuns()
    run_study(request, again)
    assert not again.trained and again.scored == [run.name]


def test_several_runs_work_at_once(request_):
    run_study(request_, FakeRuns(unlucky=("-ha2g-",)))
    runs = FakeRuns()
    runs.barrier = threading.Barrier(2)  # passes only if both of the missing runs are under way
    assert run_study(request_._replace(jobs=2), runs)[0]
    assert runs.workers == {0, 1} and len(runs.trained) == 2


def test_an_auto_encoder_without_its_last_checkpoint_is_trained_to_its_end(request_):
    """It was killed behind the last line of its metrics, before the checkpoint was written."""
    request = request_._replace(table="table12", seeds=(0,))
    run_study(request, FakeRuns())
    autoencoder = plan_table(request).autoencoder
    (autoencoder.workdir / "latest" / str(autoencoder.config.train.steps)).rename(autoencoder.workdir / "latest" / "1")
    runs = FakeRuns()
    runs._train = lambda run: runs.trained.append(run.name)  # type: ignore[method-assign]
    run_study(request, runs)
    assert runs.trained == [autoencoder.name]


def test_a_signal_stops_and_the_same_request_continues(request_):
    class Signalled(FakeRuns):
        def __call__(self, request, run, worker, stop):
            if len(self.scored) == 2:
                os.kill(os.getpid(), signal.SIGTERM)
                return
            super().__call__(request, run, worker, stop)

    first = Signalled()
    before = signal.getsignal(signal.SIGTERM)
    with stop_signals() as stop, pytest.raises(Stopped) as stopped:
        run_study(request_, first, stop=stop)
    assert stopped.value.number == signal.SIGTERM and signal.getsignal(signal.SIGTERM) is before
    assert not (request_.workdir / "report.md").exists()
    second = FakeRuns()
    assert run_study(request_, second)[0]
    assert len(second.scored) == 8 and not set(first.scored) & set(second.scored)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"table": "gesture_ablation"}, "choose table4"),
        ({"changes": {"train.stps": 3}}, "no setting 'train.stps'"),
        ({"changes": {"train.schedule": "cosin"}}, "train.schedule is 'cosin'"),
        ({"has_training": False}, "leave out --no-train"),
    ],
)
def test_a_request_that_cannot_be_met_starts_nothing(request_, change, message):
    runs = FakeRuns()
    with pytest.raises(UserError, match=message):
        run_study(request_._replace(**change), runs)
    assert not runs.workers


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--data", "tedd"], "no data 'tedd'; expected one of talk"),
        (["--data", "talk", "--seeds", "0,0"], "gives a seed twice"),
        (["--data", "talk", "--seeds", "20240101"], "at most 1000; give '20240101,' for one seed"),
        (["--data", "bvh:nowhere"], "no corpus in"),
        (["--data", "talk", "--continue", "--keep", __file__], "choose other folders"),
    ],
)
def test_a_mistake_is_one_line(capsys, monkeypatch, tmp_path, flags, message):
    monkeypatch.chdir(tmp_path)
    assert command.main(["table1", *flags]) == 2
    printed = capsys.readouterr().err
    assert message in printed and printed.count("\n") == 1 and not list(tmp_path.iterdir())


def _cells(page, row):
    line = next(line for line in page.splitlines() if line.startswith(f"| {row} "))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_tables_5_and_10_have_the_numbers_of_the_corpus_and_of_the_paper(tiny_talk, tmp_path):
    page, found = command.corpus_page("table5", tiny_talk, "the command"), summarise(tiny_talk)
    assert _cells(page, "TED-Expressive, paper") == ["TED-Expressive, paper", "1,764", "100.8", "240,447", "21 %"]
    total = found["total"]
    numbers = [f"{total['recordings']:,}", f"{total['hours']:,.3f}", f"{total['windows']:,}", "-"]
    assert _cells(page, "this corpus, all splits")[1:] == numbers
    splits = Corpus.open(tiny_talk).splits
    assert sum(int(_cells(page, f"this corpus, {split}")[3].replace(",", "")) for split in splits) == total["windows"]
    elbow = found["training"]["joints"]["left_elbow"]["corpus"]
    cells = _cells(command.corpus_page("table10", tiny_talk, "the command"), "left elbow")
    assert cells[1:3] == [f"{elbow['mean']:.1f}", f"{elbow['std']:.1f}"] and cells[5] == "75.1"
    path = shutil.copytree(tiny_talk, tmp_path / "corpus")
    (path / "dataset.json").write_text((path / "dataset.json").read_text().replace('"train"', '"other"'))
    with pytest.raises(UserError, match="no training split"):
        command.corpus_page("table10", path, "")

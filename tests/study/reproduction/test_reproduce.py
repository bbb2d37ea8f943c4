"""A table's runs are trained once, shared, continued and reported; training itself is a stand-in here."""

import json
import os
import pathlib
import signal
import threading

import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import Stop, stop_signals
from ha2g_jax.study.reproduction import plan as plan_module
from ha2g_jax.study.reproduction.jobs import Stopped
from ha2g_jax.study.reproduction.plan import (
    is_copy,
    is_finished,
    make_plan,
    read_stored,
    scores_path,
)
from ha2g_jax.study.reproduction.reproduce import reproduce
from ha2g_jax.study.reproduction.request import Request, parse_changes, parse_seeds

SPLIT = {"clips": 2, "speakers": ["ada"], "shards": []}


@pytest.fixture
def corpus(tmp_path):
    folder = tmp_path / "corpus"
    folder.mkdir()
    metadata = {
        "schema_version": 2,
        "name": "made up",
        "source": "a test",
        "skeleton": "ted_expressive",
        "fps": 15,
        "speakers": ["ada"],
        "splits": {"train": SPLIT, "val": SPLIT, "test": SPLIT},
        "statistics": {},
        "words": {},
        "import": {},
    }
    (folder / "dataset.json").write_text(json.dumps(metadata))
    return folder


@pytest.fixture
def request_(tmp_path, corpus):
    return Request("table1", "bvh", "debug", str(corpus), (0, 1), tmp_path / "runs")


class FakeRuns:
    """Stands for training and scoring: a row's FGD is its seed plus 1, of HA2G less.

    `unlucky` are words in the names of runs that fail, `interrupted` of those that stop half-way.
    """

    def __init__(self, unlucky=(), interrupted=()):
        self.unlucky, self.interrupted = unlucky, interrupted
        self.trained: list[str] = []
        self.scored: list[str] = []
        self.workers: set[int] = set()
        self.barrier: threading.Barrier | None = None

    def __call__(self, request, corpus, run, worker, stop):
        self.workers.add(worker)
        if self.barrier:
            self.barrier.wait(10)
        if any(word in run.name for word in self.unlucky):
            raise UserError(f"the loss is\nno number (see {run.workdir}.log)")
        if request.has_training and not is_finished(run):
            self._train(run)
        plan = make_plan(request, corpus)
        path = scores_path(run, plan, request.has_legacy)
        if run.name != plan.autoencoder.name and read_stored(path) is None:
            assert path
            self.scored.append(run.name)
            path.write_text(json.dumps(self._scores(run)))

    def _train(self, run):
        steps = run.config.train.steps // 2 if any(word in run.name for word in self.interrupted) else None
        steps = steps or run.config.train.steps
        run.workdir.mkdir(exist_ok=True)
        (run.workdir / "config.json").write_text(run.config.to_json())
        for name in ("best", "latest"):
            (run.workdir / name / str(steps)).mkdir(parents=True)
            (run.workdir / name / str(steps) / "SHA256SUMS").write_text(f"{run.name} {steps}")
        lines = [{"step": 1, "loss/total": 2.0}, {"step": 1, "validation/loss/reconstruction": 0.5}]
        lines += [{"step": steps, "loss/total": 1.0}, {"step": steps, "validation/loss/reconstruction": 0.125}]
        (run.workdir / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        (run.workdir / "best" / str(steps) / "weights").write_text("1 2 3")
        (run.workdir / "assets.json").write_text("{}")
        start = {"commit": "abc", "hardware": {"devices": {"abacus": 1}}}
        (run.workdir / "run.json").write_text(json.dumps({"starts": [start]}))
        self.trained.append(run.name)

    def _scores(self, run):
        value = run.seed + (0.5 if run.config.method == "ha2g" else 1 + 0.01 * run.seed)
        row = {"fgd": {"value": value, "low": value - 0.1, "high": value + 0.1}}
        rows = {"model": row, "ground truth": {"fgd": {"value": 0.0, "low": 0.0, "high": 0.0}}}
        return {
            "model": "feed",
            "autoencoder": "cafe",
            "splits": {
                "test": {
                    "evaluation": {"rows": rows, "flags": [], "warnings": []},
                    "draws": {"model": [2.0, 1.0], "ground truth": [3.0, 3.0]},
                }
            },
        }


def _reproduce(request, runs, out=None, stop=None, keep=None):
    out = out or request.workdir / "report.md"
    return reproduce(request, out, "the command", stop or Stop(), runs, keep), out.read_text()


def test_everything_is_trained_once_and_reported(request_):
    runs = FakeRuns()
    is_whole, report = _reproduce(request_, runs)
    assert is_whole
    assert len(runs.trained) == 1 + 5 * 2 and "autoencoder" in runs.trained[0]
    assert runs.scored == runs.trained[1:] and "seed1" not in "".join(runs.scored[:5])
    assert "| HA2G | 5.306 | 1.000 [" in report and "| Trimodal | 12.61 | 1.505 [" in report
    assert "id cafe; step " in report and "reconstruction error 0.125" in report
    assert "`the command`" in report and "commit abc; 1 x abacus" in report
    assert str(request_.workdir) not in report
    again = FakeRuns()
    assert _reproduce(request_, again)[0]
    assert not again.trained and not again.scored and not again.workers


def test_tables_share_runs(request_):
    request = request_._replace(data="bvh", seeds=(0,))
    first = FakeRuns()
    _reproduce(request, first)
    (full,) = (name for name in first.trained if "-ha2g-" in name)
    for table in ("table11", "table12", "table3"):
        more = FakeRuns()
        _reproduce(request._replace(table=table), more)
        assert full not in more.trained and not any("autoencoder" in name for name in more.trained)
        assert len(more.trained) == {"table11": 2, "table12": 0, "table3": 6}[table]


def test_a_row_that_another_table_calls_differently_is_the_same_run(request_):
    request = request_._replace(table="table3", seeds=(0,))
    runs = FakeRuns()
    _reproduce(request, runs)
    (name,) = (name for name in runs.trained if "high-level-feature-only" in name)
    renamed = request.workdir / name.replace("high-level-feature-only", "high-level-only")
    (request.workdir / name).rename(renamed)
    plan = make_plan(request, pathlib.Path(request.path))
    assert plan.rows["high-level feature only"][0].workdir == renamed


def test_changed_settings_and_changed_data_are_other_runs(request_, corpus):
    request = request_._replace(table="table12", seeds=(0,))
    (run,) = make_plan(request, corpus).runs
    assert make_plan(request, corpus).runs == (run,)
    changed = make_plan(request._replace(changes={"train.steps": 7}), corpus)
    assert changed.runs[0].name != run.name and changed.runs[0].config.train.steps == 7
    assert changed.autoencoder.name == make_plan(request, corpus).autoencoder.name
    metadata = json.loads((corpus / "dataset.json").read_text())
    (corpus / "dataset.json").write_text(json.dumps(metadata | {"name": "made anew"}))
    assert make_plan(request, corpus).runs[0].name != run.name
    moved = corpus.rename(corpus.with_name("elsewhere"))
    (moved / "dataset.json").write_text(json.dumps(metadata))
    assert make_plan(request, moved).runs[0].name == run.name


def test_the_recogniser_s_weights_are_of_one_row(request_, corpus):
    request = request_._replace(table="table3", seeds=(0,))
    without, plan = (
        make_plan(each, corpus) for each in (request, request._replace(changes={"model.audio.weights": "w"}))
    )
    assert without.left_out.keys() == plan.rows.keys() - without.rows.keys() == {"HA2G-ASR"} and not plan.left_out
    assert all(plan.rows[row] == runs for row, runs in without.rows.items())
    assert plan.rows["HA2G-ASR"][0].config.model.audio.weights == "w"


def test_a_row_that_lacks_an_input_is_left_out_and_named(request_, capsys):
    is_whole, report = _reproduce(request_._replace(table="table3", seeds=(0,)), FakeRuns())
    line = "HA2G-ASR: it needs the weights of Whisper: --changes model.audio.weights=FOLDER"
    assert is_whole and f"## Left out\n\n- {line}" in report
    assert "HA2G-ASR is left out: it needs" in capsys.readouterr().err


def test_a_failed_run_is_reported_and_tried_again(request_):
    is_whole, report = _reproduce(request_, FakeRuns(unlucky=("trimodal",)))
    assert not is_whole
    assert "- Trimodal, seed 1: failed: the loss is no number (see bvh-debug-trimodal-" in report
    assert "0, 2 failed" in report and "| HA2G | 5.306 | 1.000 [" in report
    again = FakeRuns()
    is_whole, report = _reproduce(request_, again)
    assert is_whole and "failed" not in report
    assert [name.split("-")[2] for name in again.trained] == ["trimodal", "trimodal"]


def test_a_failed_autoencoder_ends_it(request_):
    with pytest.raises(UserError, match="auto-encoder was not trained: the loss is no number"):
        _reproduce(request_, FakeRuns(unlucky=("autoencoder",)))


def test_an_unfinished_run_is_only_scored_without_training(request_):
    request = request_._replace(table="table12", seeds=(0,), changes={"train.steps": 8})
    is_whole, report = _reproduce(request, FakeRuns(interrupted=("ha2g",)))
    assert not is_whole and "it ended without scores" in report
    runs = FakeRuns()
    request = request._replace(table="table3", has_training=False)
    is_whole, report = _reproduce(request, runs)
    assert not runs.trained and len(runs.scored) <= 1
    assert "| HA2G Full | 5.306 | 0.500 (0.400, 0.600) |" in report and "4 of 8" in report
    assert "- HA2G without text, seed 0: failed: not trained" in report and not is_whole


def test_scores_are_made_anew_when_what_they_depend_on_changes(request_, corpus, monkeypatch):
    request = request_._replace(table="table12", seeds=(0,))
    _reproduce(request, FakeRuns())
    plan = make_plan(request, corpus)
    (run,) = plan.runs
    paths = {scores_path(run, plan, False), scores_path(run, plan, True)}
    for name in (run.workdir, plan.autoencoder.workdir):
        (sums,) = (name / "best").glob("*/SHA256SUMS")
        sums.write_text("other weights")
        paths.add(scores_path(run, plan, False))
    monkeypatch.setattr(plan_module, "EVALUATION_VERSION", -1)
    paths.add(scores_path(run, plan, False))
    assert len(paths) == 5
    again = FakeRuns()
    _reproduce(request, again)
    assert not again.trained and again.scored == [run.name]


def test_damaged_scores_are_made_anew(request_, corpus):
    request = request_._replace(table="table12", seeds=(0,))
    _reproduce(request, FakeRuns())
    plan = make_plan(request, corpus)
    path = scores_path(plan.runs[0], plan, False)
    assert path
    path.write_text('{"half":')

    class Repaired(FakeRuns):
        def __call__(self, request, corpus, run, worker, stop):
            path.unlink()
            super().__call__(request, corpus, run, worker, stop)

    again = Repaired()
    assert _reproduce(request, again)[0] and again.scored == [plan.runs[0].name]


def test_several_runs_work_at_once(request_):
    _reproduce(request_, FakeRuns(unlucky=("-ha2g-",)))
    runs = FakeRuns()
    runs.barrier = threading.Barrier(2)  # passes only if both of the missing runs are under way
    assert _reproduce(request_._replace(jobs=2), runs)[0]
    assert runs.workers == {0, 1} and len(runs.trained) == 2


def test_a_signal_stops_and_the_same_request_continues(request_):
    class Signalled(FakeRuns):
        def __call__(self, request, corpus, run, worker, stop):
            if len(self.scored) == 2:
                os.kill(os.getpid(), signal.SIGTERM)
                return
            super().__call__(request, corpus, run, worker, stop)

    first = Signalled()
    before = signal.getsignal(signal.SIGTERM)
    with stop_signals() as stop, pytest.raises(Stopped) as stopped:
        _reproduce(request_, first, stop=stop)
    assert stopped.value.number == signal.SIGTERM and signal.getsignal(signal.SIGTERM) is before
    assert not (request_.workdir / "report.md").exists()
    second = FakeRuns()
    assert _reproduce(request_, second)[0]
    assert len(second.scored) == 8 and not set(first.scored) & set(second.scored)


def _files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_kept_runs_give_the_same_report_without_weights_and_are_continued(request_, corpus, tmp_path):
    """A study can be published, and continued on another machine, without the weights of its runs."""
    keep = tmp_path / "kept"
    _, report = _reproduce(request_, FakeRuns(unlucky=("trimodal",)), keep=keep)
    (autoencoder,) = keep.glob("*autoencoder*")
    assert {path.parents[2] for path in keep.rglob("weights")} == {autoencoder}
    assert not [path for path, data in _files(keep).items() if str(tmp_path).encode() in data]
    again = FakeRuns()
    _, from_copies = _reproduce(request_._replace(workdir=keep, has_training=False), again, tmp_path / "copies.md")
    assert not again.workers
    copies, runs = (make_plan(request_._replace(workdir=folder), corpus).runs[0] for folder in (keep, request_.workdir))
    assert is_copy(copies) and not is_copy(runs)
    found, expected = ([line for line in text.splitlines() if "HA2G" in line] for text in (from_copies, report))
    assert found == expected and "reconstruction error 0.125" in from_copies
    more = FakeRuns()
    assert _reproduce(request_._replace(workdir=keep), more)[0]
    assert more.trained and all("-trimodal-" in name for name in more.trained)


def test_a_copy_has_what_the_run_has_logged_of_the_validation_split(request_, tmp_path):
    request, runs = request_._replace(table="table12", seeds=(0,)), FakeRuns()
    _reproduce(request, runs, keep=tmp_path / "kept")
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
        _reproduce(request_, runs, stop=Stop(), keep=tmp_path / "kept")
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == sorted(runs.trained)


def test_scores_of_another_kind_are_added_to_what_was_kept(request_, tmp_path):
    request, keep = request_._replace(table="table12", seeds=(0,)), tmp_path / "kept"
    _reproduce(request, FakeRuns(), keep=keep)
    before = _files(keep)
    _reproduce(request._replace(has_legacy=True), FakeRuns(), keep=keep)
    (added,) = _files(keep).keys() - before.keys()
    assert added.name.startswith("scores-") and before.items() <= _files(keep).items()


def test_two_trainings_of_a_run_are_not_mixed(request_, tmp_path):
    request, keep = request_._replace(table="table12", seeds=(0,)), tmp_path / "kept"
    _reproduce(request, FakeRuns(), keep=keep)
    (sums,) = keep.glob("*autoencoder*/best/*/SHA256SUMS")
    sums.write_text("other weights")
    before, runs = _files(keep), FakeRuns()
    with pytest.raises(UserError, match="a copy of another training of this run; use another folder"):
        _reproduce(request, runs, keep=keep)
    assert _files(keep) == before and not runs.workers


def test_keeping_needs_runs(request_, tmp_path):
    with pytest.raises(UserError, match="leave out --keep"):
        _reproduce(request_._replace(table="table5"), FakeRuns(), keep=tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"table": "gesture_ablation"}, "choose table4"),
        ({"path": ""}, "needs the folder of a corpus"),
        ({"seeds": (1, 1)}, "each once"),
        ({"changes": {"train.stps": 3}}, "no setting 'train.stps'"),
        ({"changes": {"train.steps": "many"}}, "train.steps cannot be 'many'"),
        ({"data": "talk"}, "no clips in the split test_unseen_speakers"),
        ({"has_training": False}, "leave out --no-train"),
    ],
)
def test_a_request_that_cannot_be_met_starts_nothing(request_, change, message):
    runs = FakeRuns()
    with pytest.raises(UserError, match=message):
        _reproduce(request_._replace(**change), runs)
    assert not runs.workers


def test_flags_are_read():
    assert parse_seeds("3") == (0, 1, 2) and parse_seeds("0,5,7") == (0, 5, 7) and parse_seeds("4,") == (4,)
    for text in ("", "three", "1;2", "-1"):
        with pytest.raises(UserError, match="number of seeds"):
            parse_seeds(text)
    found = parse_changes(["train.steps=300", "loss.gan=minimax", "train.betas=(0.5,0.9)"])
    assert found == {"train.steps": 300, "loss.gan": "minimax", "train.betas": (0.5, 0.9)}
    with pytest.raises(UserError, match="not KEY=VALUE"):
        parse_changes(["train.steps"])
    with pytest.raises(UserError, match="cannot set seed; give --seeds"):
        parse_changes(["seed=7"])

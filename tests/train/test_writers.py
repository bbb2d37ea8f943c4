"""Other programs can read the files of a run, and a run that continues removes lines that it will write again."""

import json
import sys

import pytest
from tensorboard.backend.event_processing import event_accumulator

from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.train.log import open_writers
from ha2g_jax.train.workdir import METRICS, read_metrics


@pytest.fixture
def config():
    return configs.debug(configs.paper("ted_gesture"))


@pytest.fixture
def write(tmp_path, config):
    """A function that starts at a step and writes a line for each given step, whose metric is twice the step."""

    def write(start, *steps, is_first=True):
        writer = open_writers(tmp_path, start, config, is_first)
        for step in steps:
            writer.write(step, {"loss/huber": 2 * step + 1e-9})
        writer.close()

    return write


def _scalars(folder):
    """Read (step, value) of the metric with TensorBoard's own reader."""
    events = event_accumulator.EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return [(event.step, event.value) for event in events.Scalars("loss/huber")]


def test_lines_have_six_digits_and_tensorboard_has_the_same(write, tmp_path):
    write(0, 1, 2)
    assert (tmp_path / METRICS).read_text().splitlines()[1] == '{"step": 2, "loss/huber": 4.0}'
    assert _scalars(tmp_path) == [(1, 2.0), (2, 4.0)]


def test_a_run_that_goes_on_hides_what_it_writes_again(write, tmp_path):
    write(0, 1, 2, 3)
    with (tmp_path / METRICS).open("a") as file:
        file.write('{"step": 4, "loss/hub')  # as a kill leaves them
    (events,) = (tmp_path / "tensorboard").iterdir()
    events.write_bytes(events.read_bytes()[:-5])
    write(2, 3, 4)
    assert [(line["step"], line["loss/huber"]) for line in read_metrics(tmp_path / METRICS)] == [
        (1, 2.0),
        (2, 4.0),
        (3, 6.0),
        (4, 8.0),
    ]
    assert _scalars(tmp_path) == [(1, 2.0), (2, 4.0), (3, 6.0), (4, 8.0)]


def test_a_run_killed_before_its_first_checkpoint_starts_over(write, tmp_path):
    write(0, 1, 2)
    write(0, 1)
    assert [line["step"] for line in read_metrics(tmp_path / METRICS)] == [1]
    assert _scalars(tmp_path) == [(1, 2.0)]


def test_only_the_first_host_writes(write, tmp_path):
    write(0, 1, is_first=False)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_named(tmp_path, config):
    writer = open_writers(tmp_path, 0, config, is_first=True)
    (tmp_path / METRICS).unlink()
    (tmp_path / METRICS).symlink_to("/dev/full")
    with pytest.raises(UserError, match=r"cannot write .*metrics\.jsonl \(no space left on device\)"):
        writer.write(1, {"loss/huber": 1.0})
    writer.close()


def test_a_folder_that_cannot_be_written_is_named(tmp_path, config):
    (tmp_path / "tensorboard").write_text("")
    with pytest.raises(UserError, match=r"cannot write .*tensorboard \(file exists\)"):
        open_writers(tmp_path, 0, config, is_first=True)


def test_metrics_that_are_not_there_are_named(tmp_path):
    with pytest.raises(UserError, match=r"no metrics in .*metrics\.jsonl"):
        read_metrics(tmp_path / METRICS)


class _Wandb:
    """Replacement of the package that records the calls."""

    class Settings(dict):
        pass

    def __init__(self):
        self.begun, self.lines, self.is_finished = [], [], False

    def init(self, **arguments):
        self.begun.append(arguments)
        return self

    def define_metric(self, name, step_metric):
        self.axis = (name, step_metric)

    def log(self, line):
        self.lines.append(line)

    def finish(self):
        self.is_finished = True


def test_every_start_reports_to_one_wandb_run(write, tmp_path, config, monkeypatch):
    wandb = _Wandb()
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    monkeypatch.setitem(sys.modules, "wandb.errors", wandb)
    config.train.wandb = "gestures"
    write(0, 1, 2)
    write(1, 2)
    first, second = wandb.begun
    assert first["id"] == second["id"] == json.loads((tmp_path / "run.json").read_text())["wandb_id"]
    assert (first["project"], first["config"]["train"]["wandb"]) == ("gestures", "gestures")
    assert wandb.axis == ("*", "step") and [line["step"] for line in wandb.lines] == [1, 2, 2]
    assert wandb.is_finished


def test_wandb_that_is_missing_is_named(write, config, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    config.train.wandb = "gestures"
    with pytest.raises(UserError, match=r"'gestures' but .* not installed: pip install 'ha2g-jax\[wandb\]'"):
        write(0, 1)


def test_without_tensorboard_the_metrics_are_written_and_one_line_says_so(write, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    write(0, 1)
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "pip install 'ha2g-jax[report]'" in printed
    assert [path.name for path in tmp_path.iterdir()] == [METRICS]


def test_some_lines_and_the_last_can_be_read_alone(tmp_path):
    path = tmp_path / METRICS
    path.write_text(
        '{"step": 1, "x": 1}\n{"step": 2, "y": 2}\n{"step": 3, "x": 3}\n{"step": 4, "x": 4}\n{"step": 5, "y"'
    )
    assert [line["step"] for line in read_metrics(path, '"y"')] == [2, 4]
    assert [line["step"] for line in read_metrics(path, '"x"')] == [1, 3, 4]

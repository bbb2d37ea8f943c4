"""Lines are exact means, also across a resume; their speeds count only the time of training."""

import io
import json
import re
import sys
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest
import tqdm

from ha2g_jax.config import presets
from ha2g_jax.progress import progress_bar
from ha2g_jax.train import log as logs
from ha2g_jax.train.log import NotFinite, StepLog, Writer
from ha2g_jax.train.workdir import METRICS, read_metrics


class _Lines(list):
    """A writer that stores the lines."""

    def write(self, step, metrics):
        self.append((step, metrics))

    def close(self):
        pass


@pytest.fixture
def lines():
    return _Lines()


@pytest.fixture
def start(lines):
    """A function that starts a log for batches of two windows."""

    def start(every=2, pending=None):
        bar = tqdm.tqdm(disable=True)
        return StepLog(lines, bar, batch_size=2, is_due=lambda step: step % every == 0, pending=pending)

    return start


@pytest.fixture
def clock(monkeypatch):
    """A function that advances the clock of the log."""
    now = [100.0]
    monkeypatch.setattr(logs.time, "perf_counter", lambda: now[0])

    def sleep(seconds):
        now[0] += seconds

    return sleep


def _metrics(huber=0.0, **others):
    return {"loss/huber": jnp.float32(huber)} | {name: jnp.float32(value) for name, value in others.items()}


def test_metrics_are_means_written_one_step_late(start, lines):
    log = start()
    for step, value in ((1, 1.0), (2, 3.0)):
        log.add(step, _metrics(value))
    assert lines == []
    log.flush()
    log.flush()  # there is nothing left to process
    ((step, line),) = lines
    assert (step, line["loss/huber"]) == (2, 2.0)


def test_a_run_that_goes_on_writes_the_means_of_one_that_was_not_stopped(start, lines):
    values = np.random.default_rng(0).normal(size=7).astype(np.float32)
    whole = start(every=7)
    for step, value in enumerate(values, 1):
        whole.add(step, _metrics(value))
    whole.flush()
    stopped = start(every=7)
    for step, value in enumerate(values[:3], 1):
        stopped.add(step, _metrics(value))
    stopped.flush()
    resumed = start(every=7, pending=json.loads(json.dumps(stopped.state())))
    for step, value in enumerate(values[3:], 4):
        resumed.add(step, _metrics(value))
    resumed.flush()
    (_, expected), (_, found) = lines
    assert found["loss/huber"] == expected["loss/huber"]
    assert resumed.state() == {"steps": 0, "sums": {}}


def test_speeds_are_of_training_alone(start, lines, clock):
    log = start(every=3)
    for step in range(1, 8):
        with log.waiting():
            clock(0.5 if step > 1 else 40.0)  # until the first batch is there
        with log.stepping():
            clock(0.25 if step > 1 else 60.0)  # to compile
        log.add(step, _metrics())
        if step == 4:
            with log.apart():
                clock(1000.0)
    (_, first), (_, second) = lines
    assert first["compile_seconds"] == 60.0 and "compile_seconds" not in second
    for line in (first, second):
        assert line["windows_per_second"] == pytest.approx(2 / 0.75)
        assert line["waiting_percent"] == pytest.approx(100 * 0.5 / 0.75)
    assert (first["seconds"], second["seconds"]) == pytest.approx((102.25, 1104.5))
    one = start(every=1)  # a line of the first step alone has no speed
    one.add(1, _metrics())
    one.flush()
    assert "windows_per_second" not in lines[-1][1]


def test_the_device_is_at_work_while_a_flush_waits_for_it(start, lines, clock, monkeypatch):
    log = start(every=2)
    read = logs.jax.device_get
    monkeypatch.setattr(logs.jax, "device_get", lambda arrays: (clock(0.5), read(arrays))[1])
    for step in range(1, 5):
        log.add(step, _metrics())
        with log.apart():
            clock(1000.0)
            log.flush()
            clock(1000.0)
    assert [step for step, _ in lines] == [2, 4]
    assert [line["windows_per_second"] for _, line in lines] == pytest.approx([4.0, 4.0])


def test_the_terms_that_are_not_finite_are_named(start, lines):
    log = start(every=4)
    log.add(1, _metrics(1.0))
    log.add(2, _metrics(np.inf) | {"loss/total": jnp.float32(np.nan), "grad_norm/generator": jnp.float32(np.nan)})
    with pytest.raises(NotFinite, match="loss/huber not finite at step 2") as caught:
        log.add(3, _metrics(2.0))
    assert (caught.value.step, caught.value.names) == (2, ["loss/huber"])
    ((step, line),) = lines  # what was sound is not lost
    assert (step, line["loss/huber"]) == (1, 1.0)
    log = start()
    log.add(1, _metrics() | {"grad_norm/generator": jnp.float32(np.nan)})
    with pytest.raises(NotFinite, match="grad_norm/generator not finite at step 1"):
        log.flush()


@pytest.fixture
def config():
    return presets.sized("ted_gesture", "debug")


@pytest.fixture
def write(tmp_path, config):
    """A function that starts at a step and writes a line for each given step, whose metric is twice the step."""

    def write(start, *steps, is_first=True):
        writer = Writer(tmp_path, start, config, is_first)
        for step in steps:
            writer.write(step, {"loss/huber": 2 * step + 1e-9})
        writer.close()

    return write


def _scalars(folder):
    """Read (step, value) of the metric with TensorBoard's own reader."""
    from tensorboard.backend.event_processing import event_accumulator

    events = event_accumulator.EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return [(event.step, event.value) for event in events.Scalars("loss/huber")]


def test_lines_have_six_digits_and_tensorboard_has_the_same(write, tmp_path):
    write(0, 1, is_first=False)  # only the first host writes
    assert not list(tmp_path.iterdir())
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
    write(0, 1)  # after a kill before the first checkpoint
    assert [line["step"] for line in read_metrics(tmp_path / METRICS)] == [1]
    assert _scalars(tmp_path) == [(1, 2.0)]


def test_every_start_reports_to_one_wandb_run(write, tmp_path, config, monkeypatch):
    wandb = mock.MagicMock()
    for name in ("wandb", "wandb.errors"):
        monkeypatch.setitem(sys.modules, name, wandb)
    config.train.wandb = "gestures"
    write(0, 1, 2)
    write(1, 2)
    first, second = (call.kwargs for call in wandb.init.call_args_list)
    assert first["id"] == second["id"] == json.loads((tmp_path / "run.json").read_text())["wandb_id"]
    assert (first["project"], first["config"]["train"]["wandb"]) == ("gestures", "gestures")
    run = wandb.init.return_value
    run.define_metric.assert_called_with("*", step_metric="step")
    assert [call.args[0]["step"] for call in run.log.call_args_list] == [1, 2, 2]
    assert run.finish.call_count == 2


def test_without_tensorboard_the_metrics_are_written_and_one_line_says_so(write, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    write(0, 1)
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "pip install 'ha2g-jax[report]'" in printed
    assert [path.name for path in tmp_path.iterdir()] == [METRICS]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_the_bar_shows_step_loss_speed_and_time_left(is_terminal, clock, lines, monkeypatch):
    """On a terminal, also one without a size, and as lines elsewhere; before the first line of metrics, too."""
    stderr = io.StringIO()
    stderr.isatty = lambda: is_terminal
    monkeypatch.setattr(sys, "stderr", stderr)
    with progress_bar("talk", 9, "step", initial=2, line_seconds=1e-9) as bar:
        log = StepLog(lines, bar, batch_size=2, is_due=lambda step: step == 100)
        for step, huber in enumerate((4.0, 3.0, 2.0), 3):
            log.add(step, _metrics(huber))
            clock(0.5)
        log.flush()
        bar.refresh()
    shown = re.split(r"[\r\n]", stderr.getvalue())
    assert any(re.search(r"^talk: .*5 of 9 steps, [\d:]+ left, huber loss 3.0000, 2 steps/s", text) for text in shown)

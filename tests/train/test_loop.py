"""A run writes what it promises, stops cleanly, and goes on as if it had never been stopped."""

import contextlib
import math
import pathlib
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tqdm

from ha2g_jax import launch
from ha2g_jax.errors import UserError
from ha2g_jax.train import loop, model_folder
from ha2g_jax.train.writers import MetricsWriter, StepLog, read_metrics

CONFIG = pathlib.Path(__file__).parent.parent.parent / "experiments" / "configs" / "talk.py"


@pytest.fixture(scope="module")
def config_for(tiny_talk):
    """A function from overrides of the debug config to the config, on the tiny corpus."""

    def config_for(**settings):
        overrides = [f"--config.train.{name}={value}" for name, value in settings.items()]
        return launch.load_config(f"{CONFIG}:debug", [f"--config.data.path={tiny_talk}", *overrides])

    return config_for


@pytest.fixture(scope="module")
def run(config_for, tmp_path_factory):
    """The workdir of a run of four steps, with checkpoints at 2 and 4."""
    workdir = tmp_path_factory.mktemp("runs") / "whole"
    loop.train(config_for(steps=4), workdir)
    return workdir


def _parameters(workdir):
    return jax.tree.leaves(model_folder.load(workdir / "latest").variables)


def test_a_run_writes_metrics_and_checkpoints(run):
    lines = read_metrics(run / loop.METRICS)
    assert [line["step"] for line in lines] == [1, 2, 2, 3, 4, 4]
    assert all(math.isfinite(value) for line in lines for value in line.values())
    assert {"loss/huber", "loss/total", "grad_norm/generator", "windows_per_second", "seconds"} <= lines[0].keys()
    assert {"validation/loss/huber", "validation/loss/total"} <= lines[2].keys()
    assert sorted(path.name for path in (run / "latest").iterdir() if path.is_dir()) == ["2", "4"]
    assert len([path for path in (run / "best").iterdir() if path.is_dir()]) == 1


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(run, config_for, tmp_path, monkeypatch):
    add = StepLog.add

    def add_and_stop(self, step, metrics):
        add(self, step, metrics)
        if step == 1:
            signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        patch.setattr(StepLog, "add", add_and_stop)
        loop.train(config_for(steps=3), tmp_path)
    assert signal.getsignal(signal.SIGTERM) is before
    assert [path.name for path in (tmp_path / "latest").iterdir() if path.is_dir()] == ["1"]

    with (tmp_path / loop.METRICS).open("a") as file:
        file.write('{"step": 2, "loss/total": 0.0}\n{"step": 3, "los')  # as a killed run leaves it
    loop.train(config_for(steps=4), tmp_path)
    for found, expected in zip(_parameters(tmp_path), _parameters(run), strict=True):
        np.testing.assert_array_equal(found, expected)
    whole, resumed = read_metrics(run / loop.METRICS), read_metrics(tmp_path / loop.METRICS)
    assert [line["step"] for line in resumed] == [line["step"] for line in whole]
    assert resumed[-1] == whole[-1]


def test_any_checkpoint_can_be_exported(run, tmp_path):
    for number, source in enumerate((run, run / "latest" / "2")):
        folder = model_folder.export(source, tmp_path / str(number))
        exported, original = model_folder.load(folder), model_folder.load(source)
        jax.tree.map(np.testing.assert_array_equal, exported.variables, original.variables)
        assert exported.assets.hash == original.assets.hash
        assert len(exported.assets.speakers) == 3  # of four speakers one is not in training
        assert all(f_id.shape == (18,) for f_id in exported.assets.speakers.values())
        np.testing.assert_allclose(np.linalg.norm(exported.assets.seed_poses, axis=-1), 1, atol=1e-5)
    with pytest.raises(UserError, match=r"no checkpoint in .*latest/3"):
        model_folder.load(run / "latest" / "3")


def test_another_config_is_refused(run, config_for):
    before = (run / "config.json").read_text()
    with pytest.raises(UserError, match=r"train\.learning_rate \(0\.0005 there, 0\.1 here\)"):
        loop.train(config_for(learning_rate=0.1), run)
    assert (run / "config.json").read_text() == before


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"batch_size": 100_000}, "more than the"),
        ({"steps": 0}, "at least 1"),
        ({"best_by": "loss/hubber"}, "expected one of loss/gan"),
        ({"devices": 99}, "devices, not 99"),
    ],
)
def test_settings_that_cannot_be_used_leave_nothing_behind(config_for, tmp_path, settings, message):
    with pytest.raises(UserError, match=message):
        loop.train(config_for(**settings), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_data_that_do_not_fit_the_config_are_refused(tiny_talk, tmp_path):
    gesture = CONFIG.with_name("ted_gesture.py")
    config = launch.load_config(f"{gesture}:debug", [f"--config.data.path={tiny_talk}"])
    with pytest.raises(UserError, match="ted_expressive at 15 fps, the config ted_gesture"):
        loop.train(config, tmp_path / "run")


@pytest.fixture
def log(tmp_path):
    """A log of batches of two that writes every other step."""
    with contextlib.closing(MetricsWriter(tmp_path / "metrics.jsonl", step=0)) as writer:
        yield StepLog(writer, tqdm.tqdm(disable=True), batch_size=2, is_due=lambda step: step % 2 == 0)


def test_metrics_are_means_written_one_step_late(log, tmp_path):
    for step, value in ((1, 1.0), (2, 3.0)):
        log.add(step, {"loss/huber": jnp.float32(value)})
    assert read_metrics(tmp_path / "metrics.jsonl") == []
    log.flush()
    (line,) = read_metrics(tmp_path / "metrics.jsonl")
    assert (line["step"], line["loss/huber"]) == (2, 2.0)


def test_a_loss_that_is_not_finite_is_named(log, tmp_path):
    log.add(6, {"loss/huber": jnp.float32(1), "loss/physical": jnp.float32(jnp.nan)})
    with pytest.raises(UserError, match="loss/physical not finite at step 6"):
        log.flush()
    assert read_metrics(tmp_path / "metrics.jsonl") == []

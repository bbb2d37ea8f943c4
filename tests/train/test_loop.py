"""A run writes its files, stops cleanly, and continues as if it had never been stopped."""

import json
import math
import pathlib
import shutil
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fixtures.corpora import edit

from ha2g_jax import cli, launch
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.publishing import export
from ha2g_jax.errors import UserError
from ha2g_jax.methods import seq2seq
from ha2g_jax.train import loop
from ha2g_jax.train.log import StepLog
from ha2g_jax.train.workdir import read_metrics

# Command, folder and config. Of the methods Seq2Seq compiles fastest; it trains on the words. Speech2Gesture trains on
# the sound.
SOURCES = {
    "ted_expressive": ("import-ted", "ted_format/expressive", "seq2seq:ted_expressive:debug"),
    "ted_gesture": ("import-ted", "ted_format/gesture", "seq2seq:ted_gesture:debug"),
    "bvh": ("import-bvh", "zeroeggs_067", "speech2gesture:bvh:debug", "--config.model.inferer.layers=1"),
}
# The last level of the motion alone is enough here and half as long to compile.
IMAGES = ("video:debug", "--config.model.inferer.levels=(6,)")


@pytest.fixture(scope="module")
def config_for(tiny_talk):
    """A function from overrides of the debug config to the config, on the tiny corpus.

    Trimodal has speakers, noise and a discriminator like HA2G, with which tests/soak_resume.py trains, and compiles in
    half the time.
    """

    def config_for(method="trimodal", **settings):
        overrides = [f"--config.train.{name}={value}" for name, value in settings.items()]
        return launch.load_config(f"{method}:talk:debug", [f"--config.data.path={tiny_talk}", *overrides])

    return config_for


@pytest.fixture(scope="module")
def run(config_for, tmp_path_factory):
    """The workdir of a run of five steps, with checkpoints at 2, 4 and 5."""
    workdir = tmp_path_factory.mktemp("runs") / "whole"
    loop.train(config_for(steps=5, log_every=3), workdir)
    return workdir


def _parameters(workdir):
    return jax.tree.leaves(model_folder.load(workdir / "latest").variables)


def _steps(folder):
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


def test_a_run_writes_metrics_and_checkpoints(run):
    lines = read_metrics(run / "metrics.jsonl")
    assert [line["step"] for line in lines] == [2, 3, 4, 5, 5]
    assert all(math.isfinite(value) for line in lines for value in line.values())
    assert {"loss/huber", "loss/total", "grad_norm/generator", "learning_rate/generator"} <= lines[1].keys()
    assert {"windows_per_second", "waiting_percent", "seconds"} <= lines[1].keys()
    assert {"validation/loss/huber", "validation/loss/total"} <= lines[0].keys()
    assert _steps(run / "latest") == ["4", "5"]
    assert len(_steps(run / "best")) == 1
    assert json.loads((run / "run.json").read_text())["starts"][0]["step"] == 0
    assert list((run / "tensorboard").iterdir())


def test_a_checkpoint_is_found_by_any_path(run, monkeypatch):
    expected = model_folder.load(run / "best").assets.hash
    (step,) = _steps(run / "best")
    monkeypatch.chdir(run / "best")
    assert {model_folder.load(path).assets.hash for path in (".", step, "../best")} == {expected}


def test_losses_of_the_first_steps_are_those_of_earlier_versions(run):
    """A refactoring that changes a draw, a default or a term shows here; the numbers are of talk-v4."""
    lines = {line["step"]: line for line in read_metrics(run / "metrics.jsonl")}
    found = [lines[step][f"validation/loss/{name}"] for step in (2, 4, 5) for name in ("huber", "kld", "total")]
    expected = [0.240223, 0.0888430, 123.536, 0.230186, 0.0884837, 118.518, 0.225383, 0.0881719, 116.117]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(run, config_for, tmp_path, monkeypatch, capsys):
    add = StepLog.add

    def add_and_stop(self, step, metrics):
        add(self, step, metrics)
        if step == 1:
            signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        patch.setattr(StepLog, "add", add_and_stop)
        loop.train(config_for(steps=4, log_every=3), tmp_path)
    assert signal.getsignal(signal.SIGTERM) is before
    assert _steps(tmp_path / "latest") == ["2"]  # a step later all hosts know; step 3 would have written a line

    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 4, "loss/total": 0.0}\n{"step": 5, "los')  # as a killed run leaves it
    capsys.readouterr()
    loop.train(config_for(steps=5, log_every=3), tmp_path)
    assert "continuing at step 2 of 5" in capsys.readouterr().err
    for found, expected in zip(_parameters(tmp_path), _parameters(run), strict=True):
        np.testing.assert_array_equal(found, expected)
    whole, resumed = (read_metrics(workdir / "metrics.jsonl") for workdir in (run, tmp_path))
    for found, expected in zip(resumed, whole, strict=True):
        assert _without_times(found) == _without_times(expected)
    assert resumed[-1] == whole[-1]
    assert [start["step"] for start in json.loads((tmp_path / "run.json").read_text())["starts"]] == [0, 2]


def _without_times(line):
    times = {"seconds", "windows_per_second", "waiting_percent", "compile_seconds"}
    return {name: value for name, value in line.items() if name not in times}


def test_any_checkpoint_can_be_exported(run, tmp_path):
    for number, source in enumerate((run, run / "latest" / "4")):
        folder = export(source, tmp_path / str(number))
        exported, original = model_folder.load(folder), model_folder.load(source)
        jax.tree.map(np.testing.assert_array_equal, exported.variables, original.variables)
        assert exported.assets.hash == original.assets.hash
        assert len(exported.assets.speakers) == 3  # of four speakers one is not in training
        assert all(f_id.shape == (16,) for f_id in exported.assets.speakers.values())
        np.testing.assert_allclose(np.linalg.norm(exported.assets.seed_poses, axis=-1), 1, atol=1e-5)
    with pytest.raises(UserError, match=r"no checkpoint in .*latest/3"):
        model_folder.load(run / "latest" / "3")


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"devices": 99}, "there are 8 devices, not 99"),
        ({"devices": 4, "batch_size": 6}, "a batch of 6 does not split over 4 devices"),
        ({"batch_size": 8000}, "a batch of 8000 is more than the [0-9]+ windows of the split"),
        ({"init_from": "nowhere"}, "nowhere"),
    ],
)
def test_settings_that_cannot_be_used_leave_nothing_behind(settings, why, config_for, tmp_path):
    with pytest.raises(UserError, match=why):
        loop.train(config_for(**settings), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_goes_on_with_its_settings_and_its_corpus_only(run, tiny_talk, config_for, tmp_path):
    before = (run / "config.json").read_text()
    other = config_for(steps=6)
    shutil.copytree(tiny_talk, tmp_path / "other")
    edit(tmp_path / "other", lambda data: data["statistics"]["lengths"].reverse())
    shutil.copytree(tiny_talk, tmp_path / "same_words")
    edit(tmp_path / "same_words", lambda data: data["splits"].update(val=data["splits"]["test"]))
    validated_elsewhere = config_for(steps=6)
    for config, folder in ((other, "other"), (validated_elsewhere, "same_words")):
        with config.unlocked():
            config.data.path = str(tmp_path / folder)
    for config, message in (
        (config_for(learning_rate=0.1), r"train\.learning_rate \(0\.0005 there, 0\.1 here\)"),
        (config_for(steps=4, log_every=3), r"is at step 5, beyond config\.train\.steps, which is 4"),
        (other, "was started on another corpus than"),
        (validated_elsewhere, "was started on another corpus than"),
    ):
        with pytest.raises(UserError, match=message):
            loop.train(config, run)
        assert (run / "config.json").read_text() == before


def test_a_step_that_is_not_finite_ends_the_run_and_can_be_looked_at(config_for, tmp_path, monkeypatch):
    continuity = seq2seq.continuity
    monkeypatch.setattr(seq2seq, "continuity", lambda poses: continuity(poses) * jnp.nan)
    message = r"loss/continuity.* not finite at step 1, on the windows \S+@\d+, .*/failed, "
    with pytest.raises(UserError, match=message):
        loop.train(config_for("seq2seq", steps=3), tmp_path)
    report = json.loads((tmp_path / "failed.json").read_text())
    assert report["step"] == 1 and len(report["windows"]) == 4
    (start,) = json.loads((tmp_path / "run.json").read_text())["starts"]
    assert "continuity not finite at step 1" in start["failure"]["reason"]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(model_folder.load(tmp_path / "failed").variables))


def train_two_steps(data: pathlib.Path, workdir: pathlib.Path, config: str, *changes: str) -> list[dict]:
    """Return the lines of metrics.jsonl."""
    flags = (f"--config={config}", f"--workdir={workdir}", f"--config.data.path={data}", *changes)
    assert cli.main(["train", *flags]) == 0
    return read_metrics(workdir / "metrics.jsonl")


@pytest.mark.parametrize("source", SOURCES)
def test_two_steps_on_recordings(source, private_data, tmp_path):
    command, folder, *config = SOURCES[source]
    assert cli.main(["data", command, str(private_data / folder), str(tmp_path / "corpus")]) == 0
    lines = train_two_steps(tmp_path / "corpus", tmp_path / "run", *config)
    assert max(line["step"] for line in lines) == 2
    # One recording is one talk: nothing is left to validate on.
    assert any("validation/loss/total" in line for line in lines) == (source != "bvh")


def test_two_steps_on_images(tiny_talk, tmp_path):
    """Videos are imported as clips with images of the speakers."""
    lines = train_two_steps(tiny_talk, tmp_path / "run", *IMAGES)
    assert any("validation/loss/huber" in line for line in lines)

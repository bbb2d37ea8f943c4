"""A workdir belongs to one training and one config; each start is recorded, and a damaged record stops no run."""

import contextlib
import hashlib
import json
import pathlib
import subprocess
import sys

import jax
import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import presets, settings
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods import build
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train import fits, run_record
from ha2g_jax.train.workdir import LOCK, is_training, only_run, read_metrics


def test_a_second_training_is_refused_until_the_first_ends(tmp_path):
    workdir = tmp_path / "runs" / "talk"
    with only_run(workdir):
        assert is_training(workdir)
        with pytest.raises(UserError, match=r"another process trains in .*talk: wait"), only_run(workdir):
            pass
    assert not is_training(workdir)
    with only_run(workdir):
        assert [path.name for path in workdir.iterdir()] == [LOCK]


@pytest.fixture
def config():
    return presets.sized("ted_gesture", "debug")


@pytest.fixture
def workdir(config, tmp_path):
    """The workdir of a run of `config`."""
    skeleton = load_skeleton("ted_gesture")
    starts = skeleton.mean_directions[None, None].repeat(4, axis=1)
    model_folder.write_description(tmp_path, config, Assets(skeleton, Vocabulary(("one",)), {}, starts))
    return tmp_path


def test_a_run_may_move_to_another_machine(workdir, config):
    config.data.path, config.data.workers, config.data.cache_gib, config.train.devices = "elsewhere", 3, 1.0, 4
    fits.check_workdir(workdir, config)


def test_the_end_of_a_cosine_is_no_free_setting(workdir, config):
    config.train.steps = 9
    fits.check_workdir(workdir, config)
    config.train.schedule = "cosine"
    with pytest.raises(UserError, match=r"train\.schedule .*, train\.steps"):
        fits.check_workdir(workdir, config)


@pytest.mark.parametrize(
    ("method", "found"), [("ha2g", ""), ("trimodal", "takes audio, words"), ("seq2seq", "plain_w")]
)
def test_ends_are_hidden_only_where_a_model_reads_what_can_be_hidden(method, found):
    config = presets.make("talk", "debug", method, {"data.lookahead": 0.5})
    spec = build(config, load_skeleton(config.skeleton), 2, 2)
    if not found:
        fits.check_augmentation(config, spec)
        return
    with pytest.raises(UserError, match=rf"{found}.*data\.lookahead=0"):
        fits.check_augmentation(config, spec)


@pytest.fixture
def start(tmp_path, tiny_talk):
    """A function that records a start at a step and returns the content of `run.json`."""
    config, corpus = presets.sized("ted_expressive", "debug"), Corpus.open(tiny_talk)

    def start(step):
        run_record.write(tmp_path, config, step, corpus)
        return json.loads((tmp_path / "run.json").read_text())

    return start


@pytest.mark.parametrize(
    ("method", "name", "value", "is_read"),
    [
        ("ha2g", "model.inferer.hidden_dim", 99, True),
        ("ha2g", "train.warmup_epochs", 3, True),
        ("ha2g", "train.steps", 3, True),
        ("ha2g", "model.audio.whisper.layers", 2, False),  # of an encoder that is not chosen
        ("speech2gesture", "model.discriminator.layers", 2, False),
        ("seq2seq", "train.warmup_epochs", 3, False),  # there is no discriminator
    ],
)
def test_a_change_that_the_method_does_not_read_is_refused(method, name, value, is_read):
    preset = presets.make("talk", "debug", method)
    config = settings.change(presets.make("talk", "debug", method), {name: value})
    with contextlib.nullcontext() if is_read else pytest.raises(UserError, match=f"config.{name} changes nothing"):
        fits.check_changes(config, preset)


def test_every_start_is_kept(start, tmp_path, tiny_talk, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["ha2g", "train", "--config=x"])
    start(0)
    identity = run_record.wandb_id(tmp_path)
    record = start(7)
    assert [entry["step"] for entry in record["starts"]] == [0, 7]
    assert record["wandb_id"] == identity == run_record.wandb_id(tmp_path)
    assert record["config"]["train"]["batch_size"] == 4
    entry = record["starts"][1]
    assert entry["command"] == ["ha2g", "train", "--config=x"]
    assert entry["versions"]["jax"] == jax.__version__ and "numpy" in entry["versions"]
    assert entry["seeds"] == {"run": 0}
    assert entry["hardware"]["devices"] == {"cpu": 8} and entry["hardware"]["processes"] == 1
    digest = hashlib.sha256((tiny_talk / "dataset.json").read_bytes()).hexdigest()
    assert entry["corpus"] == {"path": str(tiny_talk), "sha256": digest}


@pytest.mark.parametrize("text", ["{}", "[]", '{"starts": 3}'])
def test_a_record_that_is_none_is_named(start, tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(UserError, match=r"run\.json is not the record of a run"):
        start(0)


@pytest.mark.parametrize("line", ["{}", "12", '{"step": "4"}', '{"step": 4'])
def test_a_line_of_metrics_that_is_none_is_named(tmp_path, line):
    path = tmp_path / "metrics.jsonl"
    path.write_text(f'{{"step": 1}}\n{line}\n{{"step": 5}}\n{{"step": 6')
    with pytest.raises(UserError, match=r"metrics\.jsonl has a damaged line"):
        read_metrics(path)
    path.write_text('{"step": 1}\n{"step": 6')  # as a kill leaves it
    assert read_metrics(path) == [{"step": 1}]


def _git(folder: pathlib.Path, *arguments: str) -> None:
    who = ["-c", "user.name=x", "-c", "user.email=x@x"]
    subprocess.run(["git", "-C", str(folder), *who, *arguments], check=True, capture_output=True)


def test_the_commit_is_that_of_the_source_tree(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", "/dev/null")
    package, other = tmp_path / "package", tmp_path / "env" / "package"
    for folder in (package, other):
        folder.mkdir(parents=True)
        (folder / "code.py").write_text("1\n")
    assert run_record.commit(package) is None
    (tmp_path / "scores.jsonl").write_text("1\n")
    _git(tmp_path, "init")
    _git(tmp_path, "add", "package", "scores.jsonl")
    _git(tmp_path, "commit", "-m", "x")
    clean = run_record.commit(package)
    assert clean is not None and len(clean) == 40
    assert run_record.commit(other) is None  # installed in a folder of somebody's repository
    (tmp_path / "scores.jsonl").write_text("2\n")
    assert run_record.commit(package) == clean
    (package / "code.py").write_text("2\n")
    assert run_record.commit(package) == f"{clean}-dirty"
    monkeypatch.setenv("PATH", "")
    assert run_record.commit(package) is None


@pytest.mark.parametrize(
    ("error", "reason"),
    [(UserError("disk full"), "disk full"), (RuntimeError("out of\nmemory"), "RuntimeError: out of memory")],
)
def test_the_reason_of_a_failure_is_that_of_the_last_start(start, tmp_path, error, reason):
    start(0)
    start(5)
    with pytest.raises(type(error)), run_record.noting_failure(tmp_path):
        raise error
    first, last = json.loads((tmp_path / "run.json").read_text())["starts"]
    assert "failure" not in first and last["failure"]["reason"] == reason and last["step"] == 5
    assert "failure" not in start(7)["starts"][-1]
    with pytest.raises(KeyboardInterrupt), run_record.noting_failure(tmp_path):
        raise KeyboardInterrupt
    assert "failure" not in json.loads((tmp_path / "run.json").read_text())["starts"][-1]


def test_a_failure_that_cannot_be_stored_is_raised_all_the_same(tmp_path):
    (tmp_path / "run.json").mkdir()
    with pytest.raises(RuntimeError, match="oops"), run_record.noting_failure(tmp_path):
        raise RuntimeError("oops")

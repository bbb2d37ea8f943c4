"""Flags and paths of any form give a result or one line, as errors of the system do; a full disk leaves no part."""

import errno
import json
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_text
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax import cli, launch
from ha2g_jax.config import settings
from ha2g_jax.limits import MAX_SEED, MAX_TALK_MINUTES, MAX_TALK_SPEAKERS
from ha2g_jax.motion import control
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis.style import read_mixture
from ha2g_jax.train.workdir import read_metrics

_FLAGS = (
    "--config.train.steps=10",
    "--config.train.betas=(0.9, 0.99)",
    "--config.data.noise_snr_db=(5.0, 20.0)",
    "--config.data.fps=15",
    "--config.loss.ha2g.weights.gan=1.0",
    "--config.model.audio.levels=('low',)",
    "--config.train.dtype=bfloat16",
    "--config.seed=3",
)


def damaged(text):
    """Damage a text, which the system gives a program as its arguments."""
    return damaged_text(text).map(os.fsdecode)


@FUZZ
@given(flag=st.sampled_from(_FLAGS).flatmap(damaged))
def test_any_flag_gives_a_config_or_one_line(flag):
    with one_line(5_000):
        settings.check(launch.load_config("talk:debug", [flag]))


@FUZZ
@given(spec=st.sampled_from(["talk:debug", "trimodal:talk:small", "./mine.py:small"]).flatmap(damaged))
def test_any_name_of_a_config_gives_one_or_one_line(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where no file is, so that nothing is executed
    with one_line(5_000):
        launch.load_config(spec)


@FUZZ
@given(text=damaged("ada:0.3,ben:0.7"))
def test_any_mixture_is_read_or_refused(text):
    with one_line():
        read_mixture(text)


ODD_PARTS = ["0", "1", "-1", "nan", "inf", "1e300", "", "rest", "x.npz@1", "/dev/zero", "x" * 300, "\udcff"]


@FUZZ
@given(parts=st.lists(st.sampled_from(ODD_PARTS), max_size=4))
def test_any_pin_and_mute_is_read_or_refused(parts):
    skeleton, text = load_skeleton("ted_expressive"), ":".join(parts)
    directions = np.tile(skeleton.mean_directions, (20, 1, 1)).astype(np.float32)
    with one_line():
        control.apply(skeleton, directions, 15, control.Controls(pins=(control.read_pin(text),)))
    with one_line():
        control.apply(skeleton, directions, 15, control.Controls(mutes=(control.read_mute(text),)))


@pytest.mark.parametrize("seed", ["-1", str(MAX_SEED + 1), "9" * 5000, "1e3", "nan", ""])
@pytest.mark.parametrize(
    "command",
    [
        ["generate", "a.wav", "--seed"],
        ["generate", "a.wav", "--style-seed"],
        ["evaluate", "--checkpoint", "demo", "--seed"],
        ["data", "make-talk", "a", "--seed"],
        ["data", "split", "a", "b", "--seed"],
    ],
)
def test_a_seed_out_of_range_is_refused(command, seed, refused):
    assert refused(*command[:-1], f"{command[-1]}={seed}").startswith("ha2g: the seed is ")


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("--minutes", ["nan", "inf", "-inf", "-5", "1e300", str(MAX_TALK_MINUTES + 1)]),
        ("--speakers", ["-3", "0", str(MAX_TALK_SPEAKERS + 1), "9" * 4000]),
        ("--workers", ["0"]),
        ("--fps", ["0", "1001"]),
    ],
)
def test_a_talk_corpus_of_no_possible_size_is_refused(option, values, refused, tmp_path):
    for value in values:
        refused("data", "make-talk", str(tmp_path / "talk"), f"{option}={value}")
    assert not list(tmp_path.iterdir())


DATA_COMMANDS = (
    *("import-bvh {} out", "import-smplx {} out", "import-ted {} out", "build-video {} out", "stats {}", "validate {}"),
    *("split {} out", "merge {} {} out", "build-video a.mp4 out --settings {}", "import-bvh a.bvh out --joint-map {}"),
    "import-smplx a.npz out --model {}",
)
COMMANDS = (
    *("generate {}.wav", "generate a.wav --words {}", "evaluate --speech {}.wav", "describe --config {}:debug"),
    *("train --config {} --workdir run", "export-model {}/run out", *(f"data {command}" for command in DATA_COMMANDS)),
)


@pytest.fixture
def in_folder(tmp_path, monkeypatch):
    """A folder with empty files, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    for file in ("a.wav", "a.bvh", "a.npz", "a.mp4"):
        (tmp_path / file).touch()
    return tmp_path


@pytest.mark.parametrize("name", ["x" * 300, "x" * 5_000, "na\udcffme", "two\nlines"])
def test_a_path_of_any_name_is_refused_in_one_line(name, refused, in_folder):
    for command in COMMANDS:
        line = refused(*(word.format(name) for word in command.split()))
        assert line.isprintable() and len(line) < 700, command
    assert len(list(in_folder.iterdir())) == 4


def test_what_is_no_file_is_refused_and_not_waited_for(refused, in_folder):
    os.mkfifo("pipe")
    (in_folder / "folder").mkdir()
    (in_folder / "dangling").symlink_to("none")
    for command in DATA_COMMANDS:
        for name in ("pipe", "folder", "dangling"):
            refused("data", *(word.format(name) for word in command.split()))
    assert len(list(in_folder.iterdir())) == 7


def test_a_full_disk_leaves_no_part_of_a_model_or_a_run(tmp_path):
    """The limit on the size of a file stands for the full disk: both fail in the middle of a write."""
    code = """
        import pathlib, resource, sys
        sys.path.insert(0, "tests")
        import conftest
        from ha2g_jax.checkpoint import model_folder
        from ha2g_jax.errors import UserError
        from ha2g_jax.train import fits, run_record, workdir

        folder = pathlib.Path(sys.argv[1])
        model = model_folder.load("demo")
        metrics = folder / "metrics.jsonl"
        for step in range(100):
            workdir.append_metrics(metrics, step, {"loss/huber": 0.5})
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
        steps = (
            lambda: model_folder.save(folder / "model", model.config, model.assets, model.variables),
            lambda: model_folder.write_description(folder, model.config, model.assets),
            lambda: [workdir.append_metrics(metrics, step, {"loss/huber": 0.5}) for step in range(100, 200)],
            lambda: workdir.start_metrics(metrics, 1000),
            lambda: run_record._write(folder, {"starts": ["x" * 4000]}),
        )
        for step in steps:
            try:
                step()
            except UserError as error:
                print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 5 and all("ile too large" in line for line in lines), lines
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.json", "metrics.jsonl"]
    assert json.loads((tmp_path / "config.json").read_text())["skeleton"] == "ted_expressive"
    assert [line["step"] for line in read_metrics(tmp_path / "metrics.jsonl")][:100] == list(range(100))


def test_an_error_of_the_system_is_one_line(refused, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", "/data/out\udcff.html")

    monkeypatch.setattr("ha2g_jax.cli.export._export", full)
    assert refused("view", "motion.npz").endswith("/data/out\\xff.html: no space left on device")


def test_an_error_of_the_program_asks_for_a_report(capsys, monkeypatch):
    monkeypatch.setattr("ha2g_jax.cli.export._export", lambda *_: [][0])
    assert cli.main(["view", "motion.npz"]) == 1
    text = capsys.readouterr().err
    assert "IndexError" in text and text.endswith("report the text above as SECURITY.md says\n")

"""Odd paths and configs are refused in one line; a full disk leaves nothing that looks complete."""

import json
import subprocess
import sys
import textwrap

import pytest

from ha2g_jax.apps.generate import generate_files
from ha2g_jax.errors import UserError
from ha2g_jax.train.workdir import read_metrics


@pytest.mark.parametrize("name", ["x" * 300, "na\udcffme", "two\nlines"])
def test_any_path_is_named_in_one_line(refused, tmp_path, name):
    shown = "x..." if name[0] == "x" else name.encode(errors="surrogateescape").decode(errors="backslashreplace")
    shown = shown.replace("\n", "\\n")
    (tmp_path / "file").touch()
    for command in (
        ["export-model", f"{tmp_path}/{name}/run", f"{tmp_path}/out"],
        ["describe", "--config", f"{tmp_path}/{name}:debug"],
        ["train", "--config", f"{tmp_path}/{name}", "--workdir", f"{tmp_path}/run"],
        ["train", "--config", "tests/one_stage.py:debug", "--workdir", f"{tmp_path}/file/{name}"],
        ["generate", f"{tmp_path}/speech.wav", "--words", f"{tmp_path}/{name}"],
    ):
        assert shown[:4] in refused(*command) or "x" * 40 in refused(*command)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_code_of_a_config_may_fail(refused, tmp_path):
    for number, code in enumerate(
        ["1 / 0", "def get_config(size): return size.x", "\0", "(" * 10_000, "def f(", "raise Exception"]
    ):
        path = tmp_path / f"config_{number}.py"
        path.write_text(code)
        assert path.name in refused("describe", "--config", f"{path}:debug")


def test_a_transcript_that_is_missing_is_refused_before_the_work(tmp_path):
    with pytest.raises(UserError, match=r"cannot read .*words\.txt \(No such file or directory\)"):
        generate_files(tmp_path / "speech.wav", words=tmp_path / "words.txt")


def test_a_full_disk_leaves_no_part_of_a_model_or_a_run(tmp_path):
    """The limit on the size of a file stands for the full disk: both fail in the middle of a write."""
    code = """
        import pathlib, resource, sys
        sys.path.insert(0, "tests")
        import conftest
        from ha2g_jax.checkpoint import loading, model_folder
        from ha2g_jax.errors import UserError
        from ha2g_jax.train import fits, run_record, workdir

        folder = pathlib.Path(sys.argv[1])
        model = loading.load("demo")
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
    assert json.loads((tmp_path / "config.json").read_text())["method"] == "ha2g"
    assert [line["step"] for line in read_metrics(tmp_path / "metrics.jsonl")][:100] == list(range(100))

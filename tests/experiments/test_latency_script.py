"""The command of the study of look-aheads: its flags become a request, and a mistake is one line."""

import importlib.util
import pathlib

import pytest

ROOT = pathlib.Path(__file__).parents[2]


@pytest.fixture(scope="module")
def command():
    spec = importlib.util.spec_from_file_location("latency", ROOT / "experiments" / "latency.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_flags_become_a_request(command, monkeypatch, tmp_path, capsys):
    calls = []
    monkeypatch.setattr(command, "study_latency", lambda *arguments: calls.append(arguments) or False)
    argv = ["--data", "talk:corpora/x", "--size", "debug", "--seeds", "4,6", "--workdir", str(tmp_path), "--no-train"]
    assert command.main([*argv, "--jobs", "2", "--split", "val"]) == 1
    ((request, split, out, line, *_),) = calls
    assert (request.data, request.size, request.path, request.seeds) == ("talk", "debug", "corpora/x", (4, 6))
    assert (request.workdir, request.jobs, request.has_training, split) == (tmp_path, 2, False, "val")
    assert out == tmp_path / "talk-debug" / "latency.md" and capsys.readouterr().out == f"{out}\n"
    assert line.startswith("python experiments/latency.py --data talk:corpora/x --size debug")


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--data", "bvh:a"], "known on talk only"),
        (["--jobs", "0"], "give 1 or more"),
        (["--seeds", "some"], "neither a number of seeds nor a list"),
        (["--data", "talk:nowhere"], "no corpus in"),
    ],
)
def test_a_mistake_is_one_line(command, capsys, monkeypatch, tmp_path, flags, message):
    monkeypatch.chdir(tmp_path)
    assert command.main(flags) == 2
    printed = capsys.readouterr().err
    assert message in printed and printed.count("\n") == 1 and not list(tmp_path.iterdir())

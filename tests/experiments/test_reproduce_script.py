"""The command: its flags become a request, its exit code says how it ended."""

import importlib.util
import json
import os
import pathlib
import signal

import pytest
from tables.jobs import Stopped

from ha2g_jax.errors import UserError

ROOT = pathlib.Path(__file__).parents[2]


@pytest.fixture(scope="module")
def command():
    spec = importlib.util.spec_from_file_location("reproduce", ROOT / "experiments" / "reproduce.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Asked:
    """Stands for `reproduce`: keeps what it is asked for and gives `answer`."""

    def __init__(self):
        self.calls: list[tuple] = []
        self.answer: bool | Exception = True

    def __call__(self, *arguments):
        self.calls.append(arguments)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.fixture
def asked(command, monkeypatch):
    asked = Asked()
    monkeypatch.setattr(command, "reproduce", asked)
    return asked


def test_flags_become_a_request(command, asked, tmp_path, capsys):
    argv = ["table3", "--data", "bvh:corpora/x", "--size", "debug", "--seeds", "4,6", "--workdir", str(tmp_path)]
    argv += ["--jobs", "2", "--no-train", "--legacy", "--changes", "train.steps=3", "--changes", "loss.gan=minimax"]
    argv += ["--keep", "kept"]
    assert command.main(argv) == 0
    ((request, out, line, _, _, keep),) = asked.calls
    assert keep == pathlib.Path("kept")
    assert request._asdict() == {
        "table": "table3",
        "data": "bvh",
        "size": "debug",
        "path": "corpora/x",
        "seeds": (4, 6),
        "workdir": tmp_path,
        "changes": {"train.steps": 3, "loss.gan": "minimax"},
        "jobs": 2,
        "has_training": False,
        "has_legacy": True,
    }
    assert out == tmp_path / "bvh-debug" / "table3.md" and capsys.readouterr().out == f"{out}\n"
    assert line.startswith("python experiments/reproduce.py table3 --data bvh:corpora/x --size debug --seeds 4,6")


def test_the_defaults_are_three_seeds_of_the_small_size(command, asked):
    assert command.main(["table1", "--data", "talk"]) == 0
    ((request, out, *_),) = asked.calls
    assert (request.seeds, request.size, request.path, request.jobs) == ((0, 1, 2), "small", "", 1)
    assert request.has_training and out == pathlib.Path("runs/reproduce/talk-small/table1.md")


@pytest.mark.parametrize(
    ("answer", "code", "printed"),
    [
        (False, 1, ""),
        (UserError("the disk is full; make room"), 2, "reproduce: the disk is full; make room\n"),
        (Stopped(signal.SIGINT), 130, "stopped; the same command continues\n"),
    ],
)
def test_the_exit_code_says_how_it_ended(command, asked, capsys, answer, code, printed):
    asked.answer = answer
    assert command.main(["table1", "--data", "talk"]) == code
    assert capsys.readouterr().err == printed


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--data", "tedd"], "no data 'tedd'; expected one of talk"),
        (["--data", "bvh:a", "--path", "b"], "give one of them"),
        (["--data", "talk", "--jobs", "0"], "give 1 or more"),
        (["--data", "talk", "--seeds", "some"], "neither a number of seeds nor a list"),
        (["--data", "talk", "--changes", "steps"], "not KEY=VALUE"),
        (["--data", "talk", "--changes", "data.path=a"], "give --data NAME:DIR"),
        (["--data", "talk", "--out", "a.svg"], "the chart of the report"),
        (["--data", "talk", "--out", "."], "is a folder"),
        (["--data", "bvh"], "needs the folder of a corpus"),
        (["--data", "bvh:nowhere"], "no corpus in"),
    ],
)
def test_a_mistake_is_one_line(command, capsys, monkeypatch, tmp_path, flags, message):
    monkeypatch.chdir(tmp_path)
    assert command.main(["table1", *flags]) == 2
    printed = capsys.readouterr().err
    assert message in printed and printed.count("\n") == 1 and not list(tmp_path.iterdir())


def test_a_signal_stops_the_command(command, tmp_path, capsys):
    split = {"clips": 1, "speakers": [], "shards": []}
    metadata = {
        "schema_version": 2,
        "name": "x",
        "source": "x",
        "skeleton": "ted_expressive",
        "fps": 15,
        "speakers": [],
    }
    metadata |= {"splits": dict.fromkeys(("train", "test"), split), "statistics": {}, "words": {}, "import": {}}
    (tmp_path / "dataset.json").write_text(json.dumps(metadata))

    def perform(request, corpus, run, worker, stop):
        os.kill(os.getpid(), signal.SIGINT)

    flags = ["table1", "--data", f"bvh:{tmp_path}", "--size", "debug", "--workdir", str(tmp_path / "runs")]
    before = signal.getsignal(signal.SIGINT)
    assert command.main(flags, perform) == 128 + signal.SIGINT
    assert "the same command continues" in capsys.readouterr().err and signal.getsignal(signal.SIGINT) is before

"""A run's process gets its task, its share of the machine and the signals; its last line says why it failed."""

import json
import os
import signal
import sys
import threading
import time

import pytest
from tables import runs
from tables.plan import Request
from tables.runs import Stop, perform_in_process
from tables.workdirs import Run

from ha2g_jax.errors import UserError

_STUB = """
import json, os, pathlib, signal, sys, time
task = json.load(sys.stdin)
folder = pathlib.Path(task["request"]["workdir"])
(folder / "task.json").write_text(json.dumps([sys.argv[1], task, dict(os.environ)]))
if task["request"]["data"] == "bad":
    sys.exit("first line\\nno such corpus")
if task["request"]["data"] == "slow":
    signal.signal(signal.SIGTERM, lambda *_: (print("saved", flush=True), sys.exit(0)))
    (folder / "begun").touch()
    time.sleep(60)
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    path = tmp_path / "stub.py"
    path.write_text(_STUB)
    monkeypatch.setattr(runs, "_WORKER", (sys.executable, str(path)))
    return Run("a-run", 0, None, tmp_path / "a-run")


def _request(tmp_path, data="talk", jobs=1):
    return Request("table1", data, "debug", "", (0, 1), tmp_path, {"train.betas": (0.5, 0.9)}, jobs)


def test_the_process_gets_its_task(run, tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    perform_in_process(_request(tmp_path), run, 0, Stop())
    name, task, environment = json.loads((tmp_path / "task.json").read_text())
    assert name == task["run"] == "a-run" and task["cores"] == []
    assert task["request"]["changes"] == {"train.betas": [0.5, 0.9]} and task["request"]["seeds"] == [0, 1]
    assert environment["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "compiled")
    assert "XLA_PYTHON_CLIENT_MEM_FRACTION" not in environment


def test_a_failed_process_says_why(run, tmp_path):
    with pytest.raises(UserError, match=r"^no such corpus \(exit code 1; see .*a-run\.log\)$"):
        perform_in_process(_request(tmp_path, "bad"), run, 0, Stop())


def test_a_stop_reaches_the_process(run, tmp_path):
    stop = Stop()

    def signal_it():
        while not (tmp_path / "begun").exists():
            time.sleep(0.02)
        stop.handle(signal.SIGINT)

    thread = threading.Thread(target=signal_it)
    thread.start()
    perform_in_process(_request(tmp_path, "slow"), run, 0, stop)
    thread.join()
    assert (tmp_path / "a-run.log").read_text() == "saved\n"


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system has no affinity")
def test_each_worker_has_its_share_of_the_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 3, 4, 5, 6})
    assert [runs._cores(worker, 2) for worker in (0, 1)] == [[2, 3], [4, 5]]
    assert [runs._cores(worker, 7) for worker in (0, 6)] == [[2], [3]]
    assert runs._cores(0, 1) == []

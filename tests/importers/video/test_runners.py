"""Work in parallel: every item comes back, whatever happens to the processes."""

import contextlib
import os
import subprocess
import sys
import time

import pytest
from fixtures.processes import is_gone

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import runners

# What workers do. A module of its own, because workers import it by name.
CALLS = """
import os, pathlib, signal, subprocess, sys, tempfile, time

def call(item):
    kind, _, path = item.partition(":")
    if kind == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == "leave":
        sys.exit(3)
    if kind == "raise":
        raise ValueError("two\\nlines")
    if kind == "mistake":
        from ha2g_jax.errors import UserError
        raise UserError("no such thing")
    if kind == "killed once" and not os.path.exists(path):
        child = subprocess.Popen(["sleep", "600"])
        pathlib.Path(path).write_text(str(child.pid))
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "wait":
        child = subprocess.Popen(["sleep", "600"])
        tempfile.mkstemp()
        pathlib.Path(path).write_text(f"{os.getpid()} {child.pid}")
        child.wait()
    return item.upper()
"""


@pytest.fixture
def call(tmp_path, monkeypatch):
    (tmp_path / "parallel_calls.py").write_text(CALLS)
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop("parallel_calls", None)
    import parallel_calls  # pyrefly: ignore[missing-import]

    yield parallel_calls.call
    del sys.modules["parallel_calls"]


def test_every_item_comes_back_with_its_result_or_its_error(call, tmp_path):
    killed = f"killed once:{tmp_path / 'killed'}"
    items = ["a", "crash", "b", "raise", "mistake", "leave", killed, "c"]
    outcomes = dict(runners.local(call, items, 3))
    assert {item for item, outcome in outcomes.items() if isinstance(outcome, str)} == {"a", "b", "c", killed}
    assert outcomes[killed] == killed.upper()  # tried again
    assert is_gone(int((tmp_path / "killed").read_text()))  # what the killed one had started
    assert isinstance(outcomes["crash"], runners.WorkerDied) and "SIGSEGV" in str(outcomes["crash"])
    assert "ValueError: two lines [parallel_calls.py:" in str(outcomes["raise"])
    assert "SystemExit: 3" in str(outcomes["leave"])
    assert isinstance(outcomes["mistake"], UserError) and str(outcomes["mistake"]) == "no such thing"
    assert len(outcomes) == len(items)


def test_nothing_survives_an_interrupt(call, tmp_path, monkeypatch):
    """Protects Ctrl-C: workers, the estimators that they run, and their files are gone when the caller is told."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    notes = [tmp_path / "first", tmp_path / "second"]
    results = runners.local(call, [*(f"wait:{note}" for note in notes), "a"], 3)
    with contextlib.closing(results):
        assert next(results) == ("a", "A")
        while not all(note.exists() and note.read_text() for note in notes):
            time.sleep(0.01)
        assert len([*(tmp_path / "temporary").rglob("tmp*")]) == 2
    assert not [*(tmp_path / "temporary").iterdir()]
    for note in notes:
        assert all(is_gone(int(number)) for number in note.read_text().split())


@pytest.mark.usefixtures("call")
def test_workers_do_not_outlive_a_killed_caller(tmp_path):
    """Protects a build ended with kill -9: what it leaves running would go on writing and heating for hours."""
    note = tmp_path / "note"
    (tmp_path / "caller.py").write_text(
        "import parallel_calls\nfrom ha2g_jax.importers.video import runners\n"
        f"if __name__ == '__main__':\n    list(runners.local(parallel_calls.call, ['wait:{note}'], 1))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    process = subprocess.Popen([sys.executable, tmp_path / "caller.py"], env=environment)
    while not (note.exists() and note.read_text()):
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert all(is_gone(int(number)) for number in note.read_text().split())

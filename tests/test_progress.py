"""Progress: a clock or a bar on a terminal, a line now and then elsewhere, and nothing for quick work."""

import io
import pathlib
import re
import sys
import time

import pytest

from ha2g_jax import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def quick(monkeypatch):
    """Let seconds pass in hundredths."""
    monkeypatch.setattr(progress, "_TICK", 0.01)
    monkeypatch.setattr(progress, "_LINE_SECONDS", 0.05)


def test_quick_work_prints_nothing_where_there_is_no_terminal(capsys):
    with progress.stage("loading the model"), progress.progress_bar("frames", 3, "frame") as bar:
        bar.update(3)
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("quick")
def test_long_work_prints_whole_lines_where_there_is_no_terminal(capsys):
    with progress.stage("loading the model"):
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 6 and all(line.startswith("loading the model (00:00 so far)") for line in lines)


@pytest.mark.usefixtures("quick")
def test_a_bar_prints_how_much_is_done_and_what_is_left(capsys):
    with progress.progress_bar("frames", 10, "frame") as bar:
        for _ in range(10):
            time.sleep(0.03)
            bar.update()
    text = capsys.readouterr().err
    assert re.search(r"^frames: \d+ of 10 frames, \d\d:\d\d left \(", text, re.MULTILINE) and "\r" not in text
    assert len(text.splitlines()) < 8


@pytest.mark.parametrize(("total", "said"), [(1, "0 of 1 recording"), (242, "0 of 242 recordings")])
def test_what_is_counted_has_its_noun_on_a_terminal(total, said, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with progress.progress_bar("making", total, "recording"):
        assert re.search(rf"making: +0 %.*{said}, ", terminal.getvalue())
    assert progress.counted(1766, "corpus") == "1,766 corpora"


def test_a_part_of_other_work_prints_no_lines(capsys, monkeypatch):
    monkeypatch.setattr(progress, "_LINE_SECONDS", 0.0)
    for is_part in (True, False):
        with progress.progress_bar("generating", 9, "window", is_part=is_part) as bar:
            bar.update()
        assert bool(capsys.readouterr().err) is not is_part


def test_every_bar_is_made_in_one_place():
    """So that all have a name, a count with its noun, and lines where there is no terminal."""
    root = pathlib.Path(progress.__file__).parent
    files = [path for folder in (root, root.parent / "experiments") for path in folder.rglob("*.py")]
    made = re.compile(r"\b(tqdm|trange)\(")
    allowed = {root / "progress.py", root / "checkpoint/hub.py"}  # huggingface_hub takes a class of bars
    assert [str(path) for path in files if path not in allowed and made.search(path.read_text())] == []


@pytest.mark.usefixtures("quick")
def test_a_terminal_shows_a_clock_at_once_and_is_left_clean(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress.stage("loading the model"):
        assert "loading the model ... 00:00" in terminal.getvalue()
        time.sleep(0.05)
        assert terminal.getvalue().count("loading the model") >= 2
    assert terminal.getvalue().split("\r")[-1].strip() == "" and "\n" not in terminal.getvalue()

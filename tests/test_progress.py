"""Progress: a clock or a bar on a terminal, a line now and then elsewhere, and nothing for quick work."""

import io
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
    assert re.search(r"^frames: \d+ of 10 frame, \d\d:\d\d left \(", text, re.MULTILINE) and "\r" not in text
    assert len(text.splitlines()) < 8


@pytest.mark.usefixtures("quick")
def test_a_terminal_shows_a_clock_at_once_and_is_left_clean(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress.stage("loading the model"):
        assert "loading the model ... 00:00" in terminal.getvalue()
        time.sleep(0.05)
        assert terminal.getvalue().count("loading the model") >= 2
    assert terminal.getvalue().split("\r")[-1].strip() == "" and "\n" not in terminal.getvalue()

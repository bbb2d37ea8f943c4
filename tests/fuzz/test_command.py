"""The command answers errors of the system in one line, and its own with a traceback."""

import errno

from ha2g_jax import cli


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

"""The report on Talk."""

import sys

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus.talk_report import kinematics, write_report
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


def test_writes_one_self_contained_page(tiny_talk, tmp_path):
    pytest.importorskip("matplotlib")
    page = write_report(tiny_talk, tmp_path / "report")
    text = page.read_text()
    assert page.name == "report.html"
    assert text.count("data:image/png;base64,") == 4
    assert "http" not in text


def test_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UserError, match="pip install"):
        write_report(tmp_path, tmp_path / "report")


def test_kinematics_of_a_known_swing():
    times = np.arange(600) / 15
    motion = np.tile(SKELETON.mean_pose.astype(np.float64), (600, 1, 1))
    wrists = [SKELETON.joint("left_wrist"), SKELETON.joint("right_wrist")]
    motion[:, wrists, 1] += 0.1 * np.sin(2 * np.pi * 0.5 * times)[:, None]  # peak speed 0.314 m/s, 60 peaks a minute
    found = kinematics(SKELETON, [motion], 15)
    assert found.speed.max() == pytest.approx(0.1 * np.pi, rel=0.02)
    assert found.strokes_per_minute == pytest.approx(60, abs=3)
    assert found.still == pytest.approx(2 * np.arcsin(0.1 / (0.1 * np.pi)) / np.pi, abs=0.05)


def test_compares_with_a_recording(tiny_talk, private_data, tmp_path):
    pytest.importorskip("matplotlib")
    recording = next((private_data / "zeroeggs_067").glob("*.bvh"))
    page = write_report(tiny_talk, tmp_path / "report", recording)
    assert "<th>recording</th>" in page.read_text()


def test_a_recording_that_is_no_bvh_is_named(tiny_talk, tmp_path):
    pytest.importorskip("matplotlib")
    path = tmp_path / "speech.bvh"
    path.write_text("hello")
    with pytest.raises(UserError, match=r"speech\.bvh, line 1"):
        write_report(tiny_talk, tmp_path / "report", path)
    assert not (tmp_path / "report.html").exists()

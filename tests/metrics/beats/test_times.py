"""Parts of librosa are compiled by one process at a time; pauses are found and cut out."""

import os
import subprocess
import sys

import numpy as np

from ha2g_jax.metrics.beats import times

PROGRAM = """
import numpy as np
from ha2g_jax.metrics.beats.times import librosa
print(librosa("core.audio").zero_crossings(np.array([1.0, -1.0, 1.0])).sum())
"""


def test_processes_that_begin_at_once_share_one_good_store(tmp_path):
    """Protects from numba's store being written by two at once, after which all processes crash."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "numba"), "HA2G_CACHE": str(tmp_path / "cache")}
    command = [sys.executable, "-c", PROGRAM]
    processes = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    found = [process.communicate()[0].strip() for process in processes]
    assert len(set(found)) == 1 and int(found[0]) >= 1
    assert any((tmp_path / "numba").rglob("*.nbi"))
    again = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert again.stdout.strip() == found[0]


def test_pauses_are_what_is_far_from_loud_sound():
    audio = np.random.default_rng(0).normal(0, 1e-3, 10 * 16000)
    for start, end in ((1, 2), (2.5, 3), (6, 8)):
        audio[int(start * 16000) : int(end * 16000)] *= 100
    spans = times.speech_spans(audio)
    np.testing.assert_allclose(spans, [(0.7, 3.3), (5.7, 8.3)], atol=0.03)
    assert not len(times.speech_spans(np.zeros(16000)))


def test_pauses_are_cut_out_of_times():
    spans = np.array([(1.0, 3.0), (5.0, 6.0)])
    np.testing.assert_allclose(times.cut_pauses(np.array([0.5, 1, 2.5, 4, 5.25, 6, 7]), spans), [0, 1.5, 2.25])
    assert not len(times.cut_pauses(np.array([1.0]), np.zeros((0, 2))))

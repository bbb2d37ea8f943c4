"""Parts of librosa are compiled by one process at a time, however many begin at once."""

import os
import subprocess
import sys

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

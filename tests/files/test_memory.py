"""Memory that a thread frees is used again: no page of it has to be provided by the system a second time."""

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import resource, sys, threading
from ha2g_jax.files.memory import keep_memory
if sys.argv[1] == "keep":
    keep_memory()

def write():
    for _ in range(2):
        b"x" * (256 << 20)

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    thread = threading.Thread(target=write)
    thread.start()
    thread.join()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults()
print(faults() * resource.getpagesize() >> 20)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc")
def test_large_blocks_of_threads_are_kept_unless_there_is_an_accelerator(tmp_path):
    def provided(choice):
        command = [sys.executable, "-c", PROGRAM, choice]
        return int(subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout)

    assert provided("keep") < 16
    assert provided("return") > 256  # MiB; otherwise there is nothing to keep
    (tmp_path / "libtpu.py").touch()
    assert provided("keep") > 256

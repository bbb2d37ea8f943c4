"""Memory that a program of JAX frees is used again: no page of it has to be provided by the system a second time."""

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import resource, sys
from ha2g_jax.layers.cpu.memory import keep_memory
if sys.argv[1] == "keep":
    keep_memory()
import jax
import jax.numpy as jnp

@jax.jit
def add_twice(x):
    return jax.lax.fori_loop(0, 2, lambda _, y: y + x, jnp.zeros(1 << 24))[0]  # y takes 64 MiB

one = jnp.ones(()).block_until_ready()

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    add_twice(one).block_until_ready()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

# What other threads request may lie in the freed block, which is then too small for the next call.
print(min(faults() for _ in range(6)) * resource.getpagesize() >> 20)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc")
def test_memory_of_a_program_is_kept_unless_there_is_an_accelerator(tmp_path):
    def provided(choice):
        command = [sys.executable, "-c", PROGRAM, choice]
        return int(subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout)

    assert provided("keep") < 16
    assert provided("return") >= 64  # MiB; otherwise there is nothing to keep
    (tmp_path / "libtpu.py").touch()
    assert provided("keep") >= 64

"""Commands that train keep their compiled programs, which JAX only does if it is told so before it is imported."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]
PROGRAM = """
import runpy, sys
script, *sys.argv[1:] = sys.argv[1:]
try:
    runpy.run_path(script, run_name="__main__")
except SystemExit:
    pass
import jax
print(jax.config.jax_compilation_cache_dir)
"""


@pytest.mark.parametrize(
    ("script", "arguments"),
    [("ha2g", ["train", "--config=none"]), ("ha2g", ["doctor", "--config=none"]), ("launch", ["--config=none"])],
)
def test_a_process_that_trains_keeps_its_programs(script, arguments, tmp_path):
    path = {"ha2g": pathlib.Path(sys.executable).with_name("ha2g"), "launch": ROOT / "experiments" / "launch.py"}
    environment = {name: value for name, value in os.environ.items() if "COMPILATION_CACHE" not in name}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path[script]), *arguments],
        env=environment | {"HA2G_CACHE": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split()[-1:] == [str(tmp_path / "programs")], done.stderr

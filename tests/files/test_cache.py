"""The cache folder is where the environment says; commands keep compiled programs in it, unless they shall not."""

import os
import pathlib
import subprocess
import sys

import pytest

from ha2g_jax.files.cache import cache_folder, keep_programs

HOME = pathlib.Path("/home/ada")
PROGRAM = """
from ha2g_jax.files.cache import keep_programs
keep_programs()
import jax
print(jax.config.jax_compilation_cache_dir, jax.config.jax_compilation_cache_max_size)
"""


@pytest.mark.parametrize(
    ("own", "shared", "expected"),
    [
        ("/big/ha2g", "/caches", "/big/ha2g"),
        (None, "/caches", "/caches/ha2g-jax"),
        (None, "relative", "/home/ada/.cache/ha2g-jax"),
        (None, None, "/home/ada/.cache/ha2g-jax"),
    ],
)
def test_the_first_that_is_set_wins(own, shared, expected, monkeypatch):
    monkeypatch.setenv("HOME", str(HOME))
    for name, value in (("HA2G_CACHE", own), ("XDG_CACHE_HOME", shared)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert cache_folder() == pathlib.Path(expected)


def cache_of(**variables):
    """Return the folder and the size that JAX has in a new process."""
    environment = {name: value for name, value in os.environ.items() if "COMPILATION_CACHE" not in name} | variables
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({}, "cache/programs"),
        ({"HA2G_COMPILE_CACHE": "0"}, None),
        ({"JAX_COMPILATION_CACHE_DIR": "/mine"}, "/mine"),
    ],
)
def test_programs_are_kept_where_the_user_wants_them(variables, folder, tmp_path):
    found, size = cache_of(HA2G_CACHE=str(tmp_path / "cache"), **variables)
    assert found == ("None" if folder is None else str(tmp_path / folder))
    assert (int(size) > 0) == (not variables)


def test_a_cache_folder_that_cannot_be_made_does_not_matter(tmp_path):
    (tmp_path / "file").write_text("")
    assert cache_of(HA2G_CACHE=str(tmp_path / "file"))[0] == "None"


def test_a_user_without_a_home_can_run_commands(monkeypatch):
    def no_home():
        raise RuntimeError

    for name in ("JAX_COMPILATION_CACHE_DIR", "HA2G_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pathlib.Path, "home", no_home)
    keep_programs()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ

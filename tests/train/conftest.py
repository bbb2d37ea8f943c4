"""Workdirs of runs below the folder of a test."""

import functools

import pytest
from fixtures.workdirs import write_run


@pytest.fixture
def make_run(tmp_path):
    """`write_run` by the name of a run, which is a path below `tmp_path`."""

    @functools.wraps(write_run)
    def make_run(name="run", *arguments, **options):
        return write_run(tmp_path / name, *arguments, **options)

    return make_run

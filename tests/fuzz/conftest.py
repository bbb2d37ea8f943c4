"""Fixtures of the fuzz tests: a reader answers any content, and a command refuses it in one line."""

import contextlib
import pathlib
import resource
import time
from collections.abc import Callable, Iterator

import pytest

from ha2g_jax import cli
from ha2g_jax.errors import UserError

MAX_SECONDS, MAX_WAIT = 10.0, 60.0
MAX_BYTES = 2 << 30


@contextlib.contextmanager
def within_limits() -> Iterator[None]:
    """Fail if the context takes more than 10 s or 2 GiB more than the most that the process has used before.

    The seconds are those of the processor, as other programs may be at work, unless it takes a minute in all.
    """
    start, clock, before = time.process_time(), time.monotonic(), _peak_bytes()
    yield
    seconds, waited, num_bytes = time.process_time() - start, time.monotonic() - clock, _peak_bytes() - before
    assert waited < MAX_WAIT, f"{waited:.0f} s"
    assert seconds < MAX_SECONDS, f"{seconds:.1f} s"
    assert num_bytes < MAX_BYTES, f"{num_bytes / 2**30:.1f} GiB"


@contextlib.contextmanager
def one_line(most: int = 1_000) -> Iterator[None]:
    """Suppress a `UserError` of one line of fewer than `most` letters; fail as `within_limits` does."""
    with within_limits():
        try:
            yield
        except UserError as error:
            assert "\n" not in str(error) and len(str(error)) < most


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.fixture
def answered(tmp_path: pathlib.Path) -> Callable:
    """A function that calls a reader with a file of some content, which may raise a one-line `UserError` only."""

    def answered(read: Callable[[pathlib.Path], object], content: bytes, name: str) -> None:
        path = tmp_path / name
        path.write_bytes(content)
        with one_line():
            read(path)

    return answered


@pytest.fixture
def refused(capsys: pytest.CaptureFixture) -> Callable:
    """A function that runs a command, checks that it is refused in one line with code 2, and returns the line."""

    def refused(*argv: str) -> str:
        with within_limits():
            try:
                code = cli.main(list(argv))
            except SystemExit as stop:  # argparse
                code = stop.code
        lines = capsys.readouterr().err.strip().splitlines()
        assert code == 2, lines
        assert lines[-1].startswith("ha2g"), lines
        assert not any("Traceback" in line for line in lines)
        return lines[-1]

    return refused

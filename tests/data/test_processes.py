"""Work in processes: in order, little ahead of who takes the results, and never waiting for a process that died."""

import multiprocessing
import os
import pathlib
import signal
from collections.abc import Iterator

import pytest

from ha2g_jax.data import processes
from ha2g_jax.errors import UserError

DIED = "a process died; use fewer workers"


def number_of_calls(counter: str, number: int) -> int:
    with pathlib.Path(counter).open("a") as file:
        file.write("x")
    return number


def crash(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGSEGV)  # as a C library does at worst
    return number


@pytest.fixture(scope="module")
def executor() -> Iterator[processes.Executor]:
    with processes.workers(2) as executor:
        yield executor


def test_results_come_in_order_and_little_is_ahead(executor: processes.Executor, tmp_path: pathlib.Path):
    counter = tmp_path / "calls"
    tasks = ((str(counter), number) for number in range(40))
    for number, result in enumerate(processes.in_order(executor, number_of_calls, tasks, 2, DIED)):
        assert result == number
        assert len(counter.read_text()) <= number + 5
    assert len(counter.read_text()) == 40


def test_workers_leave_ctrl_c_to_the_parent(executor: processes.Executor):
    [blocked] = processes.in_order(executor, signal.pthread_sigmask, [(signal.SIG_BLOCK, [])], 1, DIED)
    assert signal.SIGINT in blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_the_death_of_a_worker_is_one_line():
    others = set(multiprocessing.active_children())
    with pytest.raises(UserError, match=DIED), processes.parallel_map(2, DIED) as each:
        list(each(crash, range(9)))
    assert set(multiprocessing.active_children()) == others


def test_one_process_is_this_one():
    with processes.parallel_map(1, DIED) as each:
        assert set(each(lambda _: os.getpid(), range(3))) == {os.getpid()}

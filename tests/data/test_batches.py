"""A batch is a function of the seed and its number, whoever reads it; workers end, and pass on what went wrong."""

import multiprocessing
import os
import pathlib
import signal
import subprocess
import sys
import time
from collections import namedtuple

import numpy as np
import pytest
from fixtures.corpora import write_corpus
from fixtures.processes import is_gone

from ha2g_jax.data.augment import Augmentation
from ha2g_jax.data.batches import batch_names, batches
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import encode_clip
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError

EVERYTHING = Augmentation(jitter=9, mirror=0.5, gain_db=6.0, noise=0.5, lookahead=0.5, least_heard=4)


@pytest.fixture(scope="module")
def windows(tiny_talk) -> Windows:
    corpus = Corpus.open(tiny_talk)
    return Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_images=4, image_size=32)


@pytest.fixture(scope="module")
def expected(windows) -> list[dict[str, np.ndarray]]:
    """The first six batches of eight, with everything random in them."""
    return _take(batches(windows, 8, 0, augmentation=EVERYTHING), 6)


def _take(iterator, count: int) -> list[dict[str, np.ndarray]]:
    try:
        return [next(iterator) for _ in range(count)]
    finally:
        iterator.close()


def _assert_equal(found, expected) -> None:
    for batch, other in zip(found, expected, strict=True):
        assert batch.keys() == other.keys()
        for name in batch:
            np.testing.assert_array_equal(batch[name], other[name])


@pytest.mark.parametrize("size", [1, 8])
def test_batches_are_row_major_and_own_their_memory(windows, size):
    """As shared memory takes them; and nobody can write into a clip in the cache."""
    for batch in _take(batches(windows, size, 0, augmentation=Augmentation(mirror=0.5)), 4):
        assert all(array.flags.c_contiguous and array.flags.writeable for array in batch.values())


def test_a_seed_gives_an_order(windows, expected):
    _assert_equal(_take(batches(windows, 8, 0, augmentation=EVERYTHING), 6), expected)
    other = _take(batches(windows, 8, 1, augmentation=EVERYTHING), 1)
    assert not np.array_equal(other[0]["directions"], expected[0]["directions"])


def test_a_batch_is_the_same_wherever_the_iterator_starts(windows, expected):
    for first in (1, 4):
        found = _take(batches(windows, 8, 0, augmentation=EVERYTHING, first=first), 6 - first)
        _assert_equal(found, expected[first:])


@pytest.mark.parametrize("first", [0, 3])
def test_hosts_have_the_rows_of_a_batch_in_order(windows, expected, first):
    for num_hosts in (2, 4):
        hosts = [
            _take(batches(windows, 8, 0, augmentation=EVERYTHING, first=first, host=host, num_hosts=num_hosts), 3)
            for host in range(num_hosts)
        ]
        joined = [{name: np.concatenate([part[name] for part in parts]) for name in parts[0]} for parts in zip(*hosts)]
        _assert_equal(joined, expected[first : first + 3])


def test_each_epoch_has_every_window_in_another_order(tiny_talk):
    corpus = Corpus.open(tiny_talk)
    windows = Windows(corpus, "val", corpus.vocabulary(), num_frames=34, num_reference_images=4)
    everything = sorted(windows[index]["directions"].tobytes() for index in range(len(windows)))
    drawn = [batch["directions"][0].tobytes() for batch in _take(batches(windows, 1, 0), 2 * len(windows))]
    first, second = drawn[: len(windows)], drawn[len(windows) :]
    assert sorted(first) == everything == sorted(second)
    assert first != second


def test_each_epoch_draws_other_random_numbers(windows):
    """A gain is drawn for each window; over two epochs a window has two levels."""
    count = len(windows)
    loudest = {}
    for batch in _take(batches(windows, 1, 0, augmentation=Augmentation(gain_db=5.0)), 2 * count):
        loudest.setdefault(batch["directions"].tobytes(), set()).add(float(batch["mel"].max()))
    assert {len(levels) for levels in loudest.values()} == {2}


def test_without_augmentation_windows_are_as_they_are(windows):
    names = batch_names(windows, 8, 0, 2)
    (batch,) = _take(batches(windows, 8, 0, first=2), 1)
    index = {windows.name(index): index for index in range(len(windows))}
    for row, name in enumerate(names):
        for key, array in windows[index[name]].items():
            np.testing.assert_array_equal(batch[key][row], array)


def test_jitter_starts_windows_between_the_stored_starts(windows):
    stored = {windows[index]["directions"].tobytes() for index in range(len(windows))}
    drawn = _take(batches(windows, 8, 0, augmentation=Augmentation(jitter=9)), 4)
    assert len({example.tobytes() for batch in drawn for example in batch["directions"]} - stored) > 16


def test_an_iterator_continues_from_its_state(windows, expected):
    iterator = batches(windows, 8, 0, augmentation=EVERYTHING)
    next(iterator)
    next(iterator)
    state = iterator.get_state()
    iterator.close()
    resumed = batches(windows, 8, 0, augmentation=EVERYTHING)
    resumed.set_state(state)
    _assert_equal(_take(resumed, 4), expected[2:])


def test_too_little_shared_memory_is_refused(windows, monkeypatch):
    usage = namedtuple("usage", "total used free")(64 << 20, 64 << 20, 0)
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage)
    with pytest.raises(UserError, match=r"shared memory, /dev/shm has 0: .*data\.workers=0"):
        batches(windows, 8, seed=0, workers=1)


def test_workers_give_the_batches_of_threads_and_end(windows, expected):
    iterator = batches(windows, 8, 0, augmentation=EVERYTHING, first=1, workers=2)
    _assert_equal([next(iterator) for _ in range(5)], expected[1:])
    assert len(multiprocessing.active_children()) == 2
    iterator.close()
    assert multiprocessing.active_children() == []


@pytest.fixture(scope="module")
def damaged(tiny_talk, tmp_path_factory) -> pathlib.Path:
    """A corpus in which the speech of every clip is damaged."""
    path = tmp_path_factory.mktemp("damaged") / "corpus"
    source = Corpus.open(tiny_talk).clips("val")
    records = [encode_clip(clip).replace(b"fLaC", b"nope") for clip in source]
    return write_corpus(path, {"train": records}, skeleton="ted_expressive")


@pytest.mark.parametrize("workers", [0, 1])
def test_a_users_error_reaches_the_caller(damaged, workers, monkeypatch):
    monkeypatch.setattr("ha2g_jax.data.batches._check_shared_memory", lambda *_: None)  # which would meet it first
    corpus = Corpus.open(damaged)
    windows = Windows(corpus, "train", corpus.vocabulary(), num_frames=34, num_reference_images=4)
    iterator = batches(windows, 2, 0, workers=workers)
    with pytest.raises(UserError, match=r"clip val-.*, record \d+ of .*train-00000.array_record, is damaged"):
        next(iterator)
    iterator.close()


PROGRAM = """\
import multiprocessing, signal, sys, time
from ha2g_jax.data.batches import batches
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.windows import Windows

def main():
    corpus = Corpus.open(sys.argv[1])
    windows = Windows(corpus, "val", corpus.vocabulary(), num_frames=34, num_reference_images=4)
    signal.signal(signal.SIGTERM, lambda *_: None)
    iterator = batches(windows, 2, 0, workers=1)
    if sys.argv[2] == "working":
        next(iterator)
        next(iterator)
    while len(multiprocessing.active_children()) < 1:
        time.sleep(0.01)
    print(*[process.pid for process in multiprocessing.active_children()], flush=True)
    try:
        time.sleep(600)
    except KeyboardInterrupt:
        print(len([next(iterator) for _ in range(9)]), flush=True)

if __name__ == "__main__":
    main()
"""


def _start(folder: pathlib.Path, data: pathlib.Path, state: str) -> tuple[subprocess.Popen, list[int]]:
    """A program with a worker, and the process ids of its workers; "starting" or "working" when this returns."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(program), str(data), state],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )
    assert process.stdout is not None
    return process, [int(pid) for pid in process.stdout.readline().split()]


def test_workers_end_with_a_parent_that_is_killed(tmp_path, tiny_talk):
    process, workers = _start(tmp_path, tiny_talk, "working")
    assert len(workers) == 1
    process.kill()
    process.communicate()
    assert all(map(is_gone, workers))


def test_stop_signals_to_the_group_leave_workers_at_work(tmp_path, tiny_talk):
    """As of Ctrl-C in a terminal, or of a job's SIGTERM: the parent decides, even while the workers are starting."""
    process, workers = _start(tmp_path, tiny_talk, "starting")
    os.killpg(process.pid, signal.SIGTERM)
    time.sleep(0.2)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=120)
    assert (output, errors, process.returncode) == ("9\n", "", 0)
    assert all(map(is_gone, workers))  # although the program did not close the iterator

"""Batches of training windows: batch n is a function of the seed and of n alone.

It does not matter where the iterator started, how many hosts share the batches, or whether threads or processes
read them; so the number of batches taken is all that a checkpoint needs to know.
"""

import functools
import multiprocessing
import os
import pathlib
import shutil
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker

import grain
import numpy as np
from absl import flags

from ha2g_jax.data.augment import Augmentation, augment
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError

# Decoding leaves the interpreter's lock alone, so threads decode side by side; slices of clips in memory gain nothing.
_THREADS = grain.ReadOptions(num_threads=4, prefetch_buffer_size=4)
# A worker has the queue to its parent for a buffer, and ends as soon as the batch at hand is done.
_ONE_BY_ONE = grain.ReadOptions(num_threads=0, prefetch_buffer_size=0)

_UNCHANGED = Augmentation()
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SHARED_MEMORY = pathlib.Path("/dev/shm")  # where Linux keeps what processes share


def batches(
    windows: Windows,
    batch_size: int,
    seed: int,
    *,
    augmentation: Augmentation = _UNCHANGED,
    first: int = 0,
    host: int = 0,
    num_hosts: int = 1,
    workers: int = 0,
) -> grain.DatasetIterator:
    """An endless iterator over batches, each epoch in another order.

    Close it when done with it (`close()`): its workers end then.

    Args:
        windows: of the training split.
        batch_size: B, of all hosts together.
        seed: of the order and of everything random in the windows.
        augmentation: what is random in the windows.
        first: number of the first batch to give, from 0.
        host: of `num_hosts`; gets rows [host x B / num_hosts, (host + 1) x B / num_hosts) of each batch.
        num_hosts: that share the batches.
        workers: processes that read and decode; 0 for threads of this one. They share `windows.cache_bytes`.

    Raises:
        UserError: there are fewer windows than `batch_size`, it does not divide over the hosts, or there is too
            little shared memory for the workers. From the iterator: a clip cannot be decoded.
    """
    if batch_size > len(windows):
        raise UserError(
            f"a batch of {batch_size} is more than the {len(windows)} windows there are: "
            "lower --config.train.batch_size or take more data"
        )
    if batch_size % num_hosts:
        raise UserError(
            f"a batch of {batch_size} does not divide over {num_hosts} hosts: "
            f"set --config.train.batch_size to a multiple of {num_hosts}"
        )
    part = batch_size // num_hosts
    if workers:
        _check_shared_memory(windows, part, workers)
        windows = windows.with_cache(windows.cache_bytes // workers)
    draw = functools.partial(_draw, windows, augmentation)
    numbered = _order(windows, seed).random_map(draw).batch(part, drop_remainder=True, batch_fn=_stack)
    dataset = numbered[first * num_hosts + host :: num_hosts].to_iter_dataset(_ONE_BY_ONE if workers else _THREADS)
    if not workers:
        return iter(dataset)
    if not flags.FLAGS.is_parsed():
        flags.FLAGS.mark_as_parsed()  # grain reads its absl flags; a program that has none leaves them unparsed
    with _stop_signals_blocked():
        shared = dataset.mp_prefetch(grain.MultiprocessingOptions(workers), worker_init_fn=_start_worker)
        iterator = iter(shared.map(_own))
        iterator.get_state()  # makes the iterators of the workers, which can then be started
        iterator.start_prefetch()
    return iterator


def batch_names(windows: Windows, batch_size: int, seed: int, number: int) -> list[str]:
    """`Windows.name` of each row of batch `number`, for reports; a window may start late by the jitter."""
    order = _order(windows, seed)
    rows = np.array([order[row] for row in range(number * batch_size, (number + 1) * batch_size)])
    return [windows.name(row) for row in rows.tolist()]


def _order(windows: Windows, seed: int) -> grain.MapDataset:
    """The indices of the windows, epoch after epoch."""
    return grain.MapDataset.range(len(windows)).seed(seed).shuffle().repeat()


def _draw(windows: Windows, augmentation: Augmentation, index: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    example = windows.example(index, delay=int(rng.integers(augmentation.jitter + 1)))
    return augment(example, augmentation, windows.skeleton, windows.num_training_speakers, rng)


def _stack(examples: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """A batch of examples, in row-major order.

    Other arrays would go from a worker through a pipe instead of shared memory, and a worker that is closed while
    its pipe is full ends only when it is killed, after 25 s.
    """
    return {name: np.ascontiguousarray(np.stack([example[name] for example in examples])) for name in examples[0]}


def _own(batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Copies out of the memory shared with the workers, which JAX on a CPU would hold on to until the process ends."""
    return {name: np.array(array) for name, array in batch.items()}


def _check_shared_memory(windows: Windows, batch_size: int, workers: int) -> None:
    """A worker that finds no room there for a batch is killed without a message."""
    if not _SHARED_MEMORY.is_dir():
        return
    batch_bytes = batch_size * sum(array.nbytes for array in windows.example(0).values())
    needed = batch_bytes * (3 * workers + 2)  # made, waiting in the queue and in this process; and those in use
    free = shutil.disk_usage(_SHARED_MEMORY).free
    if free < needed:
        raise UserError(
            f"{workers} workers need {needed / 2**20:.0f} MiB of shared memory, {_SHARED_MEMORY} has "
            f"{free / 2**20:.0f}: give the container more (docker --shm-size) or set --config.data.workers=0"
        )


@contextmanager
def _stop_signals_blocked() -> Iterator[None]:
    """Processes and threads that are started here never see Ctrl-C or SIGTERM.

    Both reach all processes of a terminal or of a job. A worker that heeded them would fail the batch that its
    parent may be waiting for; the parent ends its workers when it ends.
    """
    resource_tracker.ensure_running()  # else it is started on the way and sets the signals free
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(index: int, count: int) -> None:
    """Runs first in each worker."""
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that was killed cannot end its workers, and they would wait for it for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(0)

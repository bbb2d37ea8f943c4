"""Batches of training windows: batch n depends only on the seed and on n, so that a checkpoint stores only n."""

import functools
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
from ha2g_jax.data.processes import end_with_parent
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError
from ha2g_jax.stopping import STOP_SIGNALS

# Decoding releases Python's global lock, so threads decode in parallel; cutting clips in memory does not get faster.
_THREADS = grain.ReadOptions(num_threads=4, prefetch_buffer_size=4)
# A worker's buffer is the queue to its parent, so that it ends as soon as its current batch is done.
_ONE_BY_ONE = grain.ReadOptions(num_threads=0, prefetch_buffer_size=0)

_UNCHANGED = Augmentation()
_SHARED_MEMORY = pathlib.Path("/dev/shm")  # shared memory of processes on Linux


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
    """Return an endless iterator over batches, in a new order in each epoch; `close()` ends its workers.

    Args:
        batch_size: number B of windows in a batch, over all hosts.
        first: number of the first batch, from 0.
        host: index of this host, which gets rows [host x B / num_hosts, (host + 1) x B / num_hosts) of each batch.
        workers: number of processes that read and decode, 0 for threads of this process; `windows.cache_bytes` is
            divided among them.

    Returns:
        An iterator over dicts of arrays with a leading axis of B / num_hosts; see `Windows` for the names. It raises
        `UserError` if a clip cannot be decoded.

    Raises:
        UserError: there are fewer windows than B, the hosts do not divide B, or there is too little shared memory.
    """
    check_batch(batch_size, windows)
    if batch_size % num_hosts:
        raise UserError(
            f"a batch of {batch_size} is not divisible by {num_hosts} hosts; "
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
        flags.FLAGS.mark_as_parsed()  # grain reads its absl flags, which a program without flags leaves unparsed
    with _stop_signals_blocked():
        shared = dataset.mp_prefetch(grain.MultiprocessingOptions(workers), worker_init_fn=_start_worker)
        iterator = iter(shared.map(_own))
        iterator.get_state()  # creates the iterators of the workers, which can then be started
        iterator.start_prefetch()
    return iterator


def check_batch(batch_size: int, windows: Windows) -> None:
    """Raise a `UserError` if there are fewer windows than a batch has."""
    if batch_size > len(windows):
        raise UserError(
            f"a batch of {batch_size} is more than the {len(windows)} windows of the split; "
            "lower --config.train.batch_size or use more data"
        )


def batch_names(windows: Windows, batch_size: int, seed: int, number: int) -> list[str]:
    """Return the name of the window (see `Windows.name`) in each row of a batch; jitter may delay its start."""
    order = _order(windows, seed)
    rows = np.array([order[row] for row in range(number * batch_size, (number + 1) * batch_size)])
    return [windows.name(row) for row in rows.tolist()]


def _order(windows: Windows, seed: int) -> grain.MapDataset:
    return grain.MapDataset.range(len(windows)).seed(seed).shuffle().repeat()


def _draw(windows: Windows, augmentation: Augmentation, index: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    delay = int(rng.integers(augmentation.jitter + 1))
    return augment(
        windows.example(index, delay),
        augmentation,
        windows.skeleton,
        windows.num_training_speakers,
        rng,
        clip_power=windows.clip_power(index) if augmentation.noise else 0.0,
        start_frame=windows.start_frame(index, delay),
        fps=windows.fps,
    )


def _stack(examples: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Stack examples into a batch of arrays in row-major order.

    Arrays in another order would be sent by a worker through a pipe and not through shared memory, and a worker that is
    closed while its pipe is full ends only when it is killed, after 25 s.
    """
    return {name: np.ascontiguousarray(np.stack([example[name] for example in examples])) for name in examples[0]}


def _own(batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Copy a batch out of the memory shared with the workers, which JAX would keep on a CPU until the process ends."""
    return {name: np.array(array) for name, array in batch.items()}


def _check_shared_memory(windows: Windows, batch_size: int, workers: int) -> None:
    """Check that there is enough shared memory, because otherwise a worker is killed without a message."""
    if not _SHARED_MEMORY.is_dir():
        return
    batch_bytes = batch_size * sum(array.nbytes for array in windows.example(0).values())
    needed = batch_bytes * (3 * workers + 2)  # each worker: one made, one queued, one here; two in use
    free = shutil.disk_usage(_SHARED_MEMORY).free
    if free < needed:
        raise UserError(
            f"{workers} workers need {needed / 2**20:.0f} MiB of shared memory, {_SHARED_MEMORY} has "
            f"{free / 2**20:.0f}: give the container more (docker --shm-size) or set --config.data.workers=0"
        )


@contextmanager
def _stop_signals_blocked() -> Iterator[None]:
    """Block stop signals in processes and threads that are started in this context.

    These signals reach all processes of a terminal or of a job. A worker that ended on them would fail the batch that
    its parent may be waiting for; the parent ends its workers when it ends.
    """
    resource_tracker.ensure_running()  # otherwise it is started later and unblocks the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(index: int, count: int) -> None:
    threading.Thread(target=end_with_parent, daemon=True).start()

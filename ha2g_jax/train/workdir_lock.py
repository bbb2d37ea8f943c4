"""One training at a time in a workdir."""

import contextlib
import pathlib
from collections.abc import Iterator

import filelock

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.train.writing import writing

LOCK = "training.lock"

_PATIENCE = 1.0  # seconds; `is_training` may hold the lock for a moment


@contextlib.contextmanager
def only_run(workdir: pathlib.Path) -> Iterator[None]:
    """Hold the lock of a workdir, which is made if it does not exist; only the first host of a run calls this.

    The system takes the lock from a process that ends in any way, so that a run that was killed continues at once. The
    file stays, because without it a third process could lock a new file while a second one still holds the old one;
    only a new workdir that nothing else was written to is removed.

    Other hosts respect the lock if the workdir is on NFS with its usual settings: Linux passes such locks on to the
    server. With the mount options "nolock" or "local_lock=all", and on some other file systems of clusters, each
    host sees only its own locks.

    Args:
        workdir: folder of the run.

    Raises:
        UserError: another process trains in the workdir, or it cannot be written.
    """
    with writing(workdir):
        is_new = not workdir.exists()
        workdir.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(workdir / LOCK)
        try:
            lock.acquire(timeout=_PATIENCE)
        except filelock.Timeout as error:
            raise UserError(
                f"another process trains in {shown(workdir)}: wait until it ends, or choose another --workdir"
            ) from error
    try:
        yield
    finally:
        if is_new and [path.name for path in workdir.iterdir()] == [LOCK]:  # the run was refused before it wrote
            with contextlib.suppress(OSError):
                (workdir / LOCK).unlink()
                workdir.rmdir()
        lock.release()


def is_training(workdir: pathlib.Path) -> bool:
    """Return whether a process trains in a workdir, as far as this host sees its lock; see `only_run`.

    Args:
        workdir: folder of a run.

    Raises:
        OSError: the lock cannot be opened, as that of another user.
    """
    if not (workdir / LOCK).exists():
        return False
    lock = filelock.FileLock(workdir / LOCK)
    try:
        lock.acquire(timeout=0)
    except filelock.Timeout:
        return True
    lock.release()
    return False

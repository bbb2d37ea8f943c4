"""The metrics of a run, and the lock of its workdir, which keeps a second training out.

Nothing here imports JAX, for which a list of runs should not wait.
"""

import contextlib
import json
import operator
import pathlib
from collections.abc import Iterator

import filelock

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import write_text, writing

METRICS, LOCK = "metrics.jsonl", "training.lock"
VALIDATION_PREFIX = "validation/"  # prefix of the metrics of the validation split

CONTINUE = "correct this, then the same command continues"  # advice where a file cannot be written

_PATIENCE = 1.0  # seconds; `is_training` may hold the lock for a moment


def start_metrics(path: pathlib.Path, step: int) -> None:
    """Drop the lines of a `metrics.jsonl` for steps after that at which a run starts, and an incomplete last one."""
    lines = read_metrics(path) if path.exists() else []
    write_text(path, "".join(json.dumps(line) + "\n" for line in lines if line["step"] <= step), CONTINUE)


def append_metrics(path: pathlib.Path, step: int, metrics: dict[str, float]) -> None:
    """Append the line of a step to a `metrics.jsonl`: one JSON object, numbers with six digits."""
    rounded = {name: float(f"{value:.6g}") for name, value in metrics.items()}
    # The file is opened for each line, so that nothing stays in a buffer, not even that of a network disk.
    with writing(path, CONTINUE), path.open("a") as file:
        file.write(json.dumps({"step": step} | rounded) + "\n")


def read_metrics(path: pathlib.Path, containing: str = "") -> list[dict[str, float]]:
    """Return the lines of a `metrics.jsonl`, without a last one that a killed run left incomplete.

    Args:
        path: path of the file.
        containing: return only the last line and the lines that contain this text; skipping a line takes little time.

    Raises:
        UserError: there is no such file, or a line of it is damaged.
    """
    if not path.is_file():
        raise UserError(f"no metrics in {shown(path)}; expected the metrics.jsonl of a workdir")
    lines = path.read_text(errors="replace").split("\n")[:-1]
    chosen = [*(line for line in lines[:-1] if containing in line), *lines[-1:]]
    rows = []
    for line in chosen:
        try:
            rows.append(json.loads(line))
            operator.index(rows[-1]["step"])
        except (ValueError, TypeError, LookupError) as error:
            raise UserError(f"{shown(path)} has a damaged line, {shown(line[:80])}; remove it") from error
    return rows


@contextlib.contextmanager
def only_run(workdir: pathlib.Path) -> Iterator[None]:
    """Hold the lock of a workdir, which is made if it does not exist; only the first host of a run calls this.

    The system takes the lock from a process that ends in any way, so that a run that was killed continues at once. The
    file stays, because without it a third process could lock a new file while a second one still holds the old one;
    only a new workdir that nothing else was written to is removed.

    Other hosts respect the lock if the workdir is on NFS with its usual settings: Linux passes such locks on to the
    server. With the mount options "nolock" or "local_lock=all", and on some other file systems of clusters, each
    host sees only its own locks.

    Raises:
        UserError: another process trains in the workdir, or it cannot be written.
    """
    with writing(workdir, CONTINUE):
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

    Raises:
        OSError: the lock cannot be opened, for example because it belongs to another user.
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

"""The checkpoints of a run in one folder, each written atomically in the format of Orbax.

They are written in the background while training continues. Orbax fills a folder with a temporary name and renames it
when it is complete, so that a run that is killed meanwhile leaves nothing that counts as a checkpoint. The last file
written, SHA256SUMS, has the checksums of all files in subfolders, but not of Orbax's notes in the folder itself, so
that damage by a disk, a copy or a network is found before a checkpoint is used. `sha256sum -c SHA256SUMS` finds it too.
"""

import contextlib
import functools
import json
import logging
import os
import pathlib
import re
import shutil
import sys
import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import tqdm
from jax.experimental import multihost_utils

from ha2g_jax.checkpoint import CHECKSUMS
from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, read_json, shown
from ha2g_jax.limits import MAX_RECORD_BYTES

_NONE, _ALL_DAMAGED = -1, -2  # sent by the first process to the others instead of a step
_REMOVALS = 10  # attempts to remove temporary folders


class Checkpoints:
    """Checkpoints in one folder, each in a subfolder named after its step.

    If there are several processes, all of them call `save` and `restore_newest` at the same steps. Nothing is created
    or removed before the first `save`, so that the checkpoints of a run can be read while the run continues.

    Args:
        folder: folder of the checkpoints, shared by all processes.
        keep: number of checkpoints to keep; older ones are removed once a newer one is complete.
    """

    def __init__(self, folder: pathlib.Path, keep: int = 1):
        self._folder = folder.absolute()
        self._keep = keep
        self._manager: ocp.CheckpointManager | None = None
        self._writing: int | None = None  # step that is being written or was written last
        self._size = 0
        _hide_echoes()

    def steps(self) -> list[int]:
        """Return the steps of the complete checkpoints, in ascending order."""
        if not self._folder.is_dir():
            return []
        return sorted(int(path.name) for path in self._folder.iterdir() if path.name.isdecimal() and path.is_dir())

    def save(self, step: int, state: TrainState, record: dict[str, Any]) -> None:
        """Start to write the checkpoint of a step; do nothing if there is one already.

        This waits for the previous checkpoint to be written, and returns as soon as `state` may be donated.

        Args:
            record: plain values to store with it.

        Raises:
            UserError: this checkpoint or the previous one cannot be written, for example because the disk is full.
        """
        self.wait()
        if step in self.steps():
            return
        args = ocp.args.Composite(
            # Orbax writes from views of the arrays' memory, which the next step overwrites.
            state=ocp.args.StandardSave(_copy(state)),
            arrays=ocp.args.JsonSave(_arrays_of(state)),
            record=ocp.args.JsonSave(json.loads(json.dumps(record))),
        )
        self._size = sum(leaf.nbytes for leaf in jax.tree.leaves(state))
        self._writing = step
        with self._blaming_the_disk():
            self._manager = self._manager or self._open()
            self._manager.save(step, args=args, force=True)  # without `force` Orbax skips some steps silently

    def drop_after(self, step: int) -> None:
        """Delete the checkpoints after a step, from which a run goes on; call it before the first `save`."""
        for each in self.steps():
            if each > step:
                shutil.rmtree(self._folder / str(each))

    def wait(self) -> None:
        """Wait until the last checkpoint is on the disk.

        Raises:
            UserError: the checkpoint could not be written.
        """
        if self._manager:
            with self._blaming_the_disk():
                self._manager.wait_until_finished()

    def check(self) -> None:
        """Raise the error of the last checkpoint, if there was one, without waiting for it to be written."""
        if self._manager and not self._manager.is_saving_in_progress():
            self.wait()

    def close(self) -> None:
        """Wait until the last checkpoint is on the disk, then release all resources; see `wait`."""
        self.wait()
        if self._manager:
            self._manager.close()
            self._manager = None

    def restore_model(self, step: int, shapes: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read the variables of the generator to evaluate or ship, and the record, but no other state.

        The variables are numpy arrays, those of the running average if there is one; `shapes` is {"params",
        "batch_stats"} of the generator as a tree of `jax.ShapeDtypeStruct`.

        Raises:
            UserError: the checkpoint is damaged or of another model.
        """
        path = self._path(step)
        if reason := _damage(path):
            others = [path.with_name(str(other)) for other in self.steps() if other != step]
            advice = f"use {shown(others[-1])}" if others else "put back a good copy"
            raise UserError(f"checkpoint {shown(path)} is damaged ({reason}); {advice}")
        return _read_variables(path, shapes), _read(path, "record")

    def restore_newest(self, like: TrainState) -> tuple[TrainState, dict[str, Any]] | None:
        """Read the state and the record of the newest undamaged checkpoint; return None if there is no checkpoint.

        Newer checkpoints that are damaged are named on stderr and renamed to STEP.damaged, so that the run can write
        these steps again and the files can still be examined.

        Args:
            like: tree of arrays, or of shapes with types and shardings, that the restored state is to have. The
                devices may be other ones than those that the state was saved from.

        Raises:
            UserError: all checkpoints are damaged, or the newest undamaged one is of another model.
        """
        self.wait()
        step = self._set_aside_damaged() if jax.process_index() == 0 else _NONE
        if jax.process_count() > 1:  # the others may see an older state of a shared disk
            step = int(multihost_utils.broadcast_one_to_all(np.int32(step)))
        if step == _ALL_DAMAGED:
            reasons = ", ".join(f"{step}: {_damage(self._path(step))}" for step in self.steps())
            raise UserError(
                f"all checkpoints in {shown(self._folder)} are damaged ({reasons}); put back a good copy, or choose "
                "another --workdir"
            )
        if step == _NONE:
            return None
        path = self._path(step)
        _check_arrays(path, _read(path, "arrays"), _arrays_of(like))
        with ocp.Checkpointer(ocp.StandardCheckpointHandler()) as checkpointer:
            state = checkpointer.restore(path / "state", args=ocp.args.StandardRestore(like))
        return state, _read(path, "record")

    def _path(self, step: int | None) -> pathlib.Path:
        return self._folder / str(step)

    def _open(self) -> ocp.CheckpointManager:
        options = ocp.CheckpointManagerOptions(
            max_to_keep=self._keep,
            cleanup_tmp_directories=True,
            lightweight_initialize=True,  # otherwise damaged checkpoints would make it fail
            async_options=ocp.AsyncOptions(post_finalization_callback=self._write_checksums),
            multiprocessing_options=ocp.options.MultiprocessingOptions(
                barrier_sync_key_prefix=self._folder.name  # latest and best may be written at the same time
            ),
        )
        return ocp.CheckpointManager(self._folder, options=options)

    def _write_checksums(self) -> None:
        (folder,) = self._temporary()
        (folder / CHECKSUMS).write_text(_checksums(folder))

    def _temporary(self) -> list[pathlib.Path]:
        """Return the folders of the current step that are not complete yet."""
        return list(self._folder.glob(f"{self._writing}{ocp.utils.TMP_DIR_SUFFIX}*"))

    def _remove_temporary(self) -> None:
        # Other threads of Orbax may still be running and create the folder again. A folder that is created even later
        # is removed at the next start.
        for _ in range(_REMOVALS):
            for folder in self._temporary():
                shutil.rmtree(folder, ignore_errors=True)
            time.sleep(0.1)

    @contextlib.contextmanager
    def _blaming_the_disk(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self._manager = None
            if jax.process_index() == 0:
                self._remove_temporary()
            left = (
                f"{self._folder.name}/{self.steps()[-1]} is complete"
                if self.steps()
                else f"{self._folder.name} has no earlier one"
            )
            free = shutil.disk_usage(self._folder).free if self._folder.is_dir() else 0
            raise UserError(
                f"cannot write checkpoint {shown(self._path(self._writing))} "
                f"({_reason(error)}; it needs {self._size / 1e6:.1f} MB, {free / 1e6:.1f} MB are free); "
                f"{left}: free some space, then the same command continues"
            ) from error

    def _set_aside_damaged(self) -> int:
        """Return the newest undamaged step, after renaming newer ones that are damaged."""
        damaged: dict[pathlib.Path, str] = {}
        for step in reversed(self.steps()):
            path = self._path(step)
            if reason := _damage(path):
                damaged[path] = reason
                continue
            for other, reason in damaged.items():
                name, number = f"{other.name}.damaged", 1
                while other.with_name(name).exists():
                    number += 1
                    name = f"{other.name}.damaged-{number}"
                other.rename(other.with_name(name))
                line = f"checkpoint {shown(other)} is damaged ({reason}) and was renamed to {name}; using {shown(path)}"
                tqdm.tqdm.write(line, file=sys.stderr)
            return step
        return _ALL_DAMAGED if damaged else _NONE


@jax.jit
def _copy(state: TrainState) -> TrainState:
    return jax.tree.map(jnp.copy, state)


def _read_variables(path: pathlib.Path, shapes: Any) -> dict[str, Any]:
    there = _read(path, "arrays")
    name = "average" if any(key.startswith("average/") for key in there) else "generator"
    stored = {key: value for key, value in there.items() if key.startswith((f"{name}/params/", f"{name}/batch_stats/"))}
    _check_arrays(path, stored, _arrays_of({name: shapes}))
    sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    like = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), {name: shapes})
    args = ocp.args.PyTreeRestore(
        item=like, restore_args=ocp.checkpoint_utils.construct_restore_args(like), partial_restore=True
    )
    with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as checkpointer:
        found = checkpointer.restore(path / "state", args=args)
    return jax.tree.map(np.asarray, found[name])


def _read(path: pathlib.Path, item: str) -> dict[str, Any]:
    return read_json(path / item / "metadata", "part of a checkpoint", MAX_RECORD_BYTES)  # Orbax stores JSON there


def _arrays_of(state: Any) -> dict[str, str]:
    """Return the type and shape of each array of a state, by name."""
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): f"{leaf.dtype}{list(leaf.shape)}"
        for path, leaf in jax.tree.leaves_with_path(state)
    }


def _check_arrays(path: pathlib.Path, there: dict[str, str], here: dict[str, str]) -> None:
    if odd := [name for name in sorted(there.keys() | here.keys()) if there.get(name) != here.get(name)]:
        raise UserError(
            f"checkpoint {shown(path)} is of another model ({odd[0]} is {there.get(odd[0], 'not')} there, "
            f"{here.get(odd[0], 'not')} here); choose the config and version that wrote it, or another --workdir"
        )


def _damage(folder: pathlib.Path) -> str:
    """Describe in a few words which file of a checkpoint was changed, removed or added; return "" if none was."""
    try:
        stored, found = (folder / CHECKSUMS).read_text(errors="replace"), _checksums(folder)
    except OSError as error:
        return _reason(error)
    if stored == found:
        return ""
    names = {line.partition("  ")[2] for line in set(stored.splitlines()) ^ set(found.splitlines())}
    return f"{shown(min(names, default=CHECKSUMS))} is not what was saved"


def _checksums(folder: pathlib.Path) -> str:
    """Return the checksums of the files in subfolders, as `sha256sum` lists them."""
    files = sorted(
        (path.relative_to(folder).as_posix(), path)
        for path in folder.rglob("*")
        if path.is_file() and path.parent != folder
    )
    return "".join(f"{file_sha256(path)}  {name}\n" for name, path in files)


def _reason(error: Exception) -> str:
    """Return the cause of an error in a few words, without the paths and line numbers that TensorStore reports."""
    if match := re.search(r"os_error_code='(\d+)'", str(error)):
        return os.strerror(int(match[1]))
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split())[:200] or type(error).__name__


@functools.cache
def _hide_echoes() -> None:
    """Keep Orbax from printing the exceptions that it raises, and warnings while a process waits for it."""

    def is_news(record: logging.LogRecord) -> bool:
        is_echo = record.exc_info or record.levelno <= logging.WARNING
        return not (is_echo and "orbax" in record.pathname + record.getMessage())

    for name in ("absl", "asyncio"):
        logging.getLogger(name).addFilter(is_news)
    previous = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if str(unraisable.exc_value) != "Event loop is closed":  # raised when a write is interrupted
            previous(unraisable)

    sys.unraisablehook = hook

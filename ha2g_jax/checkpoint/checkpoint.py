"""Checkpoints of a run: the training state and a small record, in Orbax' format, whole or not there at all.

They are written while training goes on. Orbax fills a folder with a temporary name and renames it when all is in it, so
that a run killed half-way leaves nothing that counts as a checkpoint. The last file written holds the SHA-256 of the
others: what a disk, a copy or a network lost later is found before it is used (`sha256sum -c SHA256SUMS` finds it too).
"""

import contextlib
import json
import pathlib
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import tqdm
from jax.experimental import multihost_utils

from ha2g_jax.checkpoint import checksums, orbax_errors
from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.errors import UserError

_NONE, _ALL_DAMAGED = -1, -2  # in place of a step, when the first process tells the others
_REMOVALS = 10  # attempts


class Restored(NamedTuple):
    """What a checkpoint holds: `record` is plain values, such as the state of the input iterator."""

    step: int
    state: TrainState
    record: dict[str, Any]


class Checkpoints:
    """The checkpoints in one folder, each in a folder named after its step.

    Where there are several processes, all of them call `save`, `restore` and `restore_newest` at the same steps.
    Nothing is made or removed before the first `save`, so that a run's checkpoints can be read while it goes on.

    Args:
        folder: where they are; shared by all processes.
        keep: how many; older ones are removed once a newer one is whole.
    """

    def __init__(self, folder: pathlib.Path, keep: int = 1):
        self._folder = folder.absolute()
        self._keep = keep
        self._manager: ocp.CheckpointManager | None = None
        self._writing: int | None = None  # the step being written, or the last that was
        self._size = 0
        orbax_errors.hide_echoes()

    def steps(self) -> list[int]:
        """The steps that there are whole checkpoints of, in ascending order."""
        if not self._folder.is_dir():
            return []
        return sorted(int(path.name) for path in self._folder.iterdir() if path.name.isdecimal() and path.is_dir())

    def save(self, step: int, state: TrainState, record: dict[str, Any]) -> None:
        """Begins to write the checkpoint of a step; does nothing where there is a whole one.

        Returns as soon as `state` may be given up. Waits for the checkpoint that was begun before.

        Args:
            step: number of steps taken.
            state: everything that training carries along.
            record: plain values.

        Raises:
            UserError: this checkpoint or the one before cannot be written, because the disk is full for instance.
        """
        self.wait()
        if step in self.steps() and self._is_whole_or_set_aside(step):
            return
        args = ocp.args.Composite(
            # Orbax writes from views of the arrays' memory, which the next step overwrites.
            state=ocp.args.StandardSave(_copy(state)),
            arrays=ocp.args.JsonSave(_arrays(state)),
            record=ocp.args.JsonSave(json.loads(json.dumps(record))),
        )
        self._size = sum(leaf.nbytes for leaf in jax.tree.leaves(state))
        self._writing = step
        with self._blaming_the_disk():
            self._manager = self._manager or self._open()
            self._manager.save(step, args=args, force=True)  # without it Orbax skips some steps in silence

    def wait(self) -> None:
        """Returns when what was saved is on the disk.

        Raises:
            UserError: it could not be written.
        """
        if self._manager:
            with self._blaming_the_disk():
                self._manager.wait_until_finished()

    def check(self) -> None:
        """Like `wait`, but returns at once while something is being written; costs nothing.

        Raises:
            UserError: it could not be written.
        """
        if self._manager and not self._manager.is_saving_in_progress():
            self.wait()

    def close(self) -> None:
        """Waits, then frees what was held.

        Raises:
            UserError: the last checkpoint could not be written.
        """
        self.wait()
        if self._manager:
            self._manager.close()
            self._manager = None

    def restore(self, step: int, like: TrainState) -> tuple[TrainState, dict[str, Any]]:
        """The state and the record of a step.

        Args:
            step: one of `steps()`.
            like: arrays, or their shapes, types and shardings, in the places where the state's are to be. Their
                devices need not be those that the state was saved from.

        Raises:
            UserError: the checkpoint is damaged or of another model.
        """
        self._check(step)
        return self._read_state(step, like), self._read(step, "record")

    def restore_model(self, step: int, shapes: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read the variables of the generator to evaluate and to ship, and the record; the rest of the state is left.

        Args:
            step: one of `steps()`.
            shapes: {"params", "batch_stats"} of the generator as a tree of `jax.ShapeDtypeStruct`.

        Returns:
            The variables as numpy arrays, the running average where there is one, and the record.

        Raises:
            UserError: the checkpoint is damaged or of another model.
        """
        self._check(step)
        there = self._read(step, "arrays")
        name = "average" if any(key.startswith("average/") for key in there) else "generator"
        wanted = {name: shapes}
        here = _arrays(wanted)
        stored = {
            key: value for key, value in there.items() if key.startswith((f"{name}/params/", f"{name}/batch_stats/"))
        }
        path = self._folder / str(step)
        _check_arrays(path, stored, here)
        like = on_one_device(wanted)
        args = ocp.args.PyTreeRestore(
            item=like, restore_args=ocp.checkpoint_utils.construct_restore_args(like), partial_restore=True
        )
        with (
            _blaming_the_version(path),
            contextlib.closing(ocp.Checkpointer(ocp.PyTreeCheckpointHandler())) as checkpointer,
        ):
            found = checkpointer.restore(path / "state", args=args)
        return jax.tree.map(np.asarray, found[name]), self._read(step, "record")

    def restore_newest(self, like: TrainState) -> Restored | None:
        """The newest checkpoint that is whole, None where there is none at all.

        Damaged ones that are newer are named on stderr and renamed to STEP.damaged, so that the run can write them
        again and nothing is lost that a person may want to look at.

        Args:
            like: see `restore`.

        Raises:
            UserError: there are checkpoints, but all of them are damaged, or the newest whole one is of another model.
        """
        self.wait()
        step = self._agree(self._look)
        if step == _ALL_DAMAGED:
            reasons = ", ".join(f"{step}: {_damage(self._folder / str(step))}" for step in self.steps())
            raise UserError(
                f"all checkpoints in {self._folder} are damaged ({reasons}); put back a good copy, or choose another "
                "--workdir"
            )
        return None if step == _NONE else Restored(step, self._read_state(step, like), self._read(step, "record"))

    def record(self, step: int) -> dict[str, Any]:
        """The record of a step alone.

        Raises:
            UserError: the checkpoint is damaged.
        """
        self._check(step)
        return self._read(step, "record")

    def _read_state(self, step: int, like: TrainState) -> TrainState:
        path = self._folder / str(step)
        _check_arrays(path, self._read(step, "arrays"), _arrays(like))
        with (
            _blaming_the_version(path),
            contextlib.closing(ocp.Checkpointer(ocp.StandardCheckpointHandler())) as checkpointer,
        ):
            return checkpointer.restore(path / "state", args=ocp.args.StandardRestore(like))

    def _read(self, step: int, item: str) -> dict[str, Any]:
        return json.loads((self._folder / str(step) / item / "metadata").read_text())  # where Orbax puts JSON

    def _open(self) -> ocp.CheckpointManager:
        options = ocp.CheckpointManagerOptions(
            max_to_keep=self._keep,
            cleanup_tmp_directories=True,
            lightweight_initialize=True,  # it would stumble over damaged ones
            async_options=ocp.AsyncOptions(post_finalization_callback=self._write_checksums),
            multiprocessing_options=ocp.options.MultiprocessingOptions(
                barrier_sync_key_prefix=self._folder.name  # latest and best may be written at the same time
            ),
        )
        return ocp.CheckpointManager(self._folder, options=options)

    def _write_checksums(self) -> None:
        (folder,) = self._temporary()
        checksums.write(folder)

    def _temporary(self) -> list[pathlib.Path]:
        """Folders of the step at hand that are not whole yet."""
        return list(self._folder.glob(f"{self._writing}{ocp.utils.TMP_DIR_SUFFIX}*"))

    def _remove_temporary(self) -> None:
        # Other threads of Orbax may not know yet that it is over, and make the folder again. What one of them makes
        # even later, the next start removes.
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
                f"{self._folder.name}/{self.steps()[-1]} is whole"
                if self.steps()
                else f"{self._folder.name} has none before it"
            )
            free = shutil.disk_usage(self._folder).free if self._folder.is_dir() else 0
            raise UserError(
                f"cannot write checkpoint {self._folder / str(self._writing)} ({orbax_errors.reason(error)}; it takes "
                f"{self._size / 1e6:.1f} MB, {free / 1e6:.1f} MB are free); {left}: free some space, and the same "
                "command continues"
            ) from error

    def _look(self) -> int:
        """The newest step that is whole; damaged ones that are newer are set aside."""
        damaged: dict[int, str] = {}
        for step in reversed(self.steps()):
            if reason := _damage(self._folder / str(step)):
                damaged[step] = reason
                continue
            for number, reason in damaged.items():
                self._set_aside(number, reason, f"using {self._folder / str(step)}")
            return step
        return _ALL_DAMAGED if damaged else _NONE

    def _is_whole_or_set_aside(self, step: int) -> bool:
        def look() -> int:
            if reason := _damage(self._folder / str(step)):
                self._set_aside(step, reason, "writing it anew")
            return not reason

        return bool(self._agree(look))

    def _agree(self, look: Callable[[], int]) -> int:
        """What `look` gives on the first process; the others may see a shared disk as it was, and go by that."""
        answer = look() if jax.process_index() == 0 else 0
        if jax.process_count() > 1:
            answer = int(multihost_utils.broadcast_one_to_all(np.int32(answer)))
        if self._manager:
            self._manager.reload()  # it remembers what was there
        return answer

    def _set_aside(self, step: int, reason: str, consequence: str) -> None:
        path = self._folder / str(step)
        name, number = f"{step}.damaged", 1
        while path.with_name(name).exists():
            number += 1
            name = f"{step}.damaged-{number}"
        path.rename(path.with_name(name))
        tqdm.tqdm.write(f"checkpoint {path} is damaged ({reason}) and now named {name}; {consequence}", file=sys.stderr)

    def _check(self, step: int) -> None:
        path = self._folder / str(step)
        if reason := _damage(path):
            others = [path.with_name(str(other)) for other in self.steps() if other != step]
            advice = f"use {others[-1]}" if others else "put back a good copy"
            raise UserError(f"checkpoint {path} is damaged ({reason}); {advice}")


@contextlib.contextmanager
def _blaming_the_version(path: pathlib.Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # Orbax raises that very class, among many
        raise UserError(
            f"checkpoint {path} cannot be read though it is whole ({orbax_errors.reason(error)}); install the "
            "version of Orbax that wrote it"
        ) from error


def _check_arrays(path: pathlib.Path, there: dict[str, str], here: dict[str, str]) -> None:
    if odd := [name for name in sorted(there.keys() | here.keys()) if there.get(name) != here.get(name)]:
        raise UserError(
            f"checkpoint {path} is of another model ({odd[0]} is {there.get(odd[0], 'not')} there, "
            f"{here.get(odd[0], 'not')} here); choose the config and version that wrote it, or another --workdir"
        )


def on_one_device(state: Any) -> Any:
    """The shapes of a state as `Checkpoints.restore` takes them, placed on the first device."""
    sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), state)


@jax.jit
def _copy(state: TrainState) -> TrainState:
    return jax.tree.map(jnp.copy, state)


def _arrays(state: Any) -> dict[str, str]:
    """The type and shape of each array, by its name."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): f"{leaf.dtype}{list(leaf.shape)}"
        for path, leaf in leaves
    }


def _damage(folder: pathlib.Path) -> str:
    """What is wrong with a checkpoint in a few words, "" where nothing is."""
    try:
        return checksums.damage(folder)
    except OSError as error:
        return orbax_errors.reason(error)

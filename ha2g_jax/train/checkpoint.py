"""Checkpoints of a run: the training state and a small record, in Orbax' format, whole or not there at all."""

import pathlib
from typing import Any

import jax
import orbax.checkpoint as ocp

from ha2g_jax.errors import UserError
from ha2g_jax.train.state import TrainState


class Checkpoints:
    """The checkpoints in one folder, each in a folder named after its step.

    Args:
        folder: made if it does not exist.
        keep: how many; older ones are removed.
    """

    def __init__(self, folder: pathlib.Path, keep: int = 1):
        self._folder = folder.absolute()
        # The next step gives the state's memory up, so it is written before that.
        options = ocp.CheckpointManagerOptions(max_to_keep=keep, enable_async_checkpointing=False)
        self._manager = ocp.CheckpointManager(self._folder, options=options)

    def steps(self) -> list[int]:
        """The steps that there are checkpoints of, in ascending order."""
        return sorted(self._manager.all_steps())

    def save(self, step: int, state: TrainState, record: dict[str, Any]) -> None:
        """Writes the checkpoint of a step; does nothing where there is one.

        Args:
            step: number of steps taken.
            state: everything that training carries along.
            record: plain values, such as the state of the input iterator.
        """
        if step not in self.steps():
            args = ocp.args.Composite(state=ocp.args.StandardSave(state), record=ocp.args.JsonSave(record))
            self._manager.save(step, args=args, force=True)  # without it Orbax skips some steps in silence

    def restore(self, step: int, like: TrainState) -> tuple[TrainState, dict[str, Any]]:
        """The state and the record of a step.

        Args:
            step: one of `steps()`.
            like: arrays, or their shapes, types and shardings, in the places where the state's are to be.

        Raises:
            UserError: the checkpoint is damaged or of another model.
        """
        args = ocp.args.Composite(state=ocp.args.StandardRestore(like), record=ocp.args.JsonRestore())
        try:
            found = self._manager.restore(step, args=args)
        except (ValueError, KeyError, TypeError, OSError, RuntimeError) as error:
            raise _damaged(self._folder / str(step), error) from error
        return found["state"], found["record"]

    def record(self, step: int) -> dict[str, Any]:
        """The record of a step alone."""
        args = ocp.args.Composite(record=ocp.args.JsonRestore())
        try:
            return self._manager.restore(step, args=args)["record"]
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise _damaged(self._folder / str(step), error) from error

    def close(self) -> None:
        self._manager.close()


def on_one_device(state: Any) -> Any:
    """The shapes of a state as `Checkpoints.restore` takes them, placed on the first device."""
    sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), state)


def _damaged(path: pathlib.Path, error: Exception) -> UserError:
    reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else type(error).__name__
    return UserError(f"checkpoint {path} is damaged or of another model ({reason}); remove it to use the one before")

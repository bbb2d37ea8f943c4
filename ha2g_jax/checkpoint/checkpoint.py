"""One checkpoint as Orbax stores it: the training state, the types and shapes of its arrays, and a record."""

import contextlib
import pathlib
import reprlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from ha2g_jax.checkpoint import checksums, orbax_errors
from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_json, shown
from ha2g_jax.limits import MAX_RECORD_BYTES


def read_state(path: pathlib.Path, like: TrainState) -> TrainState:
    """Read the training state.

    Args:
        path: folder of the checkpoint.
        like: tree of arrays, or of shapes with types and shardings, that the state is to have.

    Raises:
        UserError: the checkpoint is of another model.
    """
    _check_arrays(path, _read(path, "arrays"), arrays_of(like))
    with (
        _blaming_the_version(path),
        contextlib.closing(ocp.Checkpointer(ocp.StandardCheckpointHandler())) as checkpointer,
    ):
        return checkpointer.restore(path / "state", args=ocp.args.StandardRestore(like))


def read_variables(path: pathlib.Path, shapes: Any) -> dict[str, Any]:
    """Read the variables of the generator without the rest of the state.

    Args:
        path: folder of the checkpoint.
        shapes: {"params", "batch_stats"} of the generator as a tree of `jax.ShapeDtypeStruct`.

    Returns:
        The variables as numpy arrays, those of the running average if there is one.

    Raises:
        UserError: the checkpoint is of another model.
    """
    there = _read(path, "arrays")
    name = "average" if any(key.startswith("average/") for key in there) else "generator"
    wanted = {name: shapes}
    stored = {key: value for key, value in there.items() if key.startswith((f"{name}/params/", f"{name}/batch_stats/"))}
    _check_arrays(path, stored, arrays_of(wanted))
    like = on_one_device(wanted)
    args = ocp.args.PyTreeRestore(
        item=like, restore_args=ocp.checkpoint_utils.construct_restore_args(like), partial_restore=True
    )
    with (
        _blaming_the_version(path),
        contextlib.closing(ocp.Checkpointer(ocp.PyTreeCheckpointHandler())) as checkpointer,
    ):
        found = checkpointer.restore(path / "state", args=args)
    return jax.tree.map(np.asarray, found[name])


def read_record(path: pathlib.Path) -> dict[str, Any]:
    """Read the record, such as the sums of the log.

    Args:
        path: folder of the checkpoint.

    Raises:
        UserError: there is no record, or it is damaged.
    """
    return _read(path, "record")


def damage(path: pathlib.Path) -> str:
    """Describe the damage of a checkpoint in a few words; return "" if there is none.

    Args:
        path: folder of the checkpoint.
    """
    try:
        return checksums.damage(path)
    except OSError as error:
        return orbax_errors.reason(error)


def on_one_device(state: Any) -> Any:
    """Return the shapes of a state on the first device of this process, as `Checkpoints.restore` takes them.

    Args:
        state: tree of arrays or shapes.
    """
    sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), state)


def arrays_of(state: Any) -> dict[str, str]:
    """Return the type and shape of each array of a state, by name.

    Args:
        state: tree of arrays or shapes.
    """
    leaves = jax.tree_util.tree_leaves_with_path(state)
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): f"{leaf.dtype}{list(leaf.shape)}"
        for path, leaf in leaves
    }


def _read(path: pathlib.Path, item: str) -> dict[str, Any]:
    path = path / item / "metadata"  # Orbax stores JSON there
    values = read_json(path, "part of a checkpoint", MAX_RECORD_BYTES)
    if not isinstance(values, dict):
        raise UserError(f"{shown(path)} is not part of a checkpoint (not an object of JSON)")
    return values


@contextlib.contextmanager
def _blaming_the_version(path: pathlib.Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # Orbax raises many classes, this one among them
        raise UserError(
            f"checkpoint {shown(path)} is undamaged but cannot be read ({orbax_errors.reason(error)}); install the "
            "version of Orbax that wrote it"
        ) from error


def _check_arrays(path: pathlib.Path, there: dict[str, str], here: dict[str, str]) -> None:
    if odd := [name for name in sorted(there.keys() | here.keys()) if there.get(name) != here.get(name)]:
        raise UserError(
            f"checkpoint {shown(path)} is of another model ({_short(odd[0])} is "
            f"{_short(there.get(odd[0], 'not'))} there, {here.get(odd[0], 'not')} here); choose the config and "
            "version that wrote it, or another --workdir"
        )


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 200 and text.isprintable() else reprlib.repr(text)

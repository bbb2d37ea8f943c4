"""One checkpoint on disk: the state, the types of its arrays and a record as Orbax stores them, and their checksums.

SHA256SUMS has the sums of all files in subfolders, not of Orbax's notes in the folder itself; `sha256sum -c` reads it.
"""

import contextlib
import functools
import logging
import os
import pathlib
import re
import sys
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, read_json, shown
from ha2g_jax.limits import MAX_RECORD_BYTES

CHECKSUMS = "SHA256SUMS"


def read_state(path: pathlib.Path, like: TrainState) -> TrainState:
    """Read the training state as a tree like that of arrays, or of shapes with types and shardings.

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
    """Read the variables of the generator, see `Checkpoints.restore_model`, without the rest of the state.

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
    """Read the record, such as the sums of the log."""
    return _read(path, "record")


def on_one_device(state: Any) -> Any:
    """Return the shapes of a state on the first device of this process, as `read_state` takes them."""
    sharding = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), state)


def arrays_of(state: Any) -> dict[str, str]:
    """Return the type and shape of each array of a state, by name."""
    leaves = jax.tree_util.tree_leaves_with_path(state)
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): f"{leaf.dtype}{list(leaf.shape)}"
        for path, leaf in leaves
    }


def _read(path: pathlib.Path, item: str) -> dict[str, Any]:
    return read_json(path / item / "metadata", "part of a checkpoint", MAX_RECORD_BYTES)  # Orbax stores JSON there


@contextlib.contextmanager
def _blaming_the_version(path: pathlib.Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # Orbax raises many classes, this one among them
        raise UserError(
            f"checkpoint {shown(path)} is undamaged but cannot be read ({reason(error)}); install the "
            "version of Orbax that wrote it"
        ) from error


def _check_arrays(path: pathlib.Path, there: dict[str, str], here: dict[str, str]) -> None:
    if odd := [name for name in sorted(there.keys() | here.keys()) if there.get(name) != here.get(name)]:
        raise UserError(
            f"checkpoint {shown(path)} is of another model ({odd[0]} is {there.get(odd[0], 'not')} there, "
            f"{here.get(odd[0], 'not')} here); choose the config and version that wrote it, or another --workdir"
        )


def write_checksums(folder: pathlib.Path) -> None:
    """Write SHA256SUMS into the folder of a checkpoint."""
    (folder / CHECKSUMS).write_text(_listing({name: file_sha256(path) for name, path in _files(folder).items()}))


def damage(folder: pathlib.Path) -> str:
    """Describe in a few words which file of a checkpoint was changed, removed or added; return "" if none was."""
    if not folder.is_dir():
        return "there is no such folder"
    if not (folder / CHECKSUMS).is_file():
        return f"{CHECKSUMS} is missing"
    try:
        text = (folder / CHECKSUMS).read_text(errors="replace")
        expected = {name: digest for digest, _, name in (line.partition("  ") for line in text.splitlines())}
        files = _files(folder)
        for name in sorted(expected.keys() | files.keys()):
            if name not in files:
                return f"{shown(name)} is missing"
            if name not in expected:
                return f"{shown(name)} does not belong"
            if file_sha256(files[name]) != expected[name]:
                return f"{shown(name)} is not what was saved"
    except OSError as error:
        return reason(error)
    return "" if text == _listing(expected) else f"{CHECKSUMS} is not what was saved"


def _files(folder: pathlib.Path) -> dict[str, pathlib.Path]:
    """Return the files in subfolders by their path below the folder."""
    return {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob("*")
        if path.is_file() and path.parent != folder
    }


def _listing(digests: dict[str, str]) -> str:
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))


def reason(error: Exception) -> str:
    """Return the cause of an error in a few words, which TensorStore reports among paths and line numbers."""
    if match := re.search(r"os_error_code='(\d+)'", str(error)):
        return os.strerror(int(match[1]))
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split())[:200] or type(error).__name__


@functools.cache
def hide_echoes() -> None:
    """Keep Orbax from printing the exceptions that it raises, and its warnings that it is being waited for."""

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

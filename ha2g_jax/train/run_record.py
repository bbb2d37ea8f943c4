"""The record of a run, `run.json`: the config, and for every start the code, the machine and the data."""

import contextlib
import datetime
import importlib.metadata
import json
import os
import pathlib
import platform
import secrets
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import jax

from ha2g_jax.checkpoint import RUN
from ha2g_jax.checkpoint.model_folder import config_to_json
from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import FILE, Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, read_json, reason, resolved, shown
from ha2g_jax.files.writing import write_text
from ha2g_jax.layers.cpu.onednn.library import used_version
from ha2g_jax.limits import MAX_RECORD_BYTES
from ha2g_jax.train.workdir import CONTINUE

# Packages whose version can change a result, and packages that write the files of a run.
_PACKAGES = ("ha2g-jax", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "grain", "array-record")
_PACKAGES += ("ml-collections", "numpy", "scipy", "librosa", "soxr", "soundfile", "av", "pillow", "safetensors")

_MEMORY = pathlib.Path("/proc/meminfo")
_CONTAINER = pathlib.Path("/sys/fs/cgroup")
_SOURCE = pathlib.Path(__file__).resolve().parent.parent
_GIT_PATIENCE = 5.0  # seconds
_CODE = ("--", ".", ":(top)*.py")  # the package, and scripts; a study adds to its kept runs while it runs


def write(workdir: pathlib.Path, config: Config, step: int, corpus: Corpus) -> None:
    """Add one start, at a step, to the `run.json` of a workdir and keep the earlier ones; only the first host does.

    Raises:
        UserError: the file cannot be written.
    """
    record = _read(workdir)
    onednn = used_version()
    start = {
        "time": _now(),
        "step": step,
        "command": sys.argv,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": installed(_PACKAGES) | ({"onednn": onednn} if onednn else {}),
        "commit": commit(_SOURCE),
        "seeds": {"run": config.seed},
        "hardware": _hardware(),
        # dataset.json contains the hashes of all shards.
        "corpus": {"path": str(resolved(corpus.path)), "sha256": file_sha256(corpus.path / FILE)},
    }
    _write(workdir, record | {"config": config_to_json(config), "starts": [*record["starts"], start]})


def corpus_of(workdir: pathlib.Path) -> str | None:
    """Return the SHA-256 of the description of the corpus of the last start, None if none is recorded."""
    last = (_read(workdir)["starts"] or [{}])[-1]
    return last.get("corpus", {}).get("sha256")


@contextlib.contextmanager
def noting_failure(workdir: pathlib.Path) -> Iterator[None]:
    """Store the reason in the last start of `run.json` if this context ends with an error; only the first host does.

    A run that a signal stops, or that is killed, stores none.
    """
    try:
        yield
    except Exception as error:
        with contextlib.suppress(UserError):  # the disk may be full, which the error itself says
            record = _read(workdir)
            *earlier, last = record["starts"] or [{}]
            kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
            failure = {"time": _now(), "reason": f"{kind}{reason(error)}"}
            _write(workdir, record | {"starts": [*earlier, {**last, "failure": failure}]})
        raise


def wandb_id(workdir: pathlib.Path) -> str:
    """Return the id of the Weights & Biases run of a workdir, drawn at the first start and stored in `run.json`."""
    record = _read(workdir)
    if not record.get("wandb_id"):
        record["wandb_id"] = secrets.token_hex(6)
        _write(workdir, record)
    return record["wandb_id"]


def commit(package: pathlib.Path) -> str | None:
    """Return the git commit of the source tree of the folder of a package, with "-dirty" appended if the package or a
    script beside it differs.

    The result is None if the package is installed rather than checked out, even inside a repository.
    """
    git = ["git", "-C", str(package)]
    top = _output([*git, "rev-parse", "--show-toplevel"])
    if top is None or pathlib.Path(top).resolve() != package.resolve().parent:
        return None
    head, changed = (_output([*git, *ask]) for ask in (["rev-parse", "HEAD"], ["diff", "--name-only", "HEAD", *_CODE]))
    return None if head is None or changed is None else head + "-dirty" * bool(changed)


def _read(workdir: pathlib.Path) -> dict[str, Any]:
    path, record = workdir / RUN, None
    with contextlib.suppress(UserError):  # damaged
        record = read_json(path, "the record of a run", MAX_RECORD_BYTES) if path.exists() else {"starts": []}
    if not isinstance(record, dict) or not isinstance(record.get("starts"), list):
        raise UserError(f"{shown(path)} is not the record of a run; remove it, then the same command continues")
    return record


def _write(workdir: pathlib.Path, record: dict[str, Any]) -> None:
    write_text(workdir / RUN, json.dumps(record, indent=1) + "\n", CONTINUE)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def installed(packages: Sequence[str]) -> dict[str, str]:
    """Return the versions of those packages that are installed, by name."""
    versions = {}
    for name in packages:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def host_memory() -> tuple[int | None, int | None]:
    """Return the total and the available memory in bytes, within the limit of a container; None if unknown."""
    total, available = None, None
    if _MEMORY.exists():
        lines = (line.split() for line in _MEMORY.read_text().splitlines())
        sizes = {line[0]: int(line[1]) * 1024 for line in lines}
        total, available = sizes["MemTotal:"], sizes["MemAvailable:"]
    elif {"SC_PAGE_SIZE", "SC_PHYS_PAGES"} <= getattr(os, "sysconf_names", {}).keys():
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    files = [_CONTAINER / f"memory.{name}" for name in ("max", "current", "stat")]
    if total and available and all(map(pathlib.Path.exists, files)):
        size, used, parts = (file.read_text().strip() for file in files)
        if size != "max":
            # The page cache counts as used, but is dropped when the memory is needed.
            cached = next(int(line.split()[1]) for line in parts.splitlines() if line.startswith("inactive_file "))
            total, available = min(total, int(size)), min(available, int(size) - int(used) + cached)
    return total, available


def _hardware() -> dict[str, Any]:
    """Return the devices of all hosts by kind, the number of processes, and the cores and memory (GiB) of this host."""
    memory, _ = host_memory()
    return {
        "devices": dict(Counter(device.device_kind for device in jax.devices())),
        "processes": jax.process_count(),
        "cpus": os.cpu_count(),
        "memory_gib": memory and round(memory / 2**30, 1),
    }


def _output(command: list[str]) -> str | None:
    """Return the output of a command, None if it fails, is not installed or takes too long."""
    environment = os.environ | {"GIT_OPTIONAL_LOCKS": "0"}  # git must not write to the repository
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_GIT_PATIENCE, env=environment, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None

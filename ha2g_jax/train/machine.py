"""Examine the machine of a run: packages, devices, cores and memory."""

import collections
import contextlib
import importlib.metadata
import os
import pathlib
import platform
from typing import Any, NamedTuple

import jax

from ha2g_jax.layers.cpu.onednn.library import used_version

_PACKAGES = ("ha2g-jax", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "grain", "numpy")
_CUDA_PLUGINS = ("jax-cuda12-plugin", "jax-cuda13-plugin")
# Files by which JAX itself detects a GPU: those of a driver, of a container and of WSL.
_GPU_FILES = ("/dev/nvidia0", "/dev/nvidiactl", "/dev/dxg")

_MEMORY = pathlib.Path("/proc/meminfo")
_CONTAINER = pathlib.Path("/sys/fs/cgroup")


class Finding(NamedTuple):
    """Result of one check.

    Attributes:
        name: name of the check.
        found: description of what was found, in a few words.
        trouble: what is wrong and what to do; "" if nothing is wrong.
        values: names and numbers behind `found`.
    """

    name: str
    found: str
    trouble: str = ""
    values: dict[str, Any] | None = None


def examine_machine() -> list[Finding]:
    """Check Python and packages, devices, cores and memory."""
    return [_python(), _packages(), _devices(), _host()]


def host_memory() -> tuple[int | None, int | None]:
    """Return the total and the available memory in bytes, within the limit of a container; None if unknown."""
    total, available = None, None
    if _MEMORY.exists():
        lines = (line.split() for line in _MEMORY.read_text().splitlines())
        sizes = {line[0]: int(line[1]) * 1024 for line in lines}
        total, available = sizes["MemTotal:"], sizes["MemAvailable:"]
    elif {"SC_PAGE_SIZE", "SC_PHYS_PAGES"} <= getattr(os, "sysconf_names", {}).keys():
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limit, used = _CONTAINER / "memory.max", _CONTAINER / "memory.current"
    if total and available and limit.exists() and used.exists() and (size := limit.read_text().strip()) != "max":
        total, available = min(total, int(size)), min(available, int(size) - int(used.read_text()))
    return total, available


def gib(size: int) -> str:
    """Format a number of bytes, such as "1.5 GiB"."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 / 10 else f"{size / 2**20:.1f} MiB"


def _python() -> Finding:
    values = {"python": platform.python_version(), "platform": platform.platform()}
    return Finding("python", f"{values['python']} on {values['platform']}", values=values)


def _packages() -> Finding:
    versions = {name: _version(name) for name in _PACKAGES}
    missing = " ".join(name for name, version in versions.items() if version is None)
    with contextlib.suppress(RuntimeError):  # JAX finds no device, which `_devices` reports
        if onednn := used_version():
            versions["onednn"] = onednn
    found = ", ".join(f"{name} {version}" for name, version in versions.items() if version is not None)
    return Finding("packages", found, f"pip install {missing}" if missing else "", versions)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _devices() -> Finding:
    try:
        devices = jax.devices()
    except RuntimeError as error:  # JAX_PLATFORMS names a platform that is not available
        return Finding("devices", "", f"JAX finds none ({str(error).splitlines()[0]}): unset JAX_PLATFORMS")
    kinds = collections.Counter(device.device_kind for device in devices)
    memory = {device.device_kind: (device.memory_stats() or {}).get("bytes_limit") for device in jax.local_devices()}
    found = [
        f"{count} x {kind}" + (f" with {gib(size)} each for JAX" if (size := memory.get(kind)) else "")
        for kind, count in kinds.items()
    ]
    values = {"devices": dict(kinds), "device_memory": memory, "backend": jax.default_backend()}
    return Finding("devices", ", ".join(found), _idle_gpu(), values)


def _idle_gpu() -> str:
    """Return why JAX does not use the GPU of this machine, "" if it does or if there is none."""
    if jax.default_backend() != "cpu" or not any(map(os.path.exists, _GPU_FILES)):
        return ""
    if platforms := os.environ.get("JAX_PLATFORMS"):
        return f"there is an NVIDIA GPU, but JAX_PLATFORMS={platforms} keeps JAX from using it: unset JAX_PLATFORMS"
    if plugins := [name for name in _CUDA_PLUGINS if _version(name)]:
        return (
            f"there is an NVIDIA GPU, but {plugins[0]} does not start: "
            "JAX_PLATFORMS=cuda python -c 'import jax; jax.devices()' shows why"
        )
    return (
        "there is an NVIDIA GPU, but JAX computes on the CPU: pip install -U 'jax[cuda13]', "
        "or 'jax[cuda12]' where the driver is older than 580"
    )


def _host() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    total, available = host_memory()
    found = f"{cores} cores" + (f", {gib(total)} of memory" if total else "")
    found += f", {gib(available)} available" if available is not None else ""
    return Finding("machine", found, values={"cores": cores, "memory": total, "memory_available": available})

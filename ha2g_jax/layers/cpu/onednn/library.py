"""The library of calls to oneDNN: compiled once on each machine, and registered with JAX."""

import contextlib
import contextvars
import ctypes
import functools
import hashlib
import importlib.metadata
import os
import pathlib
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import jaxlib.version

from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import cache_folder, one_maker
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.layers.cpu.memory import has_accelerator_plugin

_TARGETS = ("Ha2gConv", "Ha2gConvInputGradient", "Ha2gConvKernelGradient", "Ha2gGruStates", "Ha2gGruSums")
_FOLDER = pathlib.Path(__file__).parent
_SOURCES = ("conv.cc", "gru.cc", "parallel.h")
# GCC vectorises a comparison of floats only if it need not raise floating-point exceptions, which nothing here reads.
_FLAGS = ("-std=c++17", "-O3", "-march=native", "-fno-trapping-math", "-fopenmp", "-fPIC", "-shared", "-w")
_CONFIG, _LIBRARY = "oneapi/dnnl/dnnl_config.h", "libdnnl.so.3"
# Packages of pip -> one file of each, by which the others are found.
_PACKAGES = {"onednn-devel-cpu-gomp": _CONFIG, "onednn-cpu-gomp": _LIBRARY}
_OPENMP = re.compile(r"#define DNNL_CPU_THREADING_RUNTIME DNNL_RUNTIME_OMP$", re.MULTILINE)
_VERSION = re.compile(r"DNNL_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)")
_CPU = pathlib.Path("/proc/cpuinfo")

_is_chosen = contextvars.ContextVar("onednn", default=False)


@functools.cache
def is_available() -> bool:
    """Return whether this process can use oneDNN: installed, not disabled, and a single CPU device.

    HA2G_ONEDNN=0 in the environment disables it. The first call on a machine compiles the C++ of this folder, which
    takes about ten seconds, and keeps the result in the cache folder. If the library cannot be compiled or loaded, a
    line on stderr says so.
    """
    if os.environ.get("HA2G_ONEDNN") == "0" or has_accelerator_plugin() or not is_installed():
        return False
    if jax.default_backend() != "cpu" or jax.device_count() > 1:
        return False
    try:
        register()
    except UserError as error:
        sys.stderr.write(f"ha2g: without oneDNN: {error}; HA2G_ONEDNN=0 hides this line\n")
        return False
    return True


@contextlib.contextmanager
def choosing(is_chosen: bool) -> Iterator[None]:
    """Let functions traced in this context use oneDNN, or else XLA.

    Enter it inside the function that `jax.jit` traces, because the choice is not part of the key of its cache.
    """
    token = _is_chosen.set(is_chosen)
    try:
        yield
    finally:
        _is_chosen.reset(token)


def is_used_for(*arrays: jax.Array) -> bool:
    """Return whether oneDNN is chosen in this context and all arrays are float32, the only type that it is used for."""
    return _is_chosen.get() and all(array.dtype == jnp.float32 for array in arrays)


def used_version() -> str | None:
    """Return the version of oneDNN that this process trains with, such as "3.2.0"; None if it does not use oneDNN."""
    return ".".join(_VERSION.findall(_version_header())) if is_available() else None


def is_installed() -> bool:
    """Return whether oneDNN 3, built for OpenMP, and its headers are in this environment."""
    include, library = _places()
    config = include / _CONFIG
    return library.exists() and config.exists() and _OPENMP.search(config.read_text()) is not None


def register() -> None:
    """Register the calls with JAX, and compile them if this machine has not done so yet.

    Raises:
        UserError: there is no C++ compiler or it fails, the cache folder cannot be written, or the library cannot be
            loaded.
    """
    try:
        path = cache_folder() / "onednn" / f"{_fingerprint()}.so"
        if not path.exists():
            with one_maker(path):
                if not path.exists():  # another process may have made it
                    _compile(path)
        library = _load(path)
        for name in _TARGETS:
            jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(library, name)), platform="cpu")
    except (OSError, AttributeError, NotImplementedError) as error:  # also a file system without locks
        why = reason(error).lower() if isinstance(error, OSError) and error.strerror else str(error)
        raise UserError(f"the library of its calls cannot be made or loaded ({why})") from error


@functools.cache
def _places() -> tuple[pathlib.Path, pathlib.Path]:
    """Return the folder of the headers of oneDNN and its library, which may not exist."""
    found = {}
    for package, name in _PACKAGES.items():
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            for file in importlib.metadata.files(package) or ():
                if str(file).endswith(name):
                    found[name] = pathlib.Path(os.path.normpath(str(file.locate())))
    prefix = pathlib.Path(sys.prefix)  # where conda installs it
    config = found.get(_CONFIG, prefix / "include" / _CONFIG)
    return config.parents[2], found.get(_LIBRARY, prefix / "lib" / _LIBRARY)


def _load(path: pathlib.Path) -> ctypes.CDLL:
    cores = os.sched_getaffinity(0)
    try:
        return ctypes.CDLL(str(path))
    finally:
        os.sched_setaffinity(0, cores)  # with OMP_PROC_BIND, OpenMP has limited this thread to one core


def _compile(path: pathlib.Path) -> None:
    compiler, (include, onednn) = _compiler(), _places()
    if shutil.which(compiler[0]) is None:
        raise UserError(f"there is no C++ compiler {compiler[0]}; install g++, or name another one with CXX")
    sys.stderr.write("ha2g: compiling the calls of oneDNN, once on this machine\n")
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = pathlib.Path(folder) / path.name
        sources = [str(_FOLDER / name) for name in _SOURCES if name.endswith(".cc")]
        libraries = [str(onednn), f"-Wl,-rpath,{onednn.parent}"]
        command = [*compiler, *_FLAGS, f"-I{include}", f"-I{jax.ffi.include_dir()}", *sources, *libraries]
        result = subprocess.run([*command, "-o", str(made)], capture_output=True, text=True, errors="replace")
        if result.returncode:
            lines = result.stderr.strip().splitlines() or [f"exit code {result.returncode}"]
            first = next((line for line in lines if "error" in line), lines[0])
            raise UserError(f"{shown(compiler[0])} does not compile its calls ({first})")
        made.replace(path)


def _compiler() -> list[str]:
    try:
        return shlex.split(os.environ.get("CXX", "")) or ["c++"]
    except ValueError as error:
        raise UserError(f"CXX is not a command ({error})") from error


def _fingerprint() -> str:
    """Return a hash of what a compiled library depends on: sources, flags, versions, compiler and processor."""
    parts = [(_FOLDER / name).read_text() for name in _SOURCES]
    parts += [_version_header(), jaxlib.version.__version__, *map(str, _places()), *_compiler(), *_FLAGS]
    # Home directories are shared between machines, while -march=native compiles for one processor.
    lines = _CPU.read_text().splitlines() if _CPU.exists() else []
    parts += [platform.machine(), *sorted({line for line in lines if line.startswith(("flags", "Features"))})]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _version_header() -> str:
    return (_places()[0] / "oneapi" / "dnnl" / "dnnl_version.h").read_text()

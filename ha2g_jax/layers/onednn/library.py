"""The library of calls of oneDNN: compiled once on the machine at hand, and registered with JAX."""

import ctypes
import hashlib
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
import tempfile

import jax
import jax.numpy as jnp
import jaxlib.version

from ha2g_jax.errors import UserError
from ha2g_jax.files.cache_folder import cache_folder, one_maker
from ha2g_jax.files.reading import shown

_TARGETS = ("Ha2gConv", "Ha2gConvInputGradient", "Ha2gConvKernelGradient", "Ha2gGruStates", "Ha2gGruSums")
_FOLDER = pathlib.Path(__file__).parent
_SOURCES = ("conv.cc", "gru.cc", "parallel.h")
# Where pip and conda put oneDNN.
_HEADERS = pathlib.Path(sys.prefix) / "include"
_ONEDNN = pathlib.Path(sys.prefix) / "lib" / "libdnnl.so.3"
_OPENMP = re.compile(r"#define DNNL_CPU_THREADING_RUNTIME DNNL_RUNTIME_OMP$", re.MULTILINE)
_CPU = pathlib.Path("/proc/cpuinfo")

_is_used = False


def use_onednn() -> None:
    """Let this process compute convolutions and GRUs with oneDNN from now on, if it is installed.

    Call this before the first computation. The first call on a machine compiles the C++ of this folder, which takes
    about ten seconds, and keeps the result in the cache folder. Nothing changes if HA2G_ONEDNN is 0 or oneDNN is not
    installed. If the compilation fails, a line on the standard error says so, and the programs of XLA stay.
    """
    global _is_used
    if os.environ.get("HA2G_ONEDNN") == "0" or not is_installed():
        return
    try:
        register()
    except UserError as error:
        sys.stderr.write(f"ha2g: without oneDNN: {error}\n")
    else:
        _is_used = True


def is_used_for(*arrays: jax.Array) -> bool:
    """Return whether this process computes with oneDNN on such arrays: of float32, on a single CPU device."""
    return (
        _is_used
        and jax.default_backend() == "cpu"
        and jax.device_count() == 1
        and all(array.dtype == jnp.float32 for array in arrays)
    )


def is_installed() -> bool:
    """Return whether oneDNN 3, built for OpenMP, and its headers are in this environment."""
    config = _HEADERS / "oneapi" / "dnnl" / "dnnl_config.h"
    return _ONEDNN.exists() and config.exists() and _OPENMP.search(config.read_text()) is not None


def used_version() -> str | None:
    """Return the version of oneDNN, such as "3.2.0"; None if this process does not use it."""
    return ".".join(re.findall(r"DNNL_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", _version_header())) if _is_used else None


def register() -> None:
    """Register the calls with JAX, and compile them if this machine has not done so yet.

    Raises:
        UserError: there is no C++ compiler or it fails, or the cache folder cannot be written.
    """
    path = cache_folder() / "onednn" / f"{_fingerprint()}.so"
    if not path.exists():
        with one_maker(path):
            if not path.exists():  # another process may have made it
                _compile(path)
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise UserError(f"cannot load {shown(path)} ({error}); delete it to compile it again") from error
    for name in _TARGETS:
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(library, name)), platform="cpu")


def _compile(path: pathlib.Path) -> None:
    compiler = _compiler()
    if shutil.which(compiler[0]) is None:
        raise UserError(f"there is no C++ compiler {compiler[0]}; install g++, or name another one with CXX")
    sys.stderr.write("ha2g: compiling the calls of oneDNN, once on this machine\n")
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = pathlib.Path(folder) / path.name
        command = [*compiler, "-std=c++17", "-O3", "-march=native", "-fopenmp", "-fPIC", "-shared", "-w"]
        command += [f"-I{_HEADERS}", f"-I{jax.ffi.include_dir()}"]
        command += [str(_FOLDER / name) for name in _SOURCES if name.endswith(".cc")]
        command += [str(_ONEDNN), f"-Wl,-rpath,{_ONEDNN.parent}", "-o", str(made)]
        result = subprocess.run(command, capture_output=True, text=True, errors="replace")
        if result.returncode:
            lines = result.stderr.strip().splitlines() or [f"exit code {result.returncode}"]
            first = next((line for line in lines if "error" in line), lines[0])
            raise UserError(f"{compiler[0]} does not compile the calls of oneDNN ({first})")
        made.replace(path)


def _compiler() -> list[str]:
    return shlex.split(os.environ.get("CXX", "")) or ["c++"]


def _fingerprint() -> str:
    """Return a hash of all that a compiled library depends on: sources, versions, compiler and processor."""
    parts = [(_FOLDER / name).read_text() for name in _SOURCES]
    parts += [_version_header(), jaxlib.version.__version__, str(_ONEDNN), *_compiler()]
    # Homes are shared between machines, and -march=native takes the instructions of one.
    parts += sorted({line for line in _CPU.read_text().splitlines() if line.startswith(("flags", "Features"))})
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _version_header() -> str:
    return (_HEADERS / "oneapi" / "dnnl" / "dnnl_version.h").read_text()

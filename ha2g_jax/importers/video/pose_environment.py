"""Virtual environment of MediaPipe, which needs numpy < 2 and so cannot be installed beside this package."""

import importlib.resources
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import cache_folder

_NAME = "pose-0.10.21"  # MediaPipe's version
_PYTHONS = ("3.12", "3.11")  # versions of Python that MediaPipe has wheels for and this package supports
_VARIABLE = "HA2G_POSE_PYTHON"
_PINS = "requirements.txt"
_TAIL = 300  # characters of the last line of a failed program's output


def install(folder: str | os.PathLike | None = None, python: str | os.PathLike | None = None) -> pathlib.Path:
    """Install the environment (400 MB from PyPI), unless it exists already.

    It is made in a temporary folder and renamed after MediaPipe has processed an image, so it is complete or absent.

    Args:
        folder: folder of the environment; by default "pose-0.10.21" in `cache_folder()`.
        python: interpreter of the environment, Python 3.11 or 3.12; by default the running one, or else one on PATH.

    Returns:
        The folder of the environment.

    Raises:
        UserError: there is no such Python, no connection or no disk space, or MediaPipe does not run here.
    """
    folder = pathlib.Path(folder) if folder is not None else _folder()
    pins = (importlib.resources.files("ha2g_jax") / "assets" / "pose_requirements.txt").read_text()
    if _is_whole(folder, pins):
        return folder
    if folder.exists() and not (folder / "pyvenv.cfg").exists():
        raise UserError(f"{folder} exists and is not an environment; choose another folder, or remove it")
    try:
        interpreter = _find_python(python)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as temporary:
            made = pathlib.Path(temporary) / folder.name
            _make(made, interpreter, pins)
            (made / _PINS).write_text(pins)
            if _is_whole(folder, pins):  # another process has made it in the meantime
                return folder
            if folder.exists():
                shutil.rmtree(folder)
            made.rename(folder)
    except OSError as error:
        raise UserError(f"cannot make {folder} ({(error.strerror or str(error)).lower()}); choose another") from error
    return folder


def command() -> list[str]:
    """Return the command line of `holistic`, without the path of its output.

    $HA2G_POSE_PYTHON may name the interpreter of another environment that has MediaPipe.

    Raises:
        UserError: the environment is not installed.
    """
    named = os.environ.get(_VARIABLE)
    interpreter = pathlib.Path(named) if named else _interpreter(_folder())
    if not interpreter.is_file():
        if named:
            raise UserError(
                f"{_VARIABLE} is {named!r}, which does not exist; give the Python of an environment with MediaPipe"
            )
        raise UserError("the pose estimator is not installed; run `ha2g data install-pose`, or give a --pose-command")
    # Isolated (-I), so that modules of the user or of this folder cannot replace those of MediaPipe.
    return [str(interpreter), "-I", str(pathlib.Path(__file__).with_name("holistic.py"))]


def _folder() -> pathlib.Path:
    return cache_folder() / _NAME


def _interpreter(folder: pathlib.Path) -> pathlib.Path:
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def _is_whole(folder: pathlib.Path, pins: str) -> bool:
    written = folder / _PINS
    return _interpreter(folder).is_file() and written.is_file() and written.read_text() == pins


def _find_python(python: str | os.PathLike | None) -> str:
    """Find an interpreter that MediaPipe has wheels for."""
    names = [f"python{version}" for version in _PYTHONS]
    candidates = [os.fspath(python)] if python is not None else [sys.executable, *names]
    for candidate in candidates:
        path = shutil.which(candidate)
        # The interpreter is asked for its path, because a name on PATH may be a script that selects one.
        code = "import sys; print(*sys.version_info[:2], sys.executable)"
        answer = subprocess.run([path, "-I", "-c", code], capture_output=True, text=True, check=False) if path else None
        words = answer.stdout.strip().split(" ", 2) if answer else []
        if len(words) == 3 and ".".join(words[:2]) in _PYTHONS:
            return words[2]
    tried = ", ".join(candidates)
    raise UserError(
        f"MediaPipe needs Python 3.11 or 3.12, and none of {tried} is; install one, or give its path (--python)"
    )


def _make(folder: pathlib.Path, interpreter: str, pins: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    count = sum(1 for line in pins.splitlines() if "==" in line)
    with tqdm(total=count + 2, desc="pose environment", unit="step", disable=None, leave=False) as bar:
        _run([interpreter, "-m", "venv", str(folder)], environment, bar, "install Python's venv module and pip")
        bar.update()
        requirements = folder / "pins.txt"
        requirements.write_text(pins)
        python = str(_interpreter(folder))
        # Without dependencies, because the pins are sufficient; MediaPipe also requires JAX and SciPy.
        pip = [python, "-I", "-m", "pip", "install", "--no-deps", "--only-binary=:all:", "--no-input", "--retries=1"]
        pip += ["--disable-pip-version-check", "-r", str(requirements)]
        _run(pip, environment, bar, "check whether PyPI can be reached, then run it again", step="Collecting ")
        bar.set_postfix_str("first image")
        _run(
            [python, "-I", "-c", _CHECK], environment, bar, "MediaPipe 0.10.21 does not run here; use a --pose-command"
        )
        bar.update()
        requirements.unlink()


def _run(arguments: list[str], environment: dict[str, str], bar: tqdm, advice: str, step: str | None = None) -> None:
    """Run a program to its end; each line of its output that starts with `step` advances the bar."""
    lines: list[str] = []
    with subprocess.Popen(
        arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                lines = [*lines[-50:], line.strip()]
                if step and line.startswith(step):
                    bar.set_postfix_str(line.removeprefix(step).split()[0])
                    bar.update()
        except BaseException:
            process.kill()
            raise
    if process.returncode:
        said = [line for line in lines if line and not line.startswith("WARNING")] or ["no output"]
        last = next((line for line in said if line.startswith("ERROR")), said[-1])[-_TAIL:]
        raise UserError(f"cannot make the pose environment ({last}); {advice}")


_CHECK = """
import numpy
from mediapipe.python.solutions.holistic import Holistic
with Holistic(model_complexity=1) as holistic:
    holistic.process(numpy.zeros((64, 64, 3), numpy.uint8))
"""

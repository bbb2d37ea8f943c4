"""Estimation of the speaker's 43 keypoints in each image of a video, by an estimator in a separate process."""

import contextlib
import importlib.resources
import os
import pathlib
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from typing import IO

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.cache import cache_folder
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import temporary_folder, writing
from ha2g_jax.importers.video.images import decode, no_images, open_video, pixel_ratio, upright
from ha2g_jax.importers.video.keypoints import Keypoints, from_holistic
from ha2g_jax.progress import stage
from ha2g_jax.stopping import signal_name

_JOINTS = 43
_MAX_METRES = 1000.0
_TAIL = 300  # characters of the last line of a program's output

_NAME = "pose-0.10.21"  # MediaPipe's version
_PYTHONS = ("3.12", "3.11")  # versions of Python that MediaPipe has wheels for and this package supports
_VARIABLE = "HA2G_POSE_PYTHON"
_PINS = "requirements.txt"
_CHECK = """
import numpy
from mediapipe.python.solutions.holistic import Holistic
with Holistic(model_complexity=1) as holistic:
    holistic.process(numpy.zeros((64, 64, 3), numpy.uint8))
"""


def estimate(video: pathlib.Path, *, command: str | None = None) -> Keypoints:
    """Estimate the poses in a video, by MediaPipe Holistic or by the command line of another estimator.

    "{video}" and "{out}" in the command are replaced by paths; it is not run by a shell. It must write a .npz with the
    arrays of `Keypoints` by name to "{out}", with one pose for each image in order.

    Raises:
        UserError: the estimator is not installed, fails, or writes invalid arrays.
    """
    video = pathlib.Path(video)
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "poses.npz"
        if command is None:
            return _estimate_with_holistic(video, out)
        _run_command(command, video, out)
        return _read_poses(out, f"the pose command's file for {shown(video)}")


def _run_command(command: str, video: pathlib.Path, out: pathlib.Path) -> None:
    if "{video}" not in command or "{out}" not in command:
        raise UserError(f"pose command {command!r} lacks {{video}} or {{out}}; write COMMAND {{video}} {{out}}")
    try:
        parts = shlex.split(command)
    except ValueError as error:
        raise UserError(f"pose command {command!r} cannot be split into words ({error}); check its quotes") from error
    # Each part is replaced only once, so that the name of a video may contain "{out}".
    places = {"{video}": str(video.absolute()), "{out}": str(out)}
    with _estimator([_replaced(part, places) for part in parts], video, out, subprocess.DEVNULL):
        pass


def _replaced(part: str, places: dict[str, str]) -> str:
    for place, path in places.items():
        before, found, after = part.partition(place)
        if found:
            return _replaced(before, places) + path + _replaced(after, places)
    return part


def _estimate_with_holistic(video: pathlib.Path, out: pathlib.Path) -> Keypoints:
    """Decode the images here, as for every other step, and send them to `holistic`."""
    is_empty = True
    with (
        open_video(video) as container,
        _estimator([*holistic_command(), str(out)], video, out, subprocess.PIPE) as process,
    ):
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError), process.stdin:  # the estimator died; the reason is in its output
            ratio = pixel_ratio(container)
            for frame in decode(video, container):
                image = upright(frame, ratio)
                is_empty = False
                process.stdin.write(struct.pack("<2I", *image.size))
                process.stdin.write(image.tobytes())
        if is_empty:
            raise no_images(video)
    return from_holistic(**read_npz(out))


@contextlib.contextmanager
def _estimator(
    arguments: list[str], video: pathlib.Path, out: pathlib.Path, stdin: int
) -> Iterator[subprocess.Popen[bytes]]:
    """Run an estimator to its end after this context, which kills it if it is left by an exception."""
    with tempfile.TemporaryFile() as log:
        try:
            process = subprocess.Popen(arguments, stdin=stdin, stdout=log, stderr=log, env=_environment())
        except (OSError, ValueError) as error:
            raise UserError(
                f"pose estimator {arguments[0]!r} cannot be started ({error}); give the path of a program"
            ) from error
        try:
            yield process
            process.wait()
        finally:
            process.kill()
            process.wait()
        if process.returncode < 0:
            name = signal_name(-process.returncode)
            raise UserError(
                f"the pose estimator was killed by {name} at {shown(video)}; check whether memory is sufficient"
            )
        if process.returncode:
            raise UserError(
                f"the pose estimator failed at {shown(video)} with exit code {process.returncode} ({_last_line(log)}); "
                "correct the cause, or try another --pose-command"
            )
        if not out.is_file():
            raise UserError(
                f"the pose estimator wrote no file for {shown(video)} ({_last_line(log)}); expected a .npz at {{out}}"
            )


def _environment() -> dict[str, str]:
    """Return the environment of this process without paths to its libraries: an estimator has its own."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}


def _last_line(log: IO[bytes]) -> str:
    log.seek(max(0, log.seek(0, os.SEEK_END) - 10 * _TAIL))
    lines = [line.strip() for line in log.read().decode(errors="replace").splitlines() if line.strip()]
    return lines[-1][-_TAIL:] if lines else "no output"


def _read_poses(out: pathlib.Path, name: str) -> Keypoints:
    """Read the poses of a file that a user's own estimator wrote, and check them."""
    try:
        arrays = read_npz(out, names=Keypoints._fields)
    except UserError as error:
        raise UserError(str(error).replace(str(out), name)) from error
    if lacking := set(Keypoints._fields) - set(arrays):
        raise UserError(f"{name} has no {sorted(lacking)[0]!r}; expected {', '.join(Keypoints._fields)}")
    count = len(arrays["positions"]) if arrays["positions"].ndim else 0
    shapes = {"positions": (count, _JOINTS, 3), "confidence": (count, _JOINTS), "image_points": (count, _JOINTS, 2)}
    for key, shape in shapes.items():
        if arrays[key].shape != shape or arrays[key].dtype.kind not in "fiu":
            found = f"{arrays[key].dtype} of shape {arrays[key].shape}"
            raise UserError(f"{name}: {key} is {found}; expected numbers of shape {('T', *shape[1:])}")
    if not count:
        raise UserError(f"{name} has no pose; expected one for each image")
    positions, confidence, points = (arrays[key].astype(np.float32) for key in shapes)
    confidence = np.nan_to_num(confidence)
    if confidence.min() < 0 or confidence.max() > 1:
        low, high = confidence.min(), confidence.max()
        raise UserError(f"{name}: confidence lies between {low:g} and {high:g}; expected 0 to 1")
    is_seen = confidence > 0
    if not np.isfinite(positions[is_seen]).all():
        frame, joint = np.argwhere(is_seen & ~np.isfinite(positions).all(axis=-1))[0]
        raise UserError(
            f"{name}: keypoint {joint} of frame {frame} has confidence {confidence[frame, joint]:g} but no finite "
            "position; expected confidence 0 where a keypoint is unseen"
        )
    size = np.abs(positions[is_seen]).max(initial=0)
    if size > _MAX_METRES:
        raise UserError(f"{name}: positions reach {size:g}; expected metres, less than {_MAX_METRES:g} from the origin")
    positions, points = (np.where(is_seen[..., None], values, np.float32(np.nan)) for values in (positions, points))
    return Keypoints(positions, confidence, points)


def install(python: str | os.PathLike | None = None) -> pathlib.Path:
    """Install the environment of MediaPipe (400 MB from PyPI) in the cache folder, unless it exists already.

    It is made in a temporary folder and renamed after MediaPipe has processed an image, so it is complete or absent.
    Its interpreter, Python 3.11 or 3.12, is by default the running one, or else one on PATH. Returns its folder.

    Raises:
        UserError: there is no such Python, no connection or no disk space, or MediaPipe does not run here.
    """
    folder = _folder()
    pins = (importlib.resources.files("ha2g_jax") / "assets" / "pose_requirements.txt").read_text()
    if _is_whole(folder, pins):
        return folder
    if folder.exists() and not (folder / "pyvenv.cfg").exists():
        raise UserError(f"{folder} exists and is not an environment; remove it, or set HA2G_CACHE to another folder")
    interpreter = _find_python(python)
    with writing(folder, "set HA2G_CACHE to another folder"), temporary_folder(folder) as temporary:
        if not _is_whole(folder, pins):  # another process may have made it in the meantime
            made = temporary / folder.name
            _make(made, interpreter, pins)
            (made / _PINS).write_text(pins)
            if folder.exists():
                shutil.rmtree(folder)
            made.rename(folder)
    return folder


def holistic_command() -> list[str]:
    """Return the command line of `holistic` without its output, by the interpreter of $HA2G_POSE_PYTHON if it is set.

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
        raise UserError(
            "the pose estimator is not installed; run `ha2g data build-video --install`, or give a --pose-command"
        )
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
    names = [f"python{version}" for version in _PYTHONS]
    candidates = [os.fspath(python)] if python is not None else [sys.executable, *names]
    for candidate in candidates:
        path = shutil.which(candidate)
        # Ask the interpreter for its path, because a name on PATH may be a script that selects one.
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
    with stage("installing MediaPipe"):
        _run([interpreter, "-m", "venv", str(folder)], "install Python's venv module and pip")
        requirements = folder / "pins.txt"
        requirements.write_text(pins)
        python = str(_interpreter(folder))
        # Without dependencies, because the pins are sufficient; MediaPipe also requires JAX and SciPy.
        pip = [python, "-I", "-m", "pip", "install", "--no-deps", "--only-binary=:all:", "--no-input", "--retries=1"]
        pip += ["--disable-pip-version-check", "-r", str(requirements)]
        _run(pip, "check whether PyPI can be reached, then run it again")
        _run([python, "-I", "-c", _CHECK], "MediaPipe 0.10.21 does not run here; use a --pose-command")
        requirements.unlink()


def _run(arguments: list[str], advice: str) -> None:
    """Run a program to its end; if it fails, the error quotes the most informative line of its output."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
    done = subprocess.run(arguments, env=_environment(), check=False, **options)
    if done.returncode:
        lines = [line.strip() for line in done.stdout.splitlines()]
        said = [line for line in lines if line and not line.startswith("WARNING")] or ["no output"]
        last = next((line for line in said if line.startswith("ERROR")), said[-1])[-_TAIL:]
        raise UserError(f"cannot make the pose environment ({last}); {advice}")

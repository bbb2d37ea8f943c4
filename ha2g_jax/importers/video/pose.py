"""Estimation of the speaker's 43 keypoints in each image of a video, by an estimator in a separate process."""

import contextlib
import os
import pathlib
import shlex
import signal
import struct
import subprocess
import tempfile
from typing import IO, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.video import images, keypoints, pose_environment
from ha2g_jax.importers.video.decoding import decode, no_images, open_video

_JOINTS = 43
_DEFAULT_RATE = 25
_TAIL = 300  # characters of the last line of an estimator's output


class Poses(NamedTuple):
    """The keypoints of a video, one pose per image.

    Attributes:
        positions: (T, 43, 3) float32 metres in the axes of TED-Expressive, NaN where unseen.
        confidence: (T, 43) float32 in [0, 1], 0 where unseen.
        image_points: (T, 43, 2) float32 pixels, NaN where unseen.
        fps: images per second.
    """

    positions: np.ndarray
    confidence: np.ndarray
    image_points: np.ndarray
    fps: float


def estimate(video: pathlib.Path, *, command: str | None = None) -> Poses:
    """Estimate the poses in a video.

    Args:
        video: path of a video.
        command: command line of an estimator to use instead of MediaPipe Holistic. "{video}" and "{out}" in it are
            replaced by paths; it is not run by a shell. It must write a .npz with the arrays `positions`,
            `confidence`, `image_points` and `fps` of `Poses` to "{out}", with one pose for each image in order.

    Raises:
        UserError: the estimator is not installed, fails, or writes invalid arrays.
    """
    video = pathlib.Path(video)
    with tempfile.TemporaryDirectory(prefix="ha2g-pose-") as folder:
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
    arguments = [_replaced(part, places) for part in parts]
    with tempfile.TemporaryFile() as log:
        process = _start(arguments, log, subprocess.DEVNULL)
        try:
            process.wait()
        finally:
            process.kill()
            process.wait()
        _check(process, out, log, video)


def _replaced(part: str, places: dict[str, str]) -> str:
    for place, path in places.items():
        before, found, after = part.partition(place)
        if found:
            return _replaced(before, places) + path + _replaced(after, places)
    return part


def _estimate_with_holistic(video: pathlib.Path, out: pathlib.Path) -> Poses:
    """Decode the images here, as for every other step, and send them to `holistic`."""
    arguments = [*pose_environment.command(), str(out)]
    with open_video(video) as container, tempfile.TemporaryFile() as log:
        stream = container.streams.video[0]
        fps = float(stream.average_rate or stream.guessed_rate or _DEFAULT_RATE)
        is_empty = True
        process = _start(arguments, log, subprocess.PIPE)
        assert process.stdin is not None
        try:
            with contextlib.suppress(BrokenPipeError):  # the estimator died; `_check` reports the reason
                for frame in decode(video, container):
                    image = images.upright(frame)
                    is_empty = False
                    process.stdin.write(struct.pack("<2I", *image.size))
                    process.stdin.write(image.tobytes())
                process.stdin.close()
            process.wait()
        finally:
            process.kill()
            process.wait()
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        if is_empty:
            raise no_images(video)
        _check(process, out, log, video)
    landmarks = read_npz(out)
    found = keypoints.from_holistic(**landmarks)
    return Poses(*found, fps)


def _start(arguments: list[str], log: IO[bytes], stdin: int) -> subprocess.Popen[bytes]:
    # An estimator has its own libraries, so paths to the libraries of this process are removed.
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    try:
        return subprocess.Popen(arguments, stdin=stdin, stdout=log, stderr=log, env=environment)
    except (OSError, ValueError) as error:
        raise UserError(
            f"pose estimator {arguments[0]!r} cannot be started ({error}); give the path of a program"
        ) from error


def _check(process: subprocess.Popen[bytes], out: pathlib.Path, log: IO[bytes], video: pathlib.Path) -> None:
    """Raise a `UserError` unless the process succeeded and wrote its file."""
    if process.returncode < 0:
        number = -process.returncode
        name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
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


def _last_line(log: IO[bytes]) -> str:
    log.seek(max(0, log.seek(0, os.SEEK_END) - 10 * _TAIL))
    lines = [line.strip() for line in log.read().decode(errors="replace").splitlines() if line.strip()]
    return lines[-1][-_TAIL:] if lines else "no output"


def _read_poses(out: pathlib.Path, name: str) -> Poses:
    """Read the poses of a file that a user's own estimator wrote, and check them."""
    try:
        arrays = read_npz(out, names=("positions", "confidence", "image_points", "fps"))
    except UserError as error:
        raise UserError(str(error).replace(str(out), name)) from error
    lacking = {"positions", "confidence", "image_points", "fps"} - set(arrays)
    if lacking:
        raise UserError(f"{name} has no {sorted(lacking)[0]!r}; expected positions, confidence, image_points and fps")
    count = len(arrays["positions"]) if arrays["positions"].ndim else 0
    shapes = {"positions": (count, _JOINTS, 3), "confidence": (count, _JOINTS), "image_points": (count, _JOINTS, 2)}
    for key, shape in shapes.items():
        if arrays[key].shape != shape or arrays[key].dtype.kind not in "fiu":
            found = f"{arrays[key].dtype} of shape {arrays[key].shape}"
            raise UserError(f"{name}: {key} is {found}; expected numbers of shape {('T', *shape[1:])}")
    if not count:
        raise UserError(f"{name} has no pose; expected one for each image")
    fps = arrays["fps"]
    if fps.size != 1 or fps.dtype.kind not in "fiu" or not 0 < float(fps.reshape(())) < 1000:
        raise UserError(f"{name}: fps is {fps.tolist()!r:.60}; expected images per second")
    positions, confidence, points = (arrays[key].astype(np.float32) for key in shapes)
    return Poses(*_checked(positions, confidence, points, name), float(fps.reshape(())))


def _checked(
    positions: np.ndarray, confidence: np.ndarray, points: np.ndarray, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Check the arrays, and set unseen keypoints to NaN."""
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
    unseen = ~is_seen[..., None]
    return np.where(unseen, np.float32(np.nan), positions), confidence, np.where(unseen, np.float32(np.nan), points)


_MAX_METRES = 1000.0

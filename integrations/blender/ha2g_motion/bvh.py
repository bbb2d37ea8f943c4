"""Reader of BVH files with any order of channels: centimetres, all rotations zero at rest."""

import io
import pathlib
import re

import numpy as np

from . import checks, rotations
from .motion import Motion, from_local

_METRES = 0.01
_MAX_HEAD = 1 << 20
_BLOCK = 1 << 20  # bytes of numbers that are parsed together
_TIMES = re.compile(rb"\s*Frames:\s*(\d{1,9})\s+Frame\s+Time:\s*(\S{1,40})")
_AXES = {"X": np.array([1.0, 0.0, 0.0]), "Y": np.array([0.0, 1.0, 0.0]), "Z": np.array([0.0, 0.0, 1.0])}


def read(path: pathlib.Path) -> Motion:
    """Read a `.bvh` file in centimetres with the axes of `ha2g export`: y up, facing +z.

    Raises:
        ValueError: the file is not a valid BVH.
    """
    head, found, body = path.read_bytes().partition(b"MOTION")
    times = _TIMES.match(body)
    if not found or times is None or len(head) > _MAX_HEAD:
        raise ValueError("no MOTION section with the number of frames and their time")
    names, parents, offsets, channels = _hierarchy(head.decode("utf-8-sig"))
    count = int(times[1])
    checks.check_size(count, len(names))
    columns = [(joint, channel) for joint, own in enumerate(channels) for channel in own]
    table = _numbers(body[times.end() :])
    if table.size != count * len(columns):
        raise ValueError(f"{table.size} numbers, expected {count} frames of {len(columns)}")
    if not np.isfinite(table).all():
        raise ValueError("values that are not numbers")
    table = table.reshape(count, len(columns))
    rotated = np.tile(rotations.IDENTITY, (count, len(names), 1))
    root = np.tile(offsets[0], (count, 1))
    for column, (joint, channel) in enumerate(columns):
        axis, kind = channel[0].upper(), channel[1:].lower()
        if kind == "rotation":
            step = rotations.about(_AXES[axis], table[:, column])
            rotated[:, joint] = rotations.multiply(rotated[:, joint], step)
        elif joint == 0:
            root[:, "XYZ".index(axis)] += table[:, column]
    rest = np.tile(rotations.IDENTITY, (len(names), 1))
    fps = _whole(1 / float(times[2]))
    return from_local(path.stem, tuple(names), tuple(parents), offsets * _METRES, rest, rotated, root * _METRES, fps)


def _numbers(text: bytes) -> np.ndarray:
    stream, blocks = io.BytesIO(text), [np.empty(0)]
    while block := stream.read(_BLOCK) + stream.readline():
        blocks.append(np.array(block.split(), float))
    return np.concatenate(blocks)


def _hierarchy(head: str) -> tuple[list[str], list[int], np.ndarray, list[list[str]]]:
    """Return names, parents, offsets (J, 3) and channels of the joints, without the end sites."""
    names: list[str] = []
    parents: list[int] = []
    channels: list[list[str]] = []
    offsets: list[list[float]] = []
    open_joints = [-1]
    is_end = False
    for line in head.splitlines():
        word, *rest = line.split() or [""]
        if word in ("ROOT", "JOINT"):
            names.append(" ".join(rest))
            parents.append(open_joints[-1])
            channels.append([])
            offsets.append([0.0, 0.0, 0.0])
        elif word == "End":
            is_end = True
        elif word == "{":
            open_joints.append(open_joints[-1] if is_end else len(names) - 1)
        elif word == "}":
            open_joints.pop()
            is_end = False
        elif word == "OFFSET" and not is_end:
            offsets[-1] = [float(value) for value in rest[:3]]
        elif word == "CHANNELS":
            channels[-1] = rest[1:]
    return names, parents, np.array(offsets), channels


def _whole(fps: float) -> float:
    """Round a frame rate that is nearly whole, because the frame time has only ten digits."""
    return float(round(fps)) if abs(fps - round(fps)) < 1e-4 else fps

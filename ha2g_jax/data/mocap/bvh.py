"""Reader of BVH motion capture of any skeleton."""

import os
import pathlib
from collections.abc import Iterator
from typing import NamedTuple, TextIO

import numpy as np

from ha2g_jax.errors import UserError

MAX_JOINTS = 1000

_MAX_LINE = 1 << 16  # characters in a line of the header
_BLOCK = 1 << 20  # characters of the motion that are parsed at once
_MAX_NUMBER = 40  # characters in a number
_MAX_NAME_WORDS = 8
_MAX_VALUE = 1e7  # value of a channel: ten kilometres in millimetres
_MIN_FPS, _MAX_FPS = 1.0, 2000.0
_CHANNELS = {f"{axis}{kind}": f"{axis.upper()}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
# Usual rates, whose frame times exporters round.
_RATES = (24, 25, 30, 50, 60, 90, 100, 120, 200, 240, *(rate / 1.001 for rate in (24, 30, 60, 120)))
_MIN_DIGITS = 3  # decimals that a frame time needs to identify a usual rate


class Bvh(NamedTuple):
    """Contents of a BVH file.

    Attributes:
        joints: unique names of the joints, each after its parent. End sites are left out.
        parents: index of each joint's parent, -1 for a root.
        offsets: (joints, 3) offset from the parent in the rest pose, in units of the file.
        channels: channels of each joint in the order of the file, such as ("Zrotation", "Yrotation", "Xrotation").
        motion: (frames, channels) values; positions in units of the file, rotations in degrees.
        fps: frames per second.
    """

    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray
    channels: tuple[tuple[str, ...], ...]
    motion: np.ndarray
    fps: float

    @property
    def seconds(self) -> float:
        """Length of the motion in seconds."""
        return len(self.motion) / self.fps


def read_bvh(path: str | os.PathLike) -> Bvh:
    """Read a BVH file of any exporter: any letter case, white space, order of rotations, positions on any joint.

    Memory stays within a few times the size of the file, whatever its header declares.

    Args:
        path: path of the file.

    Raises:
        UserError: the file is not BVH, is cut off, or has invalid values; the message names the line, or the frame
            and the channel.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise UserError(f"{'a folder' if path.is_dir() else 'no file'} at {path}; give the path of a .bvh file")
    try:
        size = path.stat().st_size
        if size == 0:
            raise UserError(f"{path} is an empty file; expected a motion capture in BVH")
        # Names may be in any encoding; escaping keeps different names different.
        with path.open(encoding="utf-8-sig", errors="backslashreplace") as file:
            return _Reader(path, file, size).read()
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}); give a BVH file") from error


class _Reader:
    """Reader of one open file, word by word, which counts lines for error messages."""

    def __init__(self, path: pathlib.Path, file: TextIO, size: int):
        self._path, self._file, self._size = path, file, size
        self._line, self._in_motion = 0, False
        self._words: Iterator[str] = iter(())
        self._joints: dict[str, int] = {}  # name: parent
        self._offsets: dict[int, list[float]] = {}
        self._channels: dict[int, tuple[str, ...]] = {}

    def read(self) -> Bvh:
        if self._word().upper() != "HIERARCHY":
            raise self._error("it does not begin with HIERARCHY, so it is not a BVH file")
        self._read_hierarchy()
        if missing := [name for index, name in enumerate(self._joints) if index not in self._offsets]:
            raise self._error(f"joint {_shown(missing[0])} has no OFFSET")
        channels = tuple(self._channels.get(joint, ()) for joint in range(len(self._joints)))
        names = [f"{channel} of {joint}" for joint, own in zip(self._joints, channels, strict=True) for channel in own]
        if not names:
            raise self._error("it has no CHANNELS, so it has no motion")
        frames, fps = self._read_motion_header()
        motion = self._read_values(frames, names)
        offsets = np.array([self._offsets[joint] for joint in range(len(self._joints))])
        return Bvh(tuple(self._joints), tuple(self._joints.values()), offsets, channels, motion, fps)

    def _read_hierarchy(self) -> None:
        open_joints: list[int] = []  # -1 is an end site
        while (word := self._word().upper()) != "MOTION":
            if word in ("ROOT", "JOINT", "END"):
                if (word == "ROOT") == bool(open_joints) or -1 in open_joints[-1:]:
                    raise self._error(f"{word} is not allowed here")
                name, parent = self._name(), open_joints[-1] if open_joints else -1
                open_joints.append(-1 if word == "END" else self._add(name, parent))
            elif word == "}" and open_joints:
                open_joints.pop()
            elif word == "OFFSET" and open_joints:
                offset = [self._offset() for _ in range(3)]
                if open_joints[-1] >= 0:
                    self._offsets[open_joints[-1]] = offset
            elif word == "CHANNELS" and open_joints and open_joints[-1] >= 0:
                self._channels[open_joints[-1]] = self._channel_names()
            else:
                raise self._error(f"found {_shown(word)}, expected ROOT, JOINT, OFFSET, CHANNELS, End Site or MOTION")
        if open_joints or not self._joints:
            raise self._error("MOTION begins before the skeleton is complete")

    def _add(self, name: str, parent: int) -> int:
        if name in self._joints:
            raise self._error(f"a second joint {_shown(name)}, expected unique names and no cycles")
        if len(self._joints) == MAX_JOINTS:
            raise self._error(f"more than {MAX_JOINTS} joints, expected the skeleton of a person")
        self._joints[name] = parent
        return len(self._joints) - 1

    def _name(self) -> str:
        words: list[str] = []
        while (word := self._word()) != "{":
            if word == "}" or len(words) == _MAX_NAME_WORDS:
                raise self._error("the name of a joint is not followed by {")
            words.append(word)
        return " ".join(words)

    def _offset(self) -> float:
        word = self._word()
        if (value := _to_number(word)) is None:
            raise self._error(f"OFFSET with {_shown(word)}, expected three numbers")
        return value

    def _channel_names(self) -> tuple[str, ...]:
        count = self._word()
        if count not in tuple("0123456"):
            raise self._error(f"CHANNELS {_shown(count)}, expected 0 to 6")
        found = [self._word() for _ in range(int(count))]
        names = tuple(_CHANNELS.get(name.lower(), "") for name in found)
        if "" in names or len(set(names)) < len(names):
            raise self._error(f"channels {_shown(' '.join(found))}, expected different ones of Xposition to Zrotation")
        return names

    def _read_motion_header(self) -> tuple[int, float]:
        self._in_motion = True
        self._words = iter(" ".join(self._words).replace(":", " ").split())
        count = self._value_of("FRAMES")
        if not (count.isascii() and count.isdigit() and len(count) <= _MAX_NUMBER and int(count)):
            raise self._error(f"Frames: {_shown(count)}, expected a whole number from 1")
        text = self._value_of("FRAME", "TIME")
        frame_time = _to_number(text)
        if frame_time is None or not 1 / _MAX_FPS <= frame_time <= 1 / _MIN_FPS:
            raise self._error(f"Frame Time: {_shown(text)}, expected seconds, such as 0.0333333 for 30 frames a second")
        return int(count), _frame_rate(text, frame_time)

    def _value_of(self, *words: str) -> str:
        for expected in words:
            if (word := self._word()).upper() != expected:
                raise self._error(f"found {_shown(word)} after MOTION, expected Frames: and Frame Time:")
        return self._word()

    def _read_values(self, frames: int, names: list[str]) -> np.ndarray:
        wanted, found = frames * len(names), 0
        # A value takes at least two characters, which limits the memory that the header can demand to the file's size.
        values = np.empty(min(wanted, self._size // 2 + 1))
        for block in self._blocks():
            words = block[: wanted - found]
            values[found : found + len(words)] = self._numbers(words, found, names)
            found += len(words)
            if found == wanted:
                return values.reshape(frames, len(names))
        raise UserError(
            f"{self._path} is cut off: it holds {found // len(names)} whole frames of {len(names)} values, but its "
            f"header declares {frames}; export it again"
        )

    def _blocks(self) -> Iterator[list[str]]:
        """Yield the words of the motion, some thousands at a time."""
        rest = " ".join(self._words) + " "
        while block := self._file.read(_BLOCK):
            text = rest + block
            words = text.split()
            # The last word may continue in the next block.
            rest = words.pop() if words and not text[-1].isspace() else ""
            if len(rest) > _MAX_LINE:
                raise self._error(f"a word of more than {_MAX_LINE} characters, expected numbers")
            yield words
        yield rest.split()

    def _numbers(self, words: list[str], found: int, names: list[str]) -> np.ndarray:
        try:
            values = np.array(words, float)
        except ValueError:
            values = np.array([_to_number(word) for word in words], float)  # None becomes NaN
        is_bad = ~(np.abs(values) <= _MAX_VALUE)
        if is_bad.any():
            index = int(np.argmax(is_bad))
            frame, column = divmod(found + index, len(names))
            raise UserError(
                f"{self._path}: {names[column]} in frame {frame + 1} is {_shown(words[index])}, expected a number; "
                "export the motion again"
            )
        return values

    def _word(self) -> str:
        while (word := next(self._words, None)) is None:
            line = self._file.readline(_MAX_LINE)
            self._line += 1
            if not line:
                raise self._error("the file ends here, expected more of the skeleton or the motion")
            if len(line) == _MAX_LINE:
                raise self._error(f"a line of {_MAX_LINE} characters or more, so it is not a BVH file")
            if self._in_motion:
                line = line.replace(":", " ")
            self._words = iter(line.replace("{", " { ").replace("}", " } ").split())
        return word

    def _error(self, found: str) -> UserError:
        return UserError(f"{self._path}, line {self._line}: {found}; export the motion again")


def _to_number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if abs(value) <= _MAX_VALUE else None


def _frame_rate(text: str, frame_time: float) -> float:
    """Return the frames per second: a usual rate if the frame time equals that of the rate in all its digits."""
    digits = len(text.partition(".")[2])
    rate = min(_RATES, key=lambda rate: abs(1 / rate - frame_time))
    is_cut = text.replace(".", "").isdigit() and digits >= _MIN_DIGITS and abs(1 / rate - frame_time) < 10.0**-digits
    return rate if is_cut else 1 / frame_time


def _shown(text: str) -> str:
    return repr(text if len(text) <= _MAX_NUMBER else text[:_MAX_NUMBER] + "...")

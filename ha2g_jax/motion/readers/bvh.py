"""Reader of BVH motion capture of any skeleton."""

import os
import pathlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TextIO

import numpy as np

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, reading, shown

_EXPECTED = "a motion capture in BVH"
_MAX_LINE = 1 << 16  # letters in a line of the header
_MAX_NAME_WORDS = 8
_CHANNELS = {f"{axis}{kind}": f"{axis.upper()}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
# Usual rates, whose frame times exporters round.
USUAL_RATES = (
    *(10, 15, 20, 24, 25, 30, 50, 60, 90, 100, 120, 125, 200, 240, 250),
    *(rate / 1.001 for rate in (24, 30, 60, 120)),
)
_MIN_DIGITS = 3  # decimals that a frame time needs to identify a usual rate
_MAX_DIGITS = 12  # digits in a number of frames, and decimals of a frame time that are compared
_BLOCK = 1 << 20  # letters that are parsed at once
_MAX_NUMBER = 1 << 16  # letters of a number
_MAX_SHOWN = 40  # letters of a word in a message
_MAX_VALUE = 1e7  # value of a channel: ten kilometres in millimetres


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


def read_bvh(path: str | os.PathLike, fps: float | None = None) -> Bvh:
    """Read a BVH file of any exporter: any letter case, white space, order of rotations, positions on any joint.

    Memory stays within a few times the size of the file, whatever its header declares. The frame rate is `fps`, or by
    default the one of the file.

    Raises:
        UserError: the file is not BVH, is cut off, or has invalid values; the message names the line, or the frame and
            the channel.
    """
    path = pathlib.Path(path)
    check_regular(path, _EXPECTED)
    # Names may be in any encoding; escaping keeps different names different.
    with reading(path, _EXPECTED), path.open(encoding="utf-8-sig", errors="backslashreplace") as file:
        return _Reader(path, file, fps).read()


class _Reader:
    """Reader of one open file, word by word, which counts lines for error messages."""

    def __init__(self, path: pathlib.Path, file: TextIO, fps: float | None):
        self._path, self._file, self._fps = path, file, fps
        self._line, self._num_letters, self._in_motion = 0, 0, False
        self._words: Iterator[str] = iter(())
        self._joints: dict[str, int] = {}  # name: parent
        self._offsets: dict[int, list[float]] = {}
        self._channels: dict[int, tuple[str, ...]] = {}

    def read(self) -> Bvh:
        if self._word().upper() != "HIERARCHY":
            raise self._error("it does not begin with HIERARCHY, so it is not a BVH file")
        self._read_hierarchy()
        if missing := [name for index, name in enumerate(self._joints) if index not in self._offsets]:
            raise self._error(f"joint {short(missing[0])} has no OFFSET")
        channels = tuple(self._channels.get(joint, ()) for joint in range(len(self._joints)))
        names = [f"{channel} of {joint}" for joint, own in zip(self._joints, channels, strict=True) for channel in own]
        if not names:
            raise self._error("it has no CHANNELS, so it has no motion")
        frames, fps = self._read_motion_header()
        if frames * len(names) > limits.MAX_BVH_VALUES:
            raise self._error(
                f"{frames} frames of {len(names)} channels, expected at most {limits.MAX_BVH_VALUES:,} numbers: "
                "cut the file"
            )
        motion = read_values(self._path, self._file, " ".join(self._words), frames, names)
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
                raise self._error(f"found {short(word)}, expected ROOT, JOINT, OFFSET, CHANNELS, End Site or MOTION")
        if open_joints or not self._joints:
            raise self._error("MOTION begins before the skeleton is complete")

    def _add(self, name: str, parent: int) -> int:
        if name in self._joints:
            raise self._error(f"a second joint {short(name)}, expected unique names and no cycles")
        if len(name) > limits.MAX_JOINT_NAME:
            raise self._error(
                f"a joint with a name of {len(name)} characters, expected at most {limits.MAX_JOINT_NAME}"
            )
        if len(self._joints) == limits.MAX_MOTION_JOINTS:
            raise self._error(f"more than {limits.MAX_MOTION_JOINTS} joints, expected the skeleton of a person")
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
        if (value := to_number(word)) is None:
            raise self._error(f"OFFSET with {short(word)}, expected three numbers")
        return value

    def _channel_names(self) -> tuple[str, ...]:
        count = self._word()
        if count not in map(str, range(limits.MAX_JOINT_CHANNELS + 1)):
            raise self._error(f"CHANNELS {short(count)}, expected 0 to {limits.MAX_JOINT_CHANNELS}")
        found = [self._word() for _ in range(int(count))]
        names = tuple(_CHANNELS.get(name.lower(), "") for name in found)
        if "" in names or len(set(names)) < len(names):
            raise self._error(f"channels {short(' '.join(found))}, expected different ones of Xposition to Zrotation")
        return names

    def _read_motion_header(self) -> tuple[int, float]:
        self._in_motion = True
        self._words = iter(" ".join(self._words).replace(":", " ").split())
        count = self._value_of("FRAMES")
        is_number = count.isascii() and count.isdigit() and len(count) <= _MAX_DIGITS
        if not is_number or not 1 <= int(count) <= limits.MAX_BVH_FRAMES:
            raise self._error(f"Frames: {short(count)}, expected a whole number from 1 to {limits.MAX_BVH_FRAMES:,}")
        text = self._value_of("FRAME", "TIME")
        frame_time = to_number(text)
        if self._fps is not None:
            return int(count), self._fps
        if frame_time is None or not 1 / limits.MAX_MOTION_FPS <= frame_time <= 1 / limits.MIN_MOTION_FPS:
            raise self._error(
                f"Frame Time: {short(text)}, expected seconds, such as 0.0333333 for 30 frames a second, from "
                f"{1 / limits.MAX_MOTION_FPS:g} to {1 / limits.MIN_MOTION_FPS:g}, or the true rate by --source-fps"
            )
        return int(count), _frame_rate(text, frame_time)

    def _value_of(self, *words: str) -> str:
        for expected in words:
            if (word := self._word()).upper() != expected:
                raise self._error(f"found {short(word)} after MOTION, expected Frames: and Frame Time:")
        return self._word()

    def _word(self) -> str:
        while (word := next(self._words, None)) is None:
            line = self._file.readline(_MAX_LINE)
            self._line += 1
            self._num_letters += len(line)
            if not line:
                raise self._error("the file ends here, expected more of the skeleton or the motion")
            if len(line) == _MAX_LINE:
                raise self._error(f"a line of {_MAX_LINE} characters or more, so it is not a BVH file")
            if self._num_letters > limits.MAX_BVH_HEADER or self._line > limits.MAX_BVH_LINES:
                raise self._error(
                    f"more than {limits.MAX_BVH_LINES} lines or {limits.MAX_BVH_HEADER} characters before the motion: "
                    "it is not BVH"
                )
            if self._in_motion:
                line = line.replace(":", " ")
            self._words = iter(line.replace("{", " { ").replace("}", " } ").split())
        return word

    def _error(self, found: str) -> UserError:
        return UserError(f"{shown(self._path)}, line {self._line}: {found}; export the motion again")


def _frame_rate(text: str, frame_time: float) -> float:
    """Return the frames per second: a usual rate, whole if possible, whose frame time is the stated one when it is
    rounded or cut to as many decimals; where there is none, 1 / frame time.
    """
    mantissa, _, exponent = text.lower().lstrip("+").partition("e")
    digits = len(mantissa.partition(".")[2]) - int(exponent or 0)  # decimals
    if not mantissa.replace(".", "").isdigit() or digits < _MIN_DIGITS:
        return 1 / frame_time
    units = 10.0 ** min(digits, _MAX_DIGITS)
    stated = round(frame_time * units)
    alike = [rate for rate in USUAL_RATES if stated in (round(units / rate), int(units / rate))]
    return min(alike, key=lambda rate: (rate != int(rate), abs(1 / rate - frame_time)), default=1 / frame_time)


def read_values(path: pathlib.Path, file: TextIO, begin: str, frames: int, names: Sequence[str]) -> np.ndarray:
    """Read the values (frames, channels) of all channels in all frames; values beyond them are ignored.

    They are read in blocks, so that memory depends on the size of the file alone; `begin` is the text of the motion
    that was read already, and the names are those of the channels.

    Raises:
        UserError: the file has fewer values, or one that is not a number or too large.
    """
    wanted, found = frames * len(names), 0
    parts: list[np.ndarray] = []
    for block in _blocks(path, file, begin):
        words = block[: wanted - found]
        parts.append(_numbers(path, words, found, names))
        found += len(words)
        if found == wanted:
            return np.concatenate(parts).reshape(frames, len(names))
    raise UserError(
        f"{shown(path)} is cut off: it holds {found // len(names)} whole frames of {len(names)} values, but its "
        f"header declares {frames}; export it again"
    )


def _blocks(path: pathlib.Path, file: TextIO, begin: str) -> Iterator[list[str]]:
    """Yield the words of the motion, some thousands at a time."""
    rest = f"{begin} "
    while block := file.read(_BLOCK):
        text = rest + block
        words = text.split()
        # The last word may continue in the next block.
        rest = words.pop() if words and not text[-1].isspace() else ""
        if len(rest) > _MAX_NUMBER:
            raise UserError(
                f"{shown(path)} has a word of more than {_MAX_NUMBER} characters, expected numbers; export it again"
            )
        yield words
    yield rest.split()


def _numbers(path: pathlib.Path, words: list[str], found: int, names: Sequence[str]) -> np.ndarray:
    try:
        # Word by word: an array of text would give each word the space of the longest.
        values = np.fromiter(map(float, words), float, len(words))
    except ValueError:
        values = np.array([to_number(word) for word in words], float)  # None becomes NaN
    is_bad = ~(np.abs(values) <= _MAX_VALUE)
    if is_bad.any():
        index = int(np.argmax(is_bad))
        frame, column = divmod(found + index, len(names))
        raise UserError(
            f"{shown(path)}: {names[column]} in frame {frame + 1} is {short(words[index])}, expected a number; "
            "export the motion again"
        )
    return values


def to_number(word: str) -> float | None:
    """Parse a number; None if the word is not a number, not finite, or too large for a motion."""
    try:
        value = float(word)
    except ValueError:
        return None
    return value if abs(value) <= _MAX_VALUE else None


def short(text: str) -> str:
    """Return a word of the file in quotes, cut if it is long."""
    return repr(text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "...")

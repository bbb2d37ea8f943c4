"""All thresholds and choices of the import of videos (HA2G, Appendix A), as one value."""

import dataclasses
import math
import pathlib
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any

from ha2g_jax.data.recording import MAX_SECONDS, MOCAP, WindowFilters
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, read_json, shown
from ha2g_jax.limits import MAX_SETTINGS_BYTES

_EXPECTED = 'settings in JSON, such as {"min_seconds": 3}'


@dataclasses.dataclass(frozen=True)
class VideoSettings:
    """Settings of the import of videos; the defaults are those of the paper where it gives a number.

    Attributes:
        fps: frames per second of the clips.
        shot_threshold: change between images that starts a new shot, in units of PySceneDetect's content detector.
        min_seconds: length in seconds that a shot must exceed (condition 3 of the paper).
        min_visible: fraction of a shot's images in which all keypoints are seen that must be exceeded (condition 1).
        min_confidence: minimum confidence of a keypoint that counts as seen.
        min_motion: minimum variance of a wrist's position over the shot, in square metres; if both wrists are below
            it, the speaker is almost still (condition 2; the paper gives no number, this is that of the TED filters).
        max_gap: longest time for which an unseen keypoint is interpolated, in seconds.
        cutoff: frequency above which motion is filtered out as jitter, in hertz.
        max_seconds: maximum length of a clip in seconds; longer shots are cut at their longest pauses.
        num_reference_frames: number of images of the speaker kept for each clip, from its start; 0 for none.
        image_size: width and height of these images in pixels.
        recognise: Whisper model for the words of videos without a transcript, None to require a transcript.
        pose_command: command line of another pose estimator, with {video} and {out} in it; None for the one that
            `ha2g data build-video --install` installs.
        filters: conditions that a window of a clip must fulfil.

    Raises:
        UserError: a value is of the wrong type or out of range.
    """

    fps: float = 15.0
    shot_threshold: float = 27.0
    min_seconds: float = 5.0
    min_visible: float = 0.5
    min_confidence: float = 0.5
    min_motion: float = 0.0014
    max_gap: float = 0.5
    cutoff: float = 5.0
    max_seconds: float = MAX_SECONDS
    num_reference_frames: int = 7
    image_size: int = 224
    recognise: str | None = None
    pose_command: str | None = None
    filters: WindowFilters = MOCAP

    def __post_init__(self) -> None:
        for name, value in self._flat().items():
            checked = _checked(name, value)
            if "." not in name:
                object.__setattr__(self, name, checked)
        for name, (low, high) in _RANGES.items():
            if not low <= getattr(self, name) <= high:
                raise UserError(f"setting {name} is {getattr(self, name):g}; expected {low:g} to {high:g}")
        if not all(1 <= number <= _MAX_WINDOW for number in (self.filters.num_frames, self.filters.stride)):
            raise UserError(
                f"settings filters.num_frames and filters.stride must be at least 1 and at most {_MAX_WINDOW}"
            )

    def as_json(self) -> dict[str, Any]:
        """Return the values by name, ready for JSON; `filters` is a nested mapping."""
        return {**dataclasses.asdict(self), "filters": self.filters._asdict()}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "VideoSettings":
        """Make settings of a mapping such as `as_json` returns; missing values keep their defaults.

        Raises:
            UserError: a name is unknown, or a value is of the wrong type or out of range.
        """
        filters = values.get("filters", {})
        if not isinstance(filters, Mapping):
            raise UserError(f'setting filters is {_short(filters)}; expected names and values: {{"min_words": 2}}')
        flat = {name: value for name, value in values.items() if name != "filters"}
        return cls().replaced(flat | {f"filters.{name}": value for name, value in filters.items()})

    def replaced(self, values: Mapping[str, Any]) -> "VideoSettings":
        """Replace values by name; those of filters have names such as "filters.min_words".

        Raises:
            UserError: a name is unknown, or a value is of the wrong type or out of range.
        """
        if unknown := sorted(set(values) - set(_TYPES)):
            group = "filters." if unknown[0].startswith("filters.") else ""
            names = [name for name in _TYPES if name.startswith("filters.") == bool(group)]
            raise UserError(f"unknown setting {_short(unknown[0])}; expected one of {', '.join(names)}")
        changes = {name: value for name, value in values.items() if "." not in name}
        filters = {name.removeprefix("filters."): value for name, value in values.items() if "." in name}
        return dataclasses.replace(self, **changes, filters=self.filters._replace(**filters))

    def _flat(self) -> dict[str, Any]:
        values = {name: getattr(self, name) for name in _TYPES if "." not in name}
        return values | {f"filters.{name}": value for name, value in self.filters._asdict().items()}


def _types(of: type, prefix: str = "") -> dict[str, tuple[type, ...]]:
    """Return the types that each setting may have by name."""
    hints = {prefix + name: hint for name, hint in typing.get_type_hints(of).items() if name != "filters"}
    return {name: typing.get_args(hint) or (hint,) for name, hint in hints.items()}


_TYPES = _types(VideoSettings) | _types(WindowFilters, "filters.")
_MAX_WINDOW = 10_000  # frames of a window

# Inclusive bounds, wide enough for any recording and narrow enough to catch a wrong unit.
_RANGES = {
    "fps": (1, 120),
    "shot_threshold": (0.1, 255),
    "min_seconds": (0, 3600),
    "min_visible": (0, 1),
    "min_confidence": (0, 1),
    "min_motion": (0, 10),
    "max_gap": (0, 60),
    "cutoff": (0.1, 60),
    "max_seconds": (2, 600),
    "num_reference_frames": (0, 16),
    "image_size": (32, 1024),
}


def read_settings(path: str | pathlib.Path) -> VideoSettings:
    """Read settings from a JSON file.

    Args:
        path: path of the file.

    Raises:
        UserError: the file is missing, is not JSON, or has an unknown name or a wrong value.
    """
    check_regular(path, _EXPECTED)
    values = read_json(path, _EXPECTED, MAX_SETTINGS_BYTES)
    if not isinstance(values, dict):
        raise UserError(f"{shown(path)} has a {type(values).__name__}; expected {_EXPECTED}")
    try:
        return VideoSettings.from_json(values)
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error


def from_pairs(pairs: Iterable[str], base: VideoSettings | None = None) -> VideoSettings:
    """Replace some values of settings by those of the command line.

    Args:
        pairs: NAME=VALUE pairs such as "min_seconds=3", "recognise=tiny.en" or "filters.min_words=none".
        base: settings of the other values; None for the defaults.

    Raises:
        UserError: a pair has no "=", a name is unknown, or a value is of the wrong type or out of range.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition("="))
        if not equals:
            raise UserError(f"setting {_short(pair)} has no value; write NAME=VALUE, such as min_seconds=3")
        if name == "filters":
            raise UserError("setting filters is a group; write filters.NAME=VALUE, such as filters.min_words=2")
        values[name] = _parsed(name, text)
    return (base or VideoSettings()).replaced(values)


def _checked(name: str, value: Any) -> Any:
    allowed = _TYPES[name]
    if float in allowed and isinstance(value, int) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            value = math.inf
    is_finite = not isinstance(value, float) or math.isfinite(value)
    if isinstance(value, bool) or not isinstance(value, allowed) or not is_finite:
        raise UserError(f"setting {name} is {_short(value)}; expected {_expected(allowed)}")
    return value


def _parsed(name: str, text: str) -> Any:
    """Parse the text of a value; that of an unknown name is kept, and the name is refused later."""
    allowed = _TYPES.get(name, ())
    if types.NoneType in allowed and text.lower() == "none":
        return None
    for kind in (int, float):
        if kind in allowed:
            try:
                return kind(text)
            except ValueError:
                raise UserError(f"setting {name} is {_short(text)}; expected {_expected(allowed)}") from None
    return text


def _short(value: Any) -> str:
    """Return a value as text of at most 60 letters, as a settings file or the command line would have it."""
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**60 else "a number of more than 60 digits"
    return text if len(text) <= 60 else f"{text[:60]}..."


def _expected(allowed: tuple[type, ...]) -> str:
    names = {int: "a whole number", float: "a number", str: "a text", types.NoneType: "none"}
    return " or ".join(names.get(kind, kind.__name__) for kind in allowed)

"""All thresholds and choices of the import of videos (HA2G, Appendix A), as one value."""

import contextlib
import dataclasses
import pathlib
import reprlib
from collections.abc import Iterable, Mapping
from typing import Any

from ha2g_jax.config.ranges import TEXT, Range, number, whole
from ha2g_jax.data.recording import MAX_SECONDS, MOCAP, WindowFilters
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, naming, read_json, shown
from ha2g_jax.limits import MAX_SETTINGS_BYTES

_EXPECTED = 'settings in JSON, such as {"min_seconds": 3}'


def _or_none(values: Range) -> Range:
    return Range(f"{values.expected} or none", lambda value: value is None or values.contains(value))


# Wide enough for any recording and narrow enough to catch a wrong unit.
_RANGES = {
    "fps": number(1, 120),
    "shot_threshold": number(0.1, 255),
    "min_seconds": number(0, 3600),
    "min_visible": number(0, 1),
    "min_confidence": number(0, 1),
    "min_motion": number(0, 10),
    "max_gap": number(0, 60),
    "cutoff": number(0.1, 60),
    "max_seconds": number(2, 600),
    "num_reference_frames": whole(0, 16),
    "image_size": whole(32, 1024),
    "recognise": _or_none(TEXT),
    "pose_command": _or_none(TEXT),
    "filters.min_words": _or_none(whole(0)),
    "filters.min_pose_distance": _or_none(number(0)),
    "filters.max_spine_angle": _or_none(number(0, 180)),
    "filters.max_mean_spine_angle": _or_none(number(0, 180)),
    "filters.min_wrist_variance": _or_none(number(0)),
    "filters.num_frames": whole(1, 10_000),
    "filters.stride": whole(1, 10_000),
}
_TEXTS = ("recognise", "pose_command")


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
        UserError: a value is not one of those that the setting may have.
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
        for name, values in _RANGES.items():
            is_filter, field = name.startswith("filters."), name.removeprefix("filters.")
            value = getattr(self.filters if is_filter else self, field)
            if not values.contains(value):
                raise UserError(f"setting {name} is {reprlib.repr(value)}; expected {values.expected}")
            default = WindowFilters._field_defaults[field] if is_filter else getattr(VideoSettings, field)
            if isinstance(value, int) and isinstance(default, float):
                number: Any = float(value)
                changed = self.filters._replace(**{field: number}) if is_filter else number
                object.__setattr__(self, "filters" if is_filter else field, changed)

    def as_json(self) -> dict[str, Any]:
        """Return the values by name, ready for JSON; `filters` is a nested mapping."""
        return {**dataclasses.asdict(self), "filters": self.filters._asdict()}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "VideoSettings":
        """Make settings of a mapping such as `as_json` returns; missing values keep their defaults.

        Raises:
            UserError: a name is unknown, or a value is not one of those that the setting may have.
        """
        filters = values.get("filters", {})
        if not isinstance(filters, Mapping):
            raise UserError(
                f'setting filters is {reprlib.repr(filters)}; expected names and values: {{"min_words": 2}}'
            )
        flat = {name: value for name, value in values.items() if name != "filters"}
        return cls().replaced(flat | {f"filters.{name}": value for name, value in filters.items()})

    def replaced(self, values: Mapping[str, Any]) -> "VideoSettings":
        """Replace values by name; those of filters have names such as "filters.min_words".

        Raises:
            UserError: a name is unknown, or a value is not one of those that the setting may have.
        """
        if unknown := sorted(set(values) - set(_RANGES)):
            raise UserError(f"unknown setting {reprlib.repr(unknown[0])}; expected one of {', '.join(_RANGES)}")
        changes = {name: value for name, value in values.items() if "." not in name}
        filters = {name.removeprefix("filters."): value for name, value in values.items() if "." in name}
        return dataclasses.replace(self, **changes, filters=self.filters._replace(**filters))


def read_settings(path: str | pathlib.Path) -> VideoSettings:
    """Read settings from a JSON file.

    Raises:
        UserError: the file is missing, is not JSON, or has an unknown name or a wrong value.
    """
    check_regular(path, _EXPECTED)
    values = read_json(path, _EXPECTED, MAX_SETTINGS_BYTES)
    if not isinstance(values, dict):
        raise UserError(f"{shown(path)} has a {type(values).__name__}; expected {_EXPECTED}")
    with naming(path):
        return VideoSettings.from_json(values)


def from_pairs(pairs: Iterable[str], base: VideoSettings | None = None) -> VideoSettings:
    """Replace some values of settings, by default the defaults, by pairs NAME=VALUE such as "filters.min_words=none".

    Raises:
        UserError: a pair has no "=", a name is unknown, or a value is not one of those that the setting may have.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition("="))
        if not equals:
            raise UserError(f"setting {reprlib.repr(pair)} has no value; write NAME=VALUE, such as min_seconds=3")
        values[name] = _parsed(text, is_text=name in _TEXTS)
    return (base or VideoSettings()).replaced(values)


def _parsed(text: str, *, is_text: bool) -> Any:
    if text.lower() == "none":
        return None
    for kind in () if is_text else (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text

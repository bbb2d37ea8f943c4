"""All controls of a motion as one value, and their parsing from text."""

import dataclasses
import itertools
import math
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError, check_number
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.motion.control.parts import SIDES
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import sample
from ha2g_jax.skeleton import Skeleton

MOST = 2.0  # largest energy and extent
_MAX_SECONDS = 1e6  # latest end of a span, which may be after the motion


class Pin(NamedTuple):
    """A pose that the motion holds from `start` to `end` in seconds, or passes through where the two are equal.

    Attributes:
        pose: (bones, 3) unit vectors; None for the rest pose.
        name: name of the pose for the record of the controls.
        skeleton: name of the skeleton of the pose, "" where it is not known.
        path: file that the pose was read from.
    """

    start: float
    end: float
    pose: np.ndarray | None = None
    name: str = "rest"
    skeleton: str = ""
    path: pathlib.Path | None = None


class Span(NamedTuple):
    """A span of time in seconds."""

    start: float
    end: float


@dataclasses.dataclass(frozen=True)
class Controls:
    """Controls of a motion; the default values are neutral.

    Attributes:
        energy: factor of the movement about the slow mean pose, 0 to 2.
        extent: factor of the distance of the wrists from their rest position, 0 to 2.
        handedness: "left" or "right" for gestures with that arm only, or "both".
        mirror: whether to exchange left and right, before all other controls.
        pins: poses to hold or to pass through.
        mutes: spans of time without gestures.
    """

    energy: float = 1.0
    extent: float = 1.0
    handedness: str = "both"
    mirror: bool = False
    pins: tuple[Pin, ...] = ()
    mutes: tuple[Span, ...] = ()


NEUTRAL = Controls()


def check(controls: Controls, skeleton: Skeleton, duration: float = math.inf) -> None:
    """Check controls before they are applied to a motion of some seconds.

    Raises:
        UserError: the value is not of type `Controls`, or an amount, a side, a pose or a span is not valid.
    """
    if not isinstance(controls, Controls):
        raise UserError(f"the controls are {controls!r}; give Controls, such as Controls(energy=0.5)")
    for name, amount in (("energy", controls.energy), ("extent", controls.extent)):
        message = f"the {name} is {amount}; expected 0 to {MOST:g}, 1 for the unchanged motion"
        check_number(amount, 0, MOST, message)
    if controls.handedness not in (*SIDES, "both"):
        raise UserError(f"the handedness is {controls.handedness!r}; expected left, right or both")
    _check_spans("pin", controls.pins, duration)
    _check_spans("mute", controls.mutes, duration)
    for pinned in controls.pins:
        if pinned.skeleton not in ("", skeleton.name):
            raise UserError(
                f"the pose {pinned.name} has the skeleton {pinned.skeleton}, the motion has {skeleton.name}; give "
                "a pose of the motion's skeleton"
            )
        pose = pinned.pose
        if pose is not None and not (
            pose.shape == (skeleton.num_bones, 3) and np.isfinite(pose).all() and np.linalg.norm(pose, axis=-1).all()
        ):
            raise UserError(
                f"the pose {pinned.name} has the shape {pose.shape}, or vectors that are not finite or 0; expected "
                f"({skeleton.num_bones}, 3) of {skeleton.name}"
            )


def _check_spans(name: str, spans: Sequence[Pin | Span], duration: float) -> None:
    for span in spans:
        if not 0 <= span.start <= span.end <= _MAX_SECONDS:
            raise UserError(
                f"a {name} from {span.start:g} to {span.end:g} s; expected 0 <= start <= end <= {_MAX_SECONDS:g}"
            )
        if span.start > duration:
            raise UserError(
                f"a {name} at {span.start:g} s, after the end of the motion at {duration:g} s; give a time in it"
            )
    for first, second in itertools.pairwise(sorted(spans, key=lambda span: span[:2])):
        if second.start < first.end or second[:2] == first[:2]:
            raise UserError(
                f"a {name} from {first.start:g} to {first.end:g} s overlaps the one at {second.start:g} s; "
                "make them one, or move one"
            )


def describe(controls: Controls) -> dict[str, Any]:
    """Return the controls that are not neutral as JSON values, by name."""
    changed: dict[str, Any] = {
        name: getattr(controls, name)
        for name in ("energy", "extent", "handedness", "mirror")
        if getattr(controls, name) != getattr(NEUTRAL, name)
    }
    if controls.pins:
        changed["pins"] = [{"start": pin.start, "end": pin.end, "pose": pin.name} for pin in controls.pins]
    if controls.mutes:
        changed["mutes"] = [{"start": mute.start, "end": mute.end} for mute in controls.mutes]
    return changed


def read_pin(text: str) -> Pin:
    """Parse a pin from START:END:POSE.

    START and END are seconds; POSE is "rest", MOTION.npz for the first pose of a motion, or MOTION.npz@SECONDS for a
    pose at another time.

    Raises:
        UserError: the text has another form, or there is no such motion.
    """
    start, end, pose = _split(text, 3, "START:END:POSE, such as 2:3.5:wave.npz@1.2 or 2:3.5:rest")
    moments = _seconds(start, text), _seconds(end, text)
    if pose == "rest":
        return Pin(*moments)
    path, moment = pathlib.Path(pose), 0.0
    with reading(pose, "a motion of `ha2g generate`"):
        if not path.is_file() and "@" in pose:
            name, _, at = pose.rpartition("@")
            path, moment = pathlib.Path(name), _seconds(at, text)
    motion = Motion.load(path)
    last = (motion.num_frames - 1) / motion.fps
    if not 0 <= moment <= last:
        raise UserError(f"{shown(path)} has no pose at {moment:g} s; expected 0 to {last:.3f}")
    (posed,) = sample(motion.directions, np.array([moment * motion.fps]))
    return Pin(*moments, posed, f"{shown(path.name)}@{moment:g}", motion.meta["skeleton"], path)


def read_mute(text: str) -> Span:
    """Parse a span from START:END in seconds; another form is a UserError."""
    start, end = _split(text, 2, "START:END in seconds, such as 2:3.5")
    return Span(_seconds(start, text), _seconds(end, text))


def _split(text: str, count: int, expected: str) -> list[str]:
    parts = text.split(":", count - 1)
    if len(parts) != count or not all(parts):
        raise UserError(f"{shown(text)!r} has another form; expected {expected}")
    return parts


def _seconds(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise UserError(f"{shown(text)!r} in {shown(whole)!r} is not a time; give seconds") from error

"""All controls of a motion as one value, and their application."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.control import effects
from ha2g_jax.motion.control.parts import SIDES
from ha2g_jax.motion.control.spans import Pin, Span
from ha2g_jax.skeleton import Skeleton

MOST = 2.0  # largest energy and extent


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

_MAX_SECONDS = 1e6  # of a span, which may end after the motion


def apply(skeleton: Skeleton, directions: np.ndarray, fps: float, controls: Controls) -> np.ndarray:
    """Apply controls to a motion: mirror, then scale, then hold the poses of pins and mutes.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) float32 unit vectors.
        fps: frames per second; frame k shows the time k / fps.
        controls: controls to apply.

    Returns:
        (T, bones, 3) float32 unit vectors; the input itself for neutral controls.

    Raises:
        UserError: an amount, a side, a pose or a span is not valid.
    """
    check(controls, skeleton, (len(directions) + 0.5) / fps)  # the longest duration that rounds to so many frames
    directions = effects.mirror(skeleton, directions, controls.mirror)
    directions = effects.energy(skeleton, directions, fps, controls.energy)
    directions = effects.extent(skeleton, directions, controls.extent)
    directions = effects.handedness(skeleton, directions, controls.handedness)
    directions = effects.pin(skeleton, directions, fps, controls.pins)
    return effects.mute(skeleton, directions, fps, controls.mutes)


def check(controls: Controls, skeleton: Skeleton, duration: float = math.inf) -> None:
    """Check controls before they are applied.

    Args:
        controls: controls to check.
        skeleton: skeleton of the motion.
        duration: length of the motion in seconds.

    Raises:
        UserError: an amount, a side, a pose or a span is not valid.
    """
    for name, amount in (("energy", controls.energy), ("extent", controls.extent)):
        if not (math.isfinite(amount) and 0 <= amount <= MOST):
            raise UserError(f"the {name} is {amount}; expected 0 to {MOST:g}, 1 for the unchanged motion")
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
        if pose is not None and not (pose.shape == (skeleton.num_bones, 3) and np.isfinite(pose).all()):
            raise UserError(
                f"the pose {pinned.name} has the shape {pose.shape}, or numbers that are not finite; expected "
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
    """Return the controls that are not neutral as JSON values, by name.

    Args:
        controls: controls to describe.
    """
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

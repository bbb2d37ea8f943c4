"""All controls as one value, and what they do to a motion."""

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

MOST = 2.0  # of energy and extent


@dataclasses.dataclass(frozen=True)
class Controls:
    """What is asked of a motion; by default nothing.

    Attributes:
        energy: scales movement about the slow mean pose, 0 to 2.
        extent: scales the reach of the arms about their rest, 0 to 2.
        handedness: "left" or "right" for gestures with that arm alone, or "both".
        mirror: whether left and right change places; before all the others.
        pins: poses to hold or to pass through.
        mutes: spans without gestures.
    """

    energy: float = 1.0
    extent: float = 1.0
    handedness: str = "both"
    mirror: bool = False
    pins: tuple[Pin, ...] = ()
    mutes: tuple[Span, ...] = ()


NEUTRAL = Controls()


def apply(skeleton: Skeleton, directions: np.ndarray, fps: float, controls: Controls) -> np.ndarray:
    """The motion under control: mirrored, then scaled, then held where it is pinned or muted.

    Args:
        skeleton: of the directions.
        directions: (T, bones, 3) float32 unit vectors.
        fps: frames per second; frame k shows the time k / fps.
        controls: what is asked.

    Returns:
        (T, bones, 3) float32 unit vectors; the very input for neutral controls.

    Raises:
        UserError: an amount, a side, a pose or a span that cannot be used.
    """
    check(controls, skeleton, (len(directions) + 0.5) / fps)  # of what rounds to so many frames
    directions = effects.mirror(skeleton, directions, controls.mirror)
    directions = effects.energy(skeleton, directions, fps, controls.energy)
    directions = effects.extent(skeleton, directions, controls.extent)
    directions = effects.handedness(skeleton, directions, controls.handedness)
    directions = effects.pin(skeleton, directions, fps, controls.pins)
    return effects.mute(skeleton, directions, fps, controls.mutes)


def check(controls: Controls, skeleton: Skeleton, duration: float = math.inf) -> None:
    """Raises UserError for controls that cannot be used on a motion of `duration` seconds."""
    for name, amount in (("energy", controls.energy), ("extent", controls.extent)):
        if not (math.isfinite(amount) and 0 <= amount <= MOST):
            raise UserError(f"an {name} of {amount}; expected 0 to {MOST:g}, 1 for the motion as it is")
    if controls.handedness not in (*SIDES, "both"):
        raise UserError(f"handedness {controls.handedness!r}; expected left, right or both")
    _check_spans("pin", controls.pins, duration)
    _check_spans("mute", controls.mutes, duration)
    for pinned in controls.pins:
        if pinned.skeleton not in ("", skeleton.name):
            raise UserError(
                f"the pose {pinned.name} is of the skeleton {pinned.skeleton}, the motion of {skeleton.name}; give "
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
        if not (math.isfinite(span.end) and 0 <= span.start <= span.end):
            raise UserError(f"a {name} from {span.start:g} to {span.end:g} s; expected 0 <= start <= end")
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
    """The controls that are not neutral, as values for JSON."""
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

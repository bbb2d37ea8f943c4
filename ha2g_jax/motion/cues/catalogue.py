"""The gestures that a cue can request, as data: keyframes of the limbs that each uses, built for any skeleton.

A gesture is a table of a few keyframes. Arms take poses, given by the position of the wrist and the shape of the hand;
head, spine and shoulders turn on top of the motion. Time 0 is the peak of the stroke.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax import anatomy
from ha2g_jax.motion.control.parts import HEAD, SIDES, Part, arm_parts, bones_of, parts
from ha2g_jax.skeleton import Skeleton, load_skeleton

_HANDS = {**anatomy.HAND_SHAPES, "index": (0.75, 0.0, 1.0, 1.0, 1.0), "soft": (0.15, 0.12, 0.16, 0.2, 0.22)}
_HOLD = 0.95  # weight after the peak, so that a limb still moves a little with the speech
_STRAIGHT = 0.995  # distance of the wrist of a straight arm, in lengths of the arm
_DECIMALS = 4  # decimals in the JSON form


class Keyframes(NamedTuple):
    """A gesture of a skeleton; times are in seconds from its peak.

    Attributes:
        weight_times, weights: (W,) times, and how far the gesture replaces the motion: 0 at both ends, 1 at the peak.
        times: (K,) times of the keyframes, between which limbs move by minimum jerk.
        poses: unit vectors (K, bones, 3) of the bones of a limb of `limbs`, by its name.
        turns: rotation vectors (K, 3) in radians that are added to the motion of a limb, by its name.
    """

    weight_times: np.ndarray
    weights: np.ndarray
    times: np.ndarray
    poses: dict[str, np.ndarray]
    turns: dict[str, np.ndarray]

    @classmethod
    def of_motion(
        cls, skeleton: Skeleton, times: np.ndarray, directions: np.ndarray, weight_times: np.ndarray
    ) -> "Keyframes":
        """Build the gesture that shows a motion (K, bones, 3) with the whole body, with weights at five times."""
        poses = {limb: directions[:, bones_of(of_limb)] for limb, of_limb in limbs(skeleton).items()}
        return cls(weight_times, np.array([0.0, 1.0, 1.0, 1.0, 0.0]), times, poses, {})


class _Arm(NamedTuple):
    """A pose of an arm.

    Attributes:
        wrist: position relative to the shoulder, in metres outward, up and forward.
        hand: shape of the hand, one of `_HANDS`.
        pronation, extension, deviation, swivel: degrees, see `anatomy.ARM_LIMITS` and `anatomy.reach`.
    """

    wrist: tuple[float, float, float]
    hand: str
    pronation: float = 80
    extension: float = 0
    deviation: float = 0
    swivel: float = 20


class _Key(NamedTuple):
    """A keyframe: an arm, where the gesture has one, and turns by the name of the limb.

    Turns are in degrees about the axes x (forward), y (to the right) and z (tilted to the left).
    """

    arm: _Arm | None
    turns: dict[str, tuple[float, float, float]]


class _Entry(NamedTuple):
    """A gesture of the table: its keys by their times, when it begins and ends, and its arms.

    Arms are "one", the right one unless the cue names the left one, "both", a side, or "" for none.
    """

    arms: str
    start: float
    end: float
    keys: dict[float, _Key]


def _head(pitch: float = 0, yaw: float = 0) -> _Key:
    return _Key(None, {"head": (pitch, yaw, 0.0)})


def _hold(arms: str, arm: _Arm | None, seconds: float = 0.6, **turns: tuple[float, float, float]) -> _Entry:
    """Return a gesture that arrives at a pose and holds it."""
    return _Entry(arms, -0.5, seconds + 0.65, {0.0: _Key(arm, turns), seconds: _Key(arm, turns)})


def _count(hand: str) -> _Entry:
    return _hold("one", _Arm((0.16, -0.06, 0.30), hand, 85, 5))


def _waving(outward: float, deviation: float) -> _Key:
    return _Key(_Arm((outward, 0.02, 0.28), "open", 85, 8, deviation, 25), {})


_BENT = (22.0, 0.0, 0.0)
_RAISED, _UP = _Arm((0.10, 0.02, 0.34), "index", 80), _Arm((0.09, 0.65, 0.31), "index", -75, 5)
_ENTRIES = {
    "nod": _Entry("", -0.28, 0.75, {0.0: _head(16), 0.22: _head(-3), 0.42: _head(8), 0.68: _head()}),
    "shake": _Entry(
        "", -0.26, 1.1, {0.0: _head(0, 15), 0.25: _head(0, -12), 0.5: _head(0, 10), 0.74: _head(0, -5), 1.0: _head()}
    ),
    "bow": _hold("", None, 0.3, spine=_BENT, head=(36.0, 0.0, 0.0)),
    "shrug": _hold(
        "both",
        _Arm((0.24, -0.34, 0.24), "soft", -60, 18, 0, 8),
        0.35,
        head=(0.0, 0.0, 7.0),
        left_shoulder=(0.0, 0.0, -14.0),
        right_shoulder=(0.0, 0.0, 14.0),
    ),
    "point:left": _hold("left", _Arm((0.67, 0.02, 0.26), "index", 75), head=(0.0, -14.0, 0.0)),
    "point:right": _hold("right", _Arm((0.67, 0.02, 0.26), "index", 75), head=(0.0, 14.0, 0.0)),
    "point:up": _Entry(  # the arm rises in front of the body
        "one",
        -0.85,
        1.5,
        {-0.38: _Key(_RAISED, {}), 0.0: _Key(_UP, {}), 0.6: _Key(_UP, {}), 0.98: _Key(_RAISED, {})},
    ),
    "point:front": _hold("one", _Arm((0.02, -0.06, 0.73), "index")),
    "point:self": _hold("one", _Arm((-0.05, -0.15, 0.24), "index", -10, -60, 15, 50)),
    **{
        f"count:{number}": _count(hand)
        for number, hand in enumerate(("one", "two", "three", "negation", "open"), start=1)
    },
    "wave": _Entry(
        "one",
        -0.75,
        1.55,
        {
            -0.25: _waving(0.11, -18),
            0.0: _waving(0.23, 16),
            0.25: _waving(0.12, -18),
            0.5: _waving(0.22, 15),
            0.75: _waving(0.13, -14),
            1.0: _waving(0.20, 10),
        },
    ),
    "open": _hold("both", _Arm((0.30, -0.24, 0.32), "soft", -50, 15)),
    "small": _hold("one", _Arm((0.04, -0.10, 0.36), "small", 20)),
    "stop": _hold("one", _Arm((0.10, -0.06, 0.50), "open", 85, 58)),
    "thumb": _hold("one", _Arm((0.08, -0.16, 0.42), "approve", 0)),
}
_ONE_ARMED = tuple(name for name, entry in _ENTRIES.items() if entry.arms == "one")
GESTURES = tuple(_ENTRIES)
"""Gestures without their left-handed forms."""
NAMES = (*GESTURES, *(f"{name}:left" for name in _ONE_ARMED))
"""All gestures; those of one arm use the right one without `:left`."""


@functools.cache
def limbs(skeleton: Skeleton) -> dict[str, tuple[Part, ...]]:
    """Return the parts of head, spine, shoulders and arms, which cues use one by one."""
    every = parts(skeleton)
    children = [skeleton.joints[child] for _, child in skeleton.bones]
    named = {
        name: children.index(joint) for name, joint in (("spine", "neck"), *((f"{it}_shoulder",) * 2 for it in SIDES))
    }
    return {
        "head": tuple(part for part in every if part.kind == HEAD),
        **{name: tuple(part for part in every if part.bones == (bone,)) for name, bone in named.items()},
        **{f"{side}_arm": arm_parts(skeleton, side) for side in SIDES},
    }


@functools.cache
def keyframes(skeleton: Skeleton, name: str) -> Keyframes:
    """Build a gesture of `NAMES` for a skeleton; without fingers, its arms end at the wrists."""
    is_left = name not in _ENTRIES
    entry = _ENTRIES[name.removesuffix(":left") if is_left else name]
    sides = {"": (), "both": SIDES, "one": ("left",) if is_left else ("right",)}.get(entry.arms, (entry.arms,))
    times = np.array(list(entry.keys))
    keys = list(entry.keys.values())
    axes = np.array([skeleton.left, 1.0, skeleton.left])
    moved = list(dict.fromkeys(limb for key in keys for limb in key.turns))
    turns = {limb: np.deg2rad([key.turns[limb] for key in keys]) * axes for limb in moved}
    arms = [key.arm for key in keys if key.arm is not None]
    poses = {f"{side}_arm": _arm_poses(skeleton, arms, side) * axes for side in sides}
    weight_times = [entry.start, *sorted({times[0], 0.0, times[-1]}), entry.end]
    weights = [0.0, *(_HOLD if time > 0 else 1.0 for time in weight_times[1:-1]), 0.0]
    return Keyframes(np.array(weight_times), np.array(weights), times, poses, turns)


def _arm_poses(skeleton: Skeleton, arms: list[_Arm], side: str) -> np.ndarray:
    """Return the bones (K, bones, 3) of an arm of a skeleton, in the axes of TED-Expressive."""
    full = load_skeleton("ted_expressive")
    count = len(arms)
    angles = np.zeros((count, 2, len(anatomy.ARM_LIMITS)))
    wrists, swivels = np.array([arm.wrist for arm in arms]), np.array([arm.swivel for arm in arms])
    angles[..., :4] = anatomy.reach(full, wrists, swivels, _STRAIGHT)[:, None]
    angles[..., 4:] = np.array([(arm.pronation, arm.extension, arm.deviation) for arm in arms])[:, None]
    fingers = np.repeat(np.array([_HANDS[arm.hand] for arm in arms])[:, None], 2, axis=1)
    still = np.zeros((count, 3))
    body = anatomy.Body(still, still, np.zeros((count, 2)), angles, fingers, np.full((count, 2), 16.0))
    directions = anatomy.body_directions(full, body)
    bones = bones_of(limbs(skeleton)[f"{side}_arm"])
    return directions[:, [full.bone(skeleton.joints[skeleton.bones[bone][1]]) for bone in bones]]


def describe_catalogue(skeleton: Skeleton) -> dict[str, Any]:
    """Return all gestures of a skeleton as JSON values, for a page that blends them itself.

    Returns:
        "limbs", the bones of each limb by its name, and "cues", the fields of `Keyframes` of each gesture by its name.
    """

    def values(field: Any) -> Any:
        if isinstance(field, dict):
            return {limb: values(array) for limb, array in field.items()}
        return np.round(field, _DECIMALS).tolist()

    bones = {limb: bones_of(of_limb) for limb, of_limb in limbs(skeleton).items()}
    gestures = {name: keyframes(skeleton, name)._asdict() for name in NAMES}
    described = {name: {key: values(field) for key, field in keys.items()} for name, keys in gestures.items()}
    return {"limbs": bones, "cues": described}

"""Limits of the joints to the range of a human body; the ranges and their sources are in assets/joint_limits.json."""

import functools
import importlib.resources
import json

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import FOUR_FINGERS, Armature

Range = tuple[float, float]

# Names of the two angles of the swing and of the twist, with their axes of rotation for a left limb and for the head.
_LIMB = {"forward": (0.0, -1.0, 0.0), "up": (0.0, 0.0, 1.0), "twist": (1.0, 0.0, 0.0)}
_HEAD = {"pitch": (1.0, 0.0, 0.0), "roll": (0.0, 0.0, -1.0), "yaw": (0.0, 1.0, 0.0)}

# Other bones swing about axes of their parent. A hand is twisted first and then bends about axes that rotate with the
# forearm: the axis to the thumb, about which it bends up and down, stays nearly at right angles to the forearm.
_WRIST = "XYZ"
_NEARLY_REVERSED = np.deg2rad(150)  # beyond this twist the limited twist is reduced, to 0 at 180 degrees
_FASTEST = np.deg2rad(80)  # change from one frame to the next, between the ends of a range
_MIRROR = np.array([1.0, -1.0, -1.0, 1.0])  # signs of a rotation in the mirror that exchanges left and right


@functools.cache
def joint_limits() -> dict[str, dict[str, Range]]:
    """Return the lowest and highest value in degrees of each limited angle, by the name of a joint without its side."""
    file = importlib.resources.files("ha2g_jax") / "assets" / "joint_limits.json"
    table = json.loads(file.read_text(encoding="utf-8"))
    noise = table["noise"]
    joints: dict[str, dict[str, Range]] = {}
    for name, limits in table["joints"].items():
        ends = {angle: (0, limit) if angle == "angle" else limit for angle, limit in limits.items()}
        joints[name] = {angle: (low - noise, high + noise) for angle, (low, high) in ends.items()}
    return joints


def limits_of(joint: str) -> dict[str, Range]:
    """Return the limits in degrees of a joint of the armature by angle, empty for a joint without limits."""
    name = joint.removeprefix("left_").removeprefix("right_")
    if name == "nose_0":  # rotates the head, where the skeleton has another joint of that name
        name = "head"
    finger, _, part = name.partition("_")
    return joint_limits().get(f"finger_{part}" if finger in FOUR_FINGERS else name, {})


def clamp(armature: Armature, local: np.ndarray) -> np.ndarray:
    """Clamp the rotations (T, J, 4) of joints relative to their parents to their limits, each on its own."""
    clamped = local.copy()
    for name, joints in _alike(armature.joints):
        clamped[:, joints] = _clamp(name, local[:, joints].reshape(-1, 4)).reshape(len(local), len(joints), 4)
    return clamped


@functools.lru_cache(maxsize=16)
def _alike(joints: tuple[str, ...]) -> tuple[tuple[str, list[int]], ...]:
    """Group the joints that have the same limits, as the fingers of a hand; each group has the name of its first."""
    groups: dict[tuple[bool, tuple], list[int]] = {}
    for index, name in enumerate(joints):
        if limits := limits_of(name):
            groups.setdefault((name.startswith("right_"), tuple(limits.items())), []).append(index)
    return tuple((joints[group[0]], group) for group in groups.values())


def _clamp(name: str, local: np.ndarray) -> np.ndarray:
    """Clamp rotations (n, 4) of a joint, or of joints that have the same limits."""
    limits, angles = limits_of(name), joint_angles(name, local)
    low, high = np.deg2rad([limits.get(angle, (-np.inf, np.inf)) for angle in angles]).T
    found = np.stack(list(angles.values()), axis=-1)
    kept = _reduce_near_reversal(found, np.clip(found, low, high))
    is_out = (found != kept).any(axis=-1)
    if not is_out.any():
        return local
    clamped = local.copy()
    if "angle" in limits:
        fraction = kept[is_out, 0] / found[is_out, 0]
        clamped[is_out] = rotations.slerp(rotations.IDENTITY, local[is_out], fraction)
    else:
        clamped[is_out] = from_angles(name, kept[is_out])
    return clamped


def without_jumps(local: np.ndarray, clamped: np.ndarray) -> np.ndarray:
    """Limit the speed of clamped rotations from one end of a range to the other to 80 degrees per frame.

    A joint outside of its range may be near to both ends and so be clamped to one in one frame and to the other in the
    next. Between the ends the result may be outside of the range. Where the joint itself is faster, so is the result.
    Rotations are (T, J, 4) relative to the parents.
    """
    most = np.maximum(rotations.angle_between(local[1:], local[:-1]), _FASTEST)
    slowed = clamped.copy()
    for first, joint in np.argwhere(rotations.angle_between(clamped[1:], clamped[:-1]) > most):
        for frame in range(first, len(most)):
            step = float(rotations.angle_between(slowed[frame + 1, joint], slowed[frame, joint]))
            if step <= most[frame, joint]:
                break
            fraction = most[frame, joint] / step
            slowed[frame + 1, joint] = rotations.slerp(slowed[frame, joint], slowed[frame + 1, joint], fraction)
    return slowed


def _reduce_near_reversal(found: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Reduce the twist, the last of clamped angles (T, n), near 180 degrees, beyond which the other end is nearer."""
    weight = np.clip((np.pi - np.abs(found[:, -1])) / (np.pi - _NEARLY_REVERSED), 0, 1)
    reduced = kept.copy()
    reduced[:, -1] *= np.where(found[:, -1] == kept[:, -1], 1, weight)
    return reduced


def joint_angles(joint: str, local: np.ndarray) -> dict[str, np.ndarray]:
    """Split rotations (T, 4) of a joint into (T,) angles in radians, by their name in the table of limits."""
    if "angle" in limits_of(joint):
        return {"angle": np.linalg.norm(rotations.to_vector(local), axis=-1)}
    axes = _axes(joint)
    first, second, along = (np.array(axis) for axis in axes.values())
    seen = _as_left(joint, local)
    if joint.endswith("wrist"):
        twist, back, up = np.deg2rad(rotations.to_euler(seen, _WRIST)).T
        return dict(zip(axes, (-back, up, twist), strict=True))
    swing, _ = rotations.split_twist(seen, along)
    vector = rotations.to_vector(swing)
    return dict(zip(axes, (vector @ first, vector @ second, rotations.twist_angle(seen, along)), strict=True))


def from_angles(joint: str, angles: np.ndarray) -> np.ndarray:
    """Return the rotations (T, 4) with given angles (T, 3) in radians, the inverse of `joint_angles`."""
    if joint.endswith("wrist"):
        forward, up, twist = np.rad2deg(angles).T
        return _as_left(joint, rotations.from_euler(np.stack([twist, -forward, up], axis=-1), _WRIST))
    first, second, along = (np.array(axis) for axis in _axes(joint).values())
    swing = rotations.from_vector(angles[:, :1] * first + angles[:, 1:2] * second)
    return _as_left(joint, rotations.multiply(swing, rotations.about(along, angles[:, 2])))


def _axes(joint: str) -> dict[str, tuple[float, float, float]]:
    return _LIMB if joint.startswith(("left_", "right_")) else _HEAD


def _as_left(joint: str, local: np.ndarray) -> np.ndarray:
    """Mirror rotations (T, 4) of a right joint to those of a left one, or back; leave those of others unchanged."""
    return local * _MIRROR if joint.startswith("right_") else local

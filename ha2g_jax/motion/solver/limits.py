"""Keeps every joint within the range of a body's; the ranges and their sources are in assets/joint_limits.json."""

import functools
import importlib.resources
import json

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import FOUR_FINGERS, Armature

Range = tuple[float, float]

# Names of the two angles of the swing and of the twist, and the vectors about which a left limb, or the head, turns.
_LIMB = {"forward": (0.0, -1.0, 0.0), "up": (0.0, 0.0, 1.0), "twist": (1.0, 0.0, 0.0)}
_HEAD = {"bow": (1.0, 0.0, 0.0), "tip": (0.0, 0.0, -1.0), "turn": (0.0, 1.0, 0.0)}

# Other bones swing about axes of their parent's. A hand bends last, about axes that turn with the forearm: its axis to
# the thumb, about which it goes up and down, stays nearly at right angles to the forearm, see `arms`.
_WRIST = "XYZ"
_TURNING = np.deg2rad(150)
_FASTEST = np.deg2rad(80)  # from one frame to the next, between the ends of a range
_MIRROR = np.array([1.0, -1.0, -1.0, 1.0])  # a rotation seen in the mirror that exchanges left and right


@functools.cache
def joint_limits() -> dict[str, dict[str, Range]]:
    """Lowest and highest value in degrees of each limited angle, by the name of a joint without its side."""
    file = importlib.resources.files("ha2g_jax") / "assets" / "joint_limits.json"
    table = json.loads(file.read_text(encoding="utf-8"))
    noise = table["noise"]
    joints: dict[str, dict[str, Range]] = {}
    for name, limits in table["joints"].items():
        ends = {angle: (0, limit) if angle == "angle" else limit for angle, limit in limits.items()}
        joints[name] = {angle: (low - noise, high + noise) for angle, (low, high) in ends.items()}
    return joints


def limits_of(joint: str) -> dict[str, Range]:
    """Limits of a joint of the armature, empty where it has none."""
    name = joint.removeprefix("left_").removeprefix("right_")
    if name == "nose_0":  # the head of a skeleton that calls another joint so
        name = "head"
    finger, _, part = name.partition("_")
    return joint_limits().get(f"finger_{part}" if finger in FOUR_FINGERS else name, {})


def clamp(armature: Armature, local: np.ndarray) -> np.ndarray:
    """Rotations (T, J, 4) relative to the parents, each within its limits; one that is so already stays as it is.

    Each joint is clamped on its own, and what hangs on it turns with it.
    """
    clamped = local.copy()
    for joint, name in enumerate(armature.joints):
        if not (limits := limits_of(name)):
            continue
        angles = joint_angles(name, local[:, joint])
        low, high = np.deg2rad([limits.get(angle, (-np.inf, np.inf)) for angle in angles]).T
        found = np.stack(list(angles.values()), axis=-1)
        kept = _turn_back(found, np.clip(found, low, high))
        is_out = (found != kept).any(axis=-1)
        if "angle" in limits:
            share = kept[is_out, 0] / found[is_out, 0]
            clamped[is_out, joint] = rotations.slerp(rotations.IDENTITY, local[is_out, joint], share)
        else:
            clamped[is_out, joint] = from_angles(name, kept[is_out])
    return clamped


def without_jumps(local: np.ndarray, clamped: np.ndarray) -> np.ndarray:
    """Clamped rotations (T, J, 4) that go from one end of a range to the other no faster than 80 degrees a frame.

    A joint out of its range may be near to both ends, and be held now at one, now at the other. On the way it may be
    out of its range; where the joint itself turns faster, by `local`, so may the clamped one.
    """
    most = np.maximum(rotations.angle_between(local[1:], local[:-1]), _FASTEST)
    slowed = clamped.copy()
    for first, joint in np.argwhere(rotations.angle_between(clamped[1:], clamped[:-1]) > most):
        for frame in range(first, len(most)):
            step = float(rotations.angle_between(slowed[frame + 1, joint], slowed[frame, joint]))
            if step <= most[frame, joint]:
                break
            share = most[frame, joint] / step
            slowed[frame + 1, joint] = rotations.slerp(slowed[frame, joint], slowed[frame + 1, joint], share)
    return slowed


def _turn_back(found: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Angles (T, n) kept within limits, the last, a twist, made smaller where it comes near half a turn.

    Beyond half a turn the other end of the range is nearer, and on the way there a joint must not jump from end to end.
    """
    share = np.clip((np.pi - np.abs(found[:, -1])) / (np.pi - _TURNING), 0, 1)
    turned = kept.copy()
    turned[:, -1] *= np.where(found[:, -1] == kept[:, -1], 1, share)
    return turned


def joint_angles(joint: str, local: np.ndarray) -> dict[str, np.ndarray]:
    """The angles of a joint's rotations (T, 4) by their names in the table, (T,) radians each."""
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
    """The rotations (T, 4) of a joint with angles (T, 3) in radians, in the order of `joint_angles`."""
    if joint.endswith("wrist"):
        forward, up, twist = np.rad2deg(angles).T
        return _as_left(joint, rotations.from_euler(np.stack([twist, -forward, up], axis=-1), _WRIST))
    first, second, along = (np.array(axis) for axis in _axes(joint).values())
    swing = rotations.from_vector(angles[:, :1] * first + angles[:, 1:2] * second)
    return _as_left(joint, rotations.multiply(swing, rotations.about(along, angles[:, 2])))


def _axes(joint: str) -> dict[str, tuple[float, float, float]]:
    return _LIMB if joint.startswith(("left_", "right_")) else _HEAD


def _as_left(joint: str, local: np.ndarray) -> np.ndarray:
    """Rotations (T, 4) of a right joint as those of a left one, or back; those of others as they are."""
    return local * _MIRROR if joint.startswith("right_") else local

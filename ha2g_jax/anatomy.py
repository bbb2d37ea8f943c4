"""A body of TED-Expressive as joint angles of trunk, head, arms and fingers; hand shapes; forward kinematics.

The right arm is computed as a left one and mirrored. Within the trunk, x is outward, y down; the person faces -z.
"""

import itertools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ha2g_jax import skeleton as skeletons
from ha2g_jax.skeleton import FINGERS

# Flexion of thumb, index, middle, ring and pinky: 0 straight, 1 closed. Any two differ by 0.7 or more (Euclidean).
HAND_SHAPES: dict[str, tuple[float, float, float, float, float]] = {
    "one": (0.9, 0.0, 1.0, 1.0, 1.0),
    "two": (0.9, 0.0, 0.0, 1.0, 1.0),
    "three": (0.9, 0.0, 0.0, 0.0, 1.0),
    "open": (0.0, 0.0, 0.0, 0.0, 0.0),
    "small": (0.6, 0.65, 0.1, 0.1, 0.1),
    "point": (0.0, 0.0, 1.0, 1.0, 1.0),
    "fist": (1.0, 1.0, 1.0, 1.0, 1.0),
    "round": (0.6, 0.62, 0.62, 0.62, 0.62),
    "negation": (1.0, 0.0, 0.0, 0.0, 0.0),
    "approve": (0.0, 1.0, 1.0, 1.0, 1.0),
}

# Degrees. Flexion forward and abduction sideways of the upper arm, its outward rotation about its own length,
# elbow flexion, forearm pronation (0 thumb up, 90 palm down), wrist extension, wrist bend towards the thumb.
ARM_LIMITS = {
    "flexion": (-60.0, 110.0),
    "abduction": (-25.0, 85.0),
    "rotation": (-90.0, 70.0),
    "elbow": (8.0, 145.0),
    "pronation": (-75.0, 88.0),
    "extension": (-60.0, 60.0),
    "deviation": (-25.0, 20.0),
}
# Degrees. Pitch is positive when bowing forward, yaw when turning to the left, roll when tipping to the left.
TRUNK_LIMITS = (15.0, 15.0, 12.0)
HEAD_LIMITS = (25.0, 35.0, 20.0)
SHRUG_LIMIT = 12.0
SPREAD_LIMITS = (4.0, 30.0)

# Degrees at full flexion of the knuckle and of the joint after it, for each finger of `FINGERS`. The values make
# a half-closed hand bend like the published means (index 23 and 50 degrees, pinky 47 and 30).
FINGER_BEND = np.array([(40.0, 55.0), (58.0, 117.0), (82.0, 94.0), (86.0, 88.0), (98.0, 66.0)])

_NEAREST_WRIST = 0.28  # metres from the shoulder
_ELBOW_POLE = np.array([0.0, 0.75, 0.65])  # direction in which an elbow hangs from the line from shoulder to wrist

# Azimuth in the palm (towards the thumb) and palmar drop of each metacarpal, degrees, chosen so that neighbouring
# bones meet at the published angles.
_METACARPALS = np.array([(40.5, 11.0), (13.6, 0.0), (0.0, 0.0), (-14.6, 0.0), (-27.7, 0.0)])


class Body(NamedTuple):
    """Joint angles over T frames, in degrees; the last axis of `arms` follows `ARM_LIMITS`.

    Attributes:
        trunk: (T, 3) pitch, yaw, roll.
        head: (T, 3) pitch, yaw, roll, on top of the trunk.
        shrug: (T, 2) lift of the left and right shoulder.
        arms: (T, 2, 7) left and right arm.
        fingers: (T, 2, 5) flexion of thumb to pinky, 0 straight and 1 closed.
        spread: (T, 2) angle between index and little finger where both are straight.
    """

    trunk: np.ndarray
    head: np.ndarray
    shrug: np.ndarray
    arms: np.ndarray
    fingers: np.ndarray
    spread: np.ndarray


def within_limits(body: Body) -> Body:
    """Clip every angle of a body to its anatomical limits."""
    low, high = np.array(list(ARM_LIMITS.values())).T
    return Body(
        np.clip(body.trunk, -np.array(TRUNK_LIMITS), TRUNK_LIMITS),
        np.clip(body.head, -np.array(HEAD_LIMITS), HEAD_LIMITS),
        np.clip(body.shrug, -SHRUG_LIMIT, SHRUG_LIMIT),
        np.clip(body.arms, low, high),
        np.clip(body.fingers, 0, 1),
        np.clip(body.spread, *SPREAD_LIMITS),
    )


def body_directions(skeleton: skeletons.Skeleton, body: Body) -> np.ndarray:
    """Compute the unit direction vectors (T, 42, 3) of a body of TED-Expressive by forward kinematics, in float64."""
    neutral = _neutral_directions(skeleton)
    directions = np.zeros((len(body.trunk), skeleton.num_bones, 3))
    trunk = _rotation(body.trunk)
    directions[:, skeleton.bone("neck")] = trunk @ neutral[skeleton.bone("neck")]
    head = trunk @ _rotation(body.head)
    for child in ("nose", "right_eye", "left_eye", "right_ear", "left_ear"):
        directions[:, skeleton.bone(child)] = head @ neutral[skeleton.bone(child)]
    for side, name in enumerate(("left", "right")):
        mirror = np.array([1.0 if side == 0 else -1.0, 1.0, 1.0])
        shoulder = neutral[skeleton.bone("left_shoulder")]
        raised = _perpendicular(np.array([0.0, -1.0, 0.0]), shoulder)
        parts = {"shoulder": _between(shoulder[None], raised[None], np.deg2rad(body.shrug[:, side]))}
        upper, fore, hand = _arm_frames(np.deg2rad(body.arms[:, side]))
        parts |= {"elbow": upper, "wrist": fore} | _finger_directions(hand, body.fingers[:, side], body.spread[:, side])
        for child, vectors in parts.items():
            rotated = np.einsum("tij,tj->ti", trunk, vectors * mirror)
            directions[:, skeleton.bone(f"{name}_{child}")] = rotated
    return directions


def reach(skeleton: skeletons.Skeleton, wrists: np.ndarray, swivel: np.ndarray, farthest: float = 0.98) -> np.ndarray:
    """Find the arm angles that put the wrist at given points: (T, 4) flexion, abduction, rotation, elbow in degrees.

    Args:
        wrists: (T, 3) positions of the wrist of the left arm relative to the shoulder, in metres outward, up and
            forward; a point out of reach is moved along its direction into reach.
        swivel: (T,) rotation of the elbow about the line from shoulder to wrist, in degrees; 0 is down and back,
            positive is outward.
        farthest: largest distance of the wrist from the shoulder, as a multiple of the length of the arm.
    """
    upper_length = float(skeleton.lengths[skeleton.bone("left_elbow")])
    fore_length = float(skeleton.lengths[skeleton.bone("left_wrist")])
    target = wrists * np.array([1.0, -1.0, -1.0])
    length = np.linalg.norm(target, axis=-1, keepdims=True)
    distance = -at_least(-at_least(length, _NEAREST_WRIST), -farthest * (upper_length + fore_length))
    axis = target / length
    cosine = (upper_length**2 + distance**2 - fore_length**2) / (2 * upper_length * distance)
    below = _perpendicular(_ELBOW_POLE, axis)
    outward = np.cross(axis, below)
    side = _between(below, outward, np.deg2rad(swivel))
    upper = cosine * axis + np.sqrt(1 - cosine**2) * side
    fore = (axis * distance - upper_length * upper) / fore_length
    flexion = np.arctan2(-upper[:, 2], upper[:, 1])
    abduction = np.arcsin(np.clip(upper[:, 0], -1, 1))
    _, forward, sideways = _upper_arm(flexion, abduction)
    rotation = np.arctan2(np.sum(fore * sideways, axis=-1), np.sum(fore * forward, axis=-1))
    elbow = np.arccos(np.clip(np.sum(upper * fore, axis=-1), -1, 1))
    return np.rad2deg(np.stack([flexion, abduction, rotation, elbow], axis=-1))


def at_least(values: np.ndarray, least: npt.ArrayLike) -> np.ndarray:
    """Return the larger of each value in metres and a bound, with a rounded corner of two centimetres."""
    above = values - least
    return least + np.where(np.abs(above) < 0.02, (above + 0.02) ** 2 / 0.08, np.maximum(above, 0))


def finger_flexions(skeleton: skeletons.Skeleton, directions: np.ndarray) -> np.ndarray:
    """Measure the flexion (..., 2, 5) of the fingers, left hand first, of directions (..., bones, 3): 0 straight, 1
    closed.

    The inverse of `body_directions`: the sum of the angles at the two joints of a finger over the sum of their full
    ranges. At the knuckle a finger bends out of the plane of the metacarpals of index and little finger; fingers that
    are spread are not bent.
    """
    unit = skeletons.normalize(directions)
    flexions = np.zeros((*directions.shape[:-2], 2, len(FINGERS)), directions.dtype)
    for side, name in enumerate(("left", "right")):
        index, little, along = (
            unit[..., skeleton.bone(f"{name}_{finger}_1"), :] for finger in ("index", "pinky", "middle")
        )
        palm = skeletons.normalize(np.cross(little, index) if side == 0 else np.cross(index, little))
        for finger, finger_name in enumerate(FINGERS):
            bones = [unit[..., skeleton.bone(f"{name}_{finger_name}_{part}"), :] for part in (1, 2, 3)]
            knuckle, middle = (_angle(a, b) for a, b in itertools.pairwise(bones))
            if finger_name != "thumb":
                down, ahead = (np.sum(bones[1] * axis, axis=-1) for axis in (palm, along))
                knuckle = np.arcsin(np.clip(down, 0, 1))
                knuckle = np.where(ahead < 0, np.pi - knuckle, knuckle)
            flexions[..., side, finger] = np.rad2deg(knuckle + middle) / FINGER_BEND[finger].sum()
    return flexions


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip(np.sum(first * second, axis=-1), -1, 1))


def _neutral_directions(skeleton: skeletons.Skeleton) -> np.ndarray:
    """Return the published mean directions, made symmetric and of unit length."""
    mean = skeleton.mean_directions.astype(np.float64)
    return skeletons.normalize(mean + skeletons.mirror_directions(skeleton, mean))


def _arm_frames(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return upper arm and forearm (T, 3), and the hand's axes (T, 3, 3): along it, to the thumb, to its back."""
    flexion, abduction, rotation, elbow, pronation, extension, deviation = angles.T
    upper, forward, sideways = _upper_arm(flexion, abduction)
    bend = _between(forward, sideways, rotation)
    fore, thumb = _between(upper, bend, elbow), _between(bend, -upper, elbow)
    back = np.cross(thumb, fore)
    thumb, back = _between(thumb, -back, pronation), _between(back, thumb, pronation)
    along, back = _between(fore, back, extension), _between(back, -fore, extension)
    along, thumb = _between(along, thumb, deviation), _between(thumb, -along, deviation)
    return upper, fore, np.stack([along, thumb, back], axis=1)


def _upper_arm(flexion, abduction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the upper arm and the two directions at right angles to it in which the forearm bends."""
    upper = [np.sin(abduction), np.cos(abduction) * np.cos(flexion), -np.cos(abduction) * np.sin(flexion)]
    forward = [0 * flexion, -np.sin(flexion), -np.cos(flexion)]
    outward = [np.cos(abduction), -np.sin(abduction) * np.cos(flexion), np.sin(abduction) * np.sin(flexion)]
    return np.stack(upper, axis=-1), np.stack(forward, axis=-1), np.stack(outward, axis=-1)


def _between(first: np.ndarray, second: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotate `first` (T, 3) by `angle` (T,) towards `second`, which is at right angles to it."""
    return np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second


def _finger_directions(hand: np.ndarray, flexions: np.ndarray, spread: np.ndarray) -> dict[str, np.ndarray]:
    """Return the directions (T, 3) of the three bones of each finger of one hand from its axes, its flexions (T, 5) and
    the angle (T,) between index and little finger.
    """
    parts = {}
    share = np.deg2rad(spread) / np.deg2rad(_METACARPALS[1, 0] - _METACARPALS[4, 0])
    for finger, name in enumerate(FINGERS):
        azimuth, drop = np.deg2rad(_METACARPALS[finger])
        local = np.array([np.cos(drop) * np.cos(azimuth), np.cos(drop) * np.sin(azimuth), -np.sin(drop)])
        # A finger is nearer to the middle finger than its metacarpal is, and curls into the palm; the thumb continues
        # its metacarpal, and also swings across the palm.
        if name == "thumb":
            straight, curl = local[None], _perpendicular(np.array([0.0, -0.8, -0.6]), local)
        else:
            own = share * azimuth
            straight, curl = np.stack([np.cos(own), np.sin(own), 0 * own], axis=-1), np.array([0.0, 0.0, -1.0])
        knuckle, middle = (np.deg2rad(bend) * flexions[:, finger] for bend in FINGER_BEND[finger])
        vectors = (local[None], _between(straight, curl, knuckle), _between(straight, curl, knuckle + middle))
        for part, vector in enumerate(vectors):
            parts[f"{name}_{part + 1}"] = np.einsum("ta,tai->ti", np.broadcast_to(vector, (len(hand), 3)), hand)
    return parts


def _rotation(angles: np.ndarray) -> np.ndarray:
    """Return rotation matrices (T, 3, 3) of pitch, yaw and roll (T, 3) in degrees."""
    pitch, yaw, roll = np.deg2rad(angles).T
    return axis_rotation(1, -yaw) @ axis_rotation(0, pitch) @ axis_rotation(2, roll)


def axis_rotation(axis: int, angle: np.ndarray) -> np.ndarray:
    """Build rotation matrices (T, 3, 3) about axis 0, 1 or 2 (x, y or z) by angles (T,) in radians."""
    matrix = np.tile(np.eye(3), (len(angle), 1, 1))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[:, first, first] = matrix[:, second, second] = np.cos(angle)
    matrix[:, first, second], matrix[:, second, first] = -np.sin(angle), np.sin(angle)
    return matrix


def _perpendicular(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the part of a vector (3,) at right angles to unit axes (..., 3), scaled to unit length."""
    rest = vector - np.sum(vector * axis, axis=-1, keepdims=True) * axis
    return rest / np.linalg.norm(rest, axis=-1, keepdims=True)

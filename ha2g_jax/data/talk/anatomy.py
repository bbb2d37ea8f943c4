"""The body of the Talk corpus: joint angles of trunk, head, arms and fingers, and forward kinematics.

The right arm is computed as a left one and mirrored. Within the trunk, x is outward, y down; the person faces -z.
"""

import itertools
from typing import NamedTuple

import numpy as np

from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import lexicon

# Degrees. Flexion forward and abduction sideways of the upper arm, its outward rotation about its own length,
# elbow flexion, forearm pronation (0 thumb up, 90 palm down), wrist extension, wrist bend towards the thumb.
ARM_LIMITS = {
    "flexion": (-35.0, 110.0),
    "abduction": (0.0, 85.0),
    "rotation": (-65.0, 60.0),
    "elbow": (8.0, 145.0),
    "pronation": (-75.0, 88.0),
    "extension": (-60.0, 60.0),
    "deviation": (-25.0, 20.0),
}
# Degrees. Pitch is positive when bowing forward, yaw when turning to the left, roll when tipping to the left.
TRUNK_LIMITS = (15.0, 15.0, 12.0)
HEAD_LIMITS = (25.0, 35.0, 20.0)
SHRUG_LIMIT = 12.0

# Degrees at full flexion of the knuckle and of the joint after it, for each finger of the lexicon. The values make
# a half-closed hand bend like the published means (index 23 and 50 degrees, pinky 47 and 30).
FINGER_BEND = np.array([(40.0, 55.0), (58.0, 117.0), (82.0, 94.0), (86.0, 88.0), (98.0, 66.0)])

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
    """

    trunk: np.ndarray
    head: np.ndarray
    shrug: np.ndarray
    arms: np.ndarray
    fingers: np.ndarray


def within_limits(body: Body) -> Body:
    """Clip every angle of a body to its anatomical limits."""
    low, high = np.array(list(ARM_LIMITS.values())).T
    return Body(
        np.clip(body.trunk, -np.array(TRUNK_LIMITS), TRUNK_LIMITS),
        np.clip(body.head, -np.array(HEAD_LIMITS), HEAD_LIMITS),
        np.clip(body.shrug, -SHRUG_LIMIT, SHRUG_LIMIT),
        np.clip(body.arms, low, high),
        np.clip(body.fingers, 0, 1),
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
        parts |= {"elbow": upper, "wrist": fore} | _finger_directions(hand, body.fingers[:, side])
        for child, vectors in parts.items():
            rotated = np.einsum("tij,tj->ti", trunk, vectors * mirror)
            directions[:, skeleton.bone(f"{name}_{child}")] = rotated
    return directions


def reach(skeleton: skeletons.Skeleton, wrist: tuple[float, float, float], swivel: float) -> np.ndarray:
    """Find the arm angles that put the wrist at a point: (4,) flexion, abduction, rotation and elbow in degrees.

    Args:
        wrist: position of the wrist of the left arm relative to the shoulder, in metres outward, up and forward; a
            point out of reach is moved along its direction into reach.
        swivel: rotation of the elbow about the line from shoulder to wrist, in degrees; 0 is straight below the line,
            positive is outward.
    """
    upper_length = float(skeleton.lengths[skeleton.bone("left_elbow")])
    fore_length = float(skeleton.lengths[skeleton.bone("left_wrist")])
    target = np.array([wrist[0], -wrist[1], -wrist[2]])
    distance = np.clip(np.linalg.norm(target), 0.2, 0.99 * (upper_length + fore_length))
    axis = target / np.linalg.norm(target)
    target = axis * distance
    cosine = (upper_length**2 + distance**2 - fore_length**2) / (2 * upper_length * distance)
    below = _perpendicular(np.array([0.0, 1.0, 0.0]), axis)
    outward = _perpendicular(np.array([1.0, 0.0, 0.0]), axis)
    outward = _perpendicular(outward, below)
    angle = np.deg2rad(swivel)
    side = np.cos(angle) * below + np.sin(angle) * outward
    upper = cosine * axis + np.sqrt(1 - cosine**2) * side
    fore = (target - upper_length * upper) / fore_length
    flexion = np.arctan2(-upper[2], upper[1])
    abduction = np.arcsin(np.clip(upper[0], -1, 1))
    _, forward, sideways = _upper_arm(flexion, abduction)
    bend = _perpendicular(fore, upper)
    rotation = np.arctan2(bend @ sideways, bend @ forward)
    elbow = np.arccos(np.clip(upper @ fore, -1, 1))
    return np.rad2deg([flexion, abduction, rotation, elbow])


def finger_flexions(skeleton: skeletons.Skeleton, directions: np.ndarray) -> np.ndarray:
    """Measure the flexion (..., 2, 5) of the fingers, left hand first, of directions (..., bones, 3): 0 straight, 1
    closed.

    The inverse of `body_directions`: the sum of the angles at the two joints of a finger over the sum of their full
    ranges.
    """
    unit = skeletons.normalize(directions)
    flexions = np.zeros((*directions.shape[:-2], 2, len(lexicon.FINGERS)), directions.dtype)
    for side, name in enumerate(("left", "right")):
        for finger, finger_name in enumerate(lexicon.FINGERS):
            bones = [unit[..., skeleton.bone(f"{name}_{finger_name}_{part}"), :] for part in (1, 2, 3)]
            cosines = [np.sum(a * b, axis=-1) for a, b in itertools.pairwise(bones)]
            bend = sum(np.arccos(np.clip(cosine, -1, 1)) for cosine in cosines)
            flexions[..., side, finger] = np.rad2deg(bend) / FINGER_BEND[finger].sum()
    return flexions


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


def _finger_directions(hand: np.ndarray, flexions: np.ndarray) -> dict[str, np.ndarray]:
    """Return the directions (T, 3) of the three bones of each finger of one hand from its axes and flexions (T, 5)."""
    parts = {}
    for finger, name in enumerate(lexicon.FINGERS):
        azimuth, drop = np.deg2rad(_METACARPALS[finger])
        local = np.array([np.cos(drop) * np.cos(azimuth), np.cos(drop) * np.sin(azimuth), -np.sin(drop)])
        # A finger curls into the palm; the thumb also swings across it.
        curl = np.array([0.0, -0.8, -0.6]) if name == "thumb" else np.array([0.0, 0.0, -1.0])
        curl = _perpendicular(curl, local)
        knuckle, middle = (np.deg2rad(bend) * flexions[:, finger] for bend in FINGER_BEND[finger])
        for part, angle in enumerate((np.zeros_like(knuckle), knuckle, knuckle + middle)):
            vectors = _between(local[None], curl[None], angle)
            parts[f"{name}_{part + 1}"] = np.einsum("ta,tai->ti", vectors, hand)
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
    """Return the part of a vector (3,) at right angles to a unit axis (3,), scaled to unit length."""
    rest = vector - (vector @ axis) * axis
    return rest / np.linalg.norm(rest)

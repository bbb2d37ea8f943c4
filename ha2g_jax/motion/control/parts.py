"""Division of a skeleton into parts, from the trunk to the finger bones, and scaling of the rotations of parts.

The rotation of each part is relative to the part it is attached to: that of the forearm to the upper arm, that of the
hand to the forearm. So a pose with scaled rotations still has a hand of the right shape on its arm; if the direction of
each bone were scaled on its own, the hand would come apart. Directions are (T, bones, 3) unit vectors; the parts to
scale include those that they are attached to, and other parts stay.
"""

import functools
from typing import NamedTuple

import numpy as np

from ha2g_jax.motion.rotations import (
    IDENTITY,
    about,
    between,
    conjugate,
    cross,
    fit,
    multiply,
    perpendicular,
    rotate,
    unit,
)
from ha2g_jax.motion.smoothing import slow_mean
from ha2g_jax.skeleton import Skeleton, mirror_directions, normalize

SIDES = ("left", "right")
TRUNK, HEAD, UPPER_ARM, FOREARM, HAND, FINGER = "trunk", "head", "upper arm", "forearm", "hand", "finger"

# Angle between a resting forearm and straight down; speakers hold the forearms so between gestures.
_RESTING_FOREARM, _DOWN = np.deg2rad(65), np.array([0.0, 1.0, 0.0])
# The rotation of a head or a hand is continued in its direction up to this angle; beyond it the shorter arc is taken.
_LONGEST = 1.3 * np.pi

# A scale above 1 keeps rotations within these angles from the mean pose, in radians, unless the motion itself exceeds
# them; elbows and wrists stay within the limits of their bend.
_FARTHEST = {TRUNK: 0.5, HEAD: 0.9, UPPER_ARM: 2.4, HAND: 1.9}
_ELBOW_LIMITS = np.deg2rad(8), np.deg2rad(145)
_WRIST_LIMITS = -np.deg2rad(70), np.deg2rad(70)
_LEAST_HEADROOM = 1e-3


class Part(NamedTuple):
    """Bones that rotate together.

    Attributes:
        kind: `TRUNK`, `HEAD`, `UPPER_ARM`, `FOREARM`, `HAND` or `FINGER`.
        side: "left" or "right", "" on the midline.
        bones: indices of the bones; more than one for the head and for the bones that leave the wrist.
        parent: index of the bone that the part rotates with, -1 for a part that rotates with none.
    """

    kind: str
    side: str
    bones: tuple[int, ...]
    parent: int


class Turn(NamedTuple):
    """A rotation of a part.

    Attributes:
        part: the part.
        bones: indices of the bones that it rotates: one, or all of a head or a hand, which then rotate one by one.
        parent: index of the turn that it is relative to, -1 for none.
    """

    part: Part
    bones: tuple[int, ...]
    parent: int


@functools.cache
def parts(skeleton: Skeleton) -> tuple[Part, ...]:
    """Divide all bones of a skeleton into parts, each after the part it is attached to.

    The upper arms are attached to no part: their direction follows gravity and the target of a gesture, not the
    inclination of the trunk.
    """
    arms = [part for side in SIDES for part in _arm(skeleton, side)]
    shoulders = [skeleton.paths[skeleton.joint(f"{side}_shoulder")] for side in SIDES]
    trunk = np.flatnonzero(np.sum(shoulders, axis=0)).tolist()
    rest = set(range(skeleton.num_bones)) - set(trunk) - {bone for part in arms for bone in part.bones}
    head = [Part(HEAD, "", tuple(sorted(rest)), -1)] if rest else []
    return (*(Part(TRUNK, "", (bone,), -1) for bone in trunk), *head, *arms)


@functools.cache
def arm_parts(skeleton: Skeleton, *sides: str) -> tuple[Part, ...]:
    """Return the parts of the arms, by default of both: upper arm, forearm, hand and fingers."""
    return tuple(part for part in parts(skeleton) if part.side in (sides or SIDES))


def bones_of(chosen: tuple[Part, ...]) -> list[int]:
    """Return the indices of all bones of the given parts."""
    return [bone for part in chosen for bone in part.bones]


def bones_of_kind(skeleton: Skeleton, kind: str) -> list[int]:
    """Return the indices of the bones of all parts of a kind, such as `HEAD`."""
    return bones_of(tuple(part for part in parts(skeleton) if part.kind == kind))


def _arm(skeleton: Skeleton, side: str) -> list[Part]:
    upper, fore = (skeleton.bone(f"{side}_{joint}") for joint in ("elbow", "wrist"))
    wrist = skeleton.joint(f"{side}_wrist")
    hand = tuple(bone for bone, (start, _) in enumerate(skeleton.bones) if start == wrist)
    ending = {child: bone for bone, (_, child) in enumerate(skeleton.bones)}
    fingers = [
        bone
        for bone, (_, child) in enumerate(skeleton.bones)
        if skeleton.paths[child, fore] and bone not in (fore, *hand)
    ]
    depth = skeleton.paths.sum(axis=1)
    fingers.sort(key=lambda bone: depth[skeleton.bones[bone][1]])
    return [
        Part(UPPER_ARM, side, (upper,), -1),
        Part(FOREARM, side, (fore,), upper),
        *([Part(HAND, side, hand, fore)] if hand else []),
        *(Part(FINGER, side, (bone,), ending[skeleton.bones[bone][0]]) for bone in fingers),
    ]


def rest_pose(skeleton: Skeleton) -> np.ndarray:
    """Return the rest pose of a skeleton, (bones, 3) float32 unit vectors.

    It is the mean pose of the skeleton's data, made symmetric, with forearms and hands lowered until the forearms are
    at 65 degrees from straight down.
    """
    return _rest_pose(skeleton).copy()


@functools.cache
def _rest_pose(skeleton: Skeleton) -> np.ndarray:
    mean = skeleton.mean_directions.astype(np.float64)
    pose = normalize(mean + mirror_directions(skeleton, mean))
    for side in SIDES:
        arm = bones_of(tuple(part for part in arm_parts(skeleton, side) if part.kind != UPPER_ARM))
        forearm = pose[skeleton.bone(f"{side}_wrist")]
        axis = np.cross(forearm, _DOWN)
        angle = max(np.arctan2(np.linalg.norm(axis), forearm @ _DOWN) - _RESTING_FOREARM, 0)
        pose[arm] = rotate(about(unit(axis), angle), pose[arm])
    return pose.astype(np.float32)


@functools.cache
def turns(chosen: tuple[Part, ...]) -> tuple[Turn, ...]:
    """List the rotations of parts, each after the one it is relative to: of the bones of a head or a hand together,
    then of each bone.
    """
    listed: list[Turn] = []
    last = {-1: -1}  # turn of each bone
    for part in chosen:
        parent = last[part.parent]
        if part.kind in (HEAD, HAND) and len(part.bones) > 1:
            listed.append(Turn(part, part.bones, parent))
            parent = len(listed) - 1
        for bone in part.bones:
            last[bone] = len(listed)
            listed.append(Turn(part, (bone,), parent))
    return tuple(listed)


class _Layer(NamedTuple):
    """Turns that are computed at once: of single bones at one depth, or one turn of several bones."""

    turns: list[int]
    parents: list[int]
    bones: list[int]


@functools.cache
def _layers(chosen: tuple[Part, ...]) -> tuple[_Layer, ...]:
    """Divide the turns of parts into layers, each after those of its parents."""
    depths: list[int] = []
    layers: dict[tuple[int, ...], _Layer] = {}
    for index, turn in enumerate(turns(chosen)):
        depths.append(depths[turn.parent] + 1 if turn.parent >= 0 else 0)
        key = (depths[-1],) if len(turn.bones) == 1 else (depths[-1], index)
        layer = layers.setdefault(key, _Layer([], [], []))
        layer.turns.append(index)
        layer.parents.append(turn.parent)
        layer.bones.extend(turn.bones)
    return tuple(layers[key] for key in sorted(layers))


def rotations_from(reference: np.ndarray, directions: np.ndarray, chosen: tuple[Part, ...]) -> np.ndarray:
    """Compute the rotations of parts from a reference pose (bones, 3) to the poses of a motion (T, bones, 3).

    They are unit quaternions (T, turns, 4) in the order of `turns`. Those of several bones and of upper arms are
    continuous over time and so may have w < 0, which stands for an angle above pi.
    """
    reference, poses = np.asarray(reference, np.float64), np.asarray(directions, np.float64)
    rotations = np.empty((len(poses), len(turns(chosen)), 4))
    frames = _unturned(rotations)
    for layer in _layers(chosen):
        frame, rest = frames[:, layer.parents], reference[layer.bones]
        seen = rotate(conjugate(frame), poses[:, layer.bones])
        together = len(layer.bones) > len(layer.turns)
        rotation = fit(seen, rest)[0][:, None] if together else between(rest, seen)
        rotations[:, layer.turns], frames[:, layer.turns] = rotation, multiply(frame, rotation)
    for index, turn in enumerate(turns(chosen)):
        if turn.part.kind == UPPER_ARM or len(turn.bones) > 1:
            rotations[:, index] = _continuous(rotations[:, index])
    return rotations


def _unturned(rotations: np.ndarray) -> np.ndarray:
    """Return the identity for each of (T, turns, 4) rotations and, at index -1, for what a turn without parent has."""
    return np.tile(IDENTITY, (rotations.shape[0], rotations.shape[1] + 1, 1))


def apply_rotations(reference: np.ndarray, rotations: np.ndarray, chosen: tuple[Part, ...]) -> np.ndarray:
    """Rotate the parts of a reference pose (bones, 3) by (T, turns, 4), the inverse of `rotations_from`.

    Returns:
        Unit vectors (T, bones, 3) of `bones_of` the parts.
    """
    reference = np.asarray(reference, np.float64)
    frames = _unturned(rotations)
    for layer in _layers(chosen):
        frames[:, layer.turns] = multiply(frames[:, layer.parents], rotations[:, layer.turns])
    of_bones = [index for index, turn in enumerate(turns(chosen)) if len(turn.bones) == 1]
    return rotate(frames[:, of_bones], reference[bones_of(chosen)])


def power(rotations: np.ndarray, exponents: np.ndarray) -> np.ndarray:
    """Scale the angles of unit quaternions (..., 4) by factors (...); one with w < 0 stands for the angle above pi."""
    axis = rotations[..., :3]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    half = exponents[..., None] * np.arctan2(length, rotations[..., 3:])
    return np.concatenate([axis / np.maximum(length, 1e-12) * np.sin(half), np.cos(half)], axis=-1)


def _continuous(rotations: np.ndarray) -> np.ndarray:
    """Return the same rotations (T, 4) with signs that are continuous over time up to the longest angle."""
    stays = (np.sum(rotations[1:] * rotations[:-1], axis=-1) >= 0).tolist()
    least = np.cos(_LONGEST / 2)
    signs = [1.0]
    for stay, w in zip(stays, rotations[1:, 3].tolist(), strict=True):
        sign = signs[-1] if stay else -signs[-1]
        signs.append(sign if sign * w >= least else -sign)
    return rotations * np.array(signs)[:, None]


def scale_about(
    reference: np.ndarray, directions: np.ndarray, scale: np.ndarray | float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Scale the rotations from a reference pose by 0 to 1, one factor or (T,); where it is 1 nothing changes."""
    scales = np.broadcast_to(np.asarray(scale, np.float64), (len(directions),))
    rows = np.flatnonzero(scales != 1)
    result = np.array(directions, np.float32)
    if len(rows):
        rotations = power(rotations_from(reference, result[rows], chosen), scales[rows, None])
        result[rows[:, None], bones_of(chosen)] = apply_rotations(reference, rotations, chosen)
    return result


def scale_about_mean(
    skeleton: Skeleton, directions: np.ndarray, fps: float, scale: float, seconds: float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Scale the rotations of a motion from its slow mean pose, the mean over a window of some seconds.

    A scale above 1 does not change the shape of a hand, and adds less near the limits of a joint.
    """
    reference = rest_pose(skeleton).astype(np.float64)
    rotations = rotations_from(reference, directions, chosen)
    return _scaled(reference, directions, rotations, slow_mean(rotations, fps, seconds), scale, chosen)


def scale_about_posture(
    skeleton: Skeleton, posture: np.ndarray, directions: np.ndarray, scale: float, chosen: tuple[Part, ...]
) -> np.ndarray:
    """Scale the rotations of a motion from a pose (bones, 3) that it moves about, see `scale_about_mean`."""
    reference = rest_pose(skeleton).astype(np.float64)
    both = rotations_from(reference, np.concatenate([posture[None], directions]), chosen)
    mean, rotations = both[:1], both[1:]
    is_near = np.sum(mean * rotations, axis=-1, keepdims=True) >= 0  # of the two quaternions of a rotation
    means = np.where(is_near, mean, -mean)
    return _scaled(reference, directions, rotations, means, scale, chosen)


def _scaled(
    reference: np.ndarray,
    directions: np.ndarray,
    rotations: np.ndarray,
    means: np.ndarray,
    scale: float,
    chosen: tuple[Part, ...],
) -> np.ndarray:
    scales = np.full(rotations.shape[:2], min(scale, 1.0))
    if scale > 1:
        _raise_scales(scales, reference, rotations, means, scale, chosen)
    scaled = multiply(means, power(multiply(conjugate(means), rotations), scales))
    result = np.array(directions, np.float32)
    result[:, bones_of(chosen)] = apply_rotations(reference, scaled, chosen)
    return result


def _limit_scale(scale: float, rise: np.ndarray, headroom: np.ndarray) -> np.ndarray:
    """Limit a scale s above 1 to 1 + (s - 1) tanh(z) / z with z = (s - 1) rise / headroom.

    It thus adds at most the headroom to a motion that differs from the reference by `rise`, an array of equal shape.
    """
    z = np.maximum((scale - 1) * np.abs(rise) / np.maximum(headroom, _LEAST_HEADROOM), 1e-6)
    return 1 + (scale - 1) * np.tanh(z) / z


def _raise_scales(
    scales: np.ndarray,
    reference: np.ndarray,
    rotations: np.ndarray,
    means: np.ndarray,
    scale: float,
    chosen: tuple[Part, ...],
) -> None:
    """Raise the scales (T, turns) of all but fingers to `scale`, limited where a joint is near its limit."""
    raised = {
        index: turn.part
        for index, turn in enumerate(turns(chosen))
        if turn.bones == turn.part.bones and turn.part.kind != FINGER
    }
    which = list(raised)
    farthest = np.array([_FARTHEST.get(part.kind, np.pi) for part in raised.values()])
    angles = 2 * np.arccos(np.clip(np.abs(np.sum(rotations[:, which] * means[:, which], axis=-1)), 0, 1))
    scales[:, which] = _limit_scale(scale, angles, farthest - angles)
    for index, part in raised.items():
        if part.kind in (FOREARM, HAND):
            limits = _ELBOW_LIMITS if part.kind == FOREARM else _WRIST_LIMITS
            along = reference[list(part.bones)].mean(axis=0)
            bend, usual = (_angle(reference[part.parent], rotate(q[:, index], along)) for q in (rotations, means))
            headroom = np.where(bend > usual, limits[1] - bend, bend - limits[0])
            scales[:, index] = np.minimum(scales[:, index], _limit_scale(scale, bend - usual, headroom))


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(cross(first, second), axis=-1), np.sum(first * second, axis=-1))


def reach_farther(skeleton: Skeleton, directions: np.ndarray, amount: float) -> np.ndarray:
    """Move each wrist to `amount` times, at least 1, its distance from its rest position relative to the shoulder.

    A wrist is not raised above its shoulder, where the hand would hide the face, unless the motion raises it. It moves
    less where the arm would be straight or folded. The elbow stays on its side of the arm, and the hand keeps its pose
    relative to the forearm. Only the arms change.
    """
    result = np.array(directions, np.float32)
    resting = rest_pose(skeleton).astype(np.float64)
    for side in SIDES:
        upper, fore = (skeleton.bone(f"{side}_{joint}") for joint in ("elbow", "wrist"))
        hand = [bone for bone in bones_of(arm_parts(skeleton, side)) if bone not in (upper, fore)]
        lengths = skeleton.lengths[[upper, fore]].astype(np.float64)
        old = unit(result[:, [upper, fore]])
        wrist, rest = lengths @ old, lengths @ resting[[upper, fore]]
        target = _within_reach(wrist, _below_the_face(wrist, rest + amount * (wrist - rest)), lengths)
        swing = between(wrist, target)
        new = _bend(rotate(swing, old[:, 0]), target, lengths)
        rotation = multiply(between(rotate(swing, old[:, 1]), new[:, 1]), swing)
        result[:, [upper, fore]] = new
        result[:, hand] = rotate(rotation[:, None], result[:, hand].astype(np.float64))
    return result


def _below_the_face(wrist: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Limit targets (T, 3) to rise by less than the height of the shoulder above the wrist; y points down."""
    rise, headroom = wrist[:, 1] - target[:, 1], np.maximum(wrist[:, 1], 1e-4)
    limited = np.minimum(rise, headroom * np.tanh(rise / headroom))
    return np.column_stack([target[:, 0], wrist[:, 1] - limited, target[:, 2]])


def _within_reach(wrist: np.ndarray, target: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Limit targets (T, 3) to distances at which the elbow is neither straight nor folded."""
    farthest, nearest = (np.sqrt(lengths @ lengths + 2 * lengths.prod() * np.cos(bend)) for bend in _ELBOW_LIMITS)
    old, new = (np.linalg.norm(vectors, axis=-1) for vectors in (wrist, target))
    headroom = np.maximum(np.where(new > old, farthest - old, old - nearest), 1e-4)
    limited = old + headroom * np.tanh((new - old) / headroom)
    return target * (limited / np.maximum(new, 1e-9))[:, None]


def _bend(upper: np.ndarray, target: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the upper arm and forearm (T, 2, 3) that reach `target` with the elbow on the side of `upper`."""
    distance = np.linalg.norm(target, axis=-1, keepdims=True)
    along = target / distance
    across = upper - np.sum(upper * along, axis=-1, keepdims=True) * along
    is_clear = np.linalg.norm(across, axis=-1, keepdims=True) > 1e-6
    across = np.where(is_clear, unit(across), perpendicular(along))
    first, second = lengths
    cosine = np.clip((first**2 + distance**2 - second**2) / (2 * first * distance), -1, 1)
    bent = cosine * along + np.sqrt(1 - cosine**2) * across
    return np.stack([bent, unit(target - first * bent)], axis=1)

"""The motion of a tree of joints, such as that of BVH: forward kinematics, and the joints of a skeleton with a face."""

import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, naming, shown
from ha2g_jax.motion import rigs
from ha2g_jax.motion.armature import export_axes, ha2g_armature, rest_positions
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.readers.body import (
    ARM,
    ARM_RANGE,
    FACE,
    MAX_MINUTES,
    MIN_BONE,
    add_face,
    add_rest_face,
    arm_length,
    check_arms,
    check_size,
    choose_up,
    from_captured,
    is_mirrored,
    is_turned,
    mean_heading,
    to_skeleton_axes,
)
from ha2g_jax.motion.readers.bvh import Bvh, read_bvh
from ha2g_jax.motion.readers.containers import container_of
from ha2g_jax.motion.readers.gltf import read_gltf
from ha2g_jax.motion.readers.joint_maps import AUTO, HEAD, choose_map, find, find_legs
from ha2g_jax.motion.readers.trees import read_csv
from ha2g_jax.motion.resample import moments_at
from ha2g_jax.motion.rotations import unit as unit_vectors
from ha2g_jax.skeleton import Skeleton

TREES = (".bvh", ".glb", ".vrma", ".csv")
"""Suffixes of files that hold a tree of joints, other than `.json`."""

_AXES = "XYZ"
_METRIC_UNITS = (0.001, 0.01, 1.0)  # millimetres, centimetres, metres
_UNITS = (*_METRIC_UNITS, 0.0254)  # inches
_FEET_FPS = 2.0
_LEG_BONES = ((1, 5), (1, 2), (2, 3), (5, 6), (6, 7))  # of `LOWER_JOINTS`, with the line of the hips
_ALIKE = np.cos(np.deg2rad(1))  # of bones at rest


def world_motion(bvh: Bvh, fps: float, joints: Sequence[int]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Compute positions and rotations of joints by forward kinematics, at another frame rate.

    Between two frames, local rotations are interpolated on the sphere and local positions linearly, so that a bone
    without position channels keeps its length.

    Args:
        fps: frames per second of the result; frame k is at k / fps seconds; after the last frame of the file that frame
            is held.
        joints: n indices of joints of the file; only these and the joints above them are computed.

    Returns:
        (T, n, 3) positions in units of the file and n times (T, 3, 3) rotations, both in the file's coordinates.

    Raises:
        UserError: the joints times the frames of the result are more than `MAX_POSED_JOINTS`.
    """
    last = len(bvh.motion) - 1
    needed = _with_parents(bvh.parents, joints)
    moments = moments_at(len(bvh.motion), bvh.fps, fps)
    check_size(len(needed), len(moments))
    # A slow file has many frames of the result between the same two of its own, which are converted once.
    starts, place_of = np.unique(np.floor(moments).astype(int), return_inverse=True)
    weight = (moments - starts[place_of])[:, None]
    # The rotation of a joint matters if it is requested or moves another joint.
    above = {bvh.parents[joint] for joint in needed} | {*joints}
    places: dict[int, np.ndarray] = {}
    rotations: dict[int, np.ndarray] = {}
    column = 0
    for joint, (parent, channels) in enumerate(zip(bvh.parents, bvh.channels, strict=True)):
        values = bvh.motion[:, column : column + len(channels)]
        column += len(channels)
        if joint not in needed:
            continue
        before, after = (values[frames] for frames in (starts, np.minimum(starts + 1, last)))
        place = _places(bvh.offsets[joint], channels, before)[place_of]
        place += weight * (_places(bvh.offsets[joint], channels, after)[place_of] - place)
        places[joint] = place if parent < 0 else places[parent] + _apply(rotations[parent], place)
        if joint in above:
            first, second = _rotations(channels, before), _rotations(channels, after)
            turn = (first.inv() * second).as_rotvec()[place_of]
            begin = Rotation.from_quat(first.as_quat()[place_of])
            rotation = (begin * Rotation.from_rotvec(weight * turn)).as_matrix()
            rotations[joint] = rotation if parent < 0 else rotations[parent] @ rotation
    return np.stack([places[joint] for joint in joints], axis=1), [rotations[joint] for joint in joints]


def _apply(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (rotations @ vectors[:, :, None])[:, :, 0]


def _with_parents(parents: Sequence[int], joints: Sequence[int]) -> set[int]:
    """Return the joints and all joints above them."""
    needed: set[int] = set()
    for joint in joints:
        while joint >= 0 and joint not in needed:
            needed.add(joint)
            joint = parents[joint]
    return needed


def _places(offset: np.ndarray, channels: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """Return the position (T, 3) of a joint relative to its parent; position channels replace the offset."""
    place = np.tile(offset, (len(values), 1))
    for channel, value in zip(channels, values.T, strict=True):
        if channel.endswith("position"):
            place[:, _AXES.index(channel[0])] = value
    return place


def _rotations(channels: tuple[str, ...], values: np.ndarray) -> Rotation:
    """Return the T rotations of a joint relative to its parent."""
    turning = [index for index, channel in enumerate(channels) if channel.endswith("rotation")]
    if not turning:
        return Rotation.identity(len(values))
    order = "".join(channels[index][0] for index in turning)  # upper case: intrinsic rotations
    return Rotation.from_euler(order, values[:, turning], degrees=True)


class BvhMotion(NamedTuple):
    """The motion of a BVH file in `seconds`, and how the file was interpreted.

    Attributes:
        positions: (T, joints, 3) metres in the skeleton's axes, float32.
        fps: frames per second of the file.
        joint_map: name of the joint map that was used.
        unit: metres in one unit of the file.
        up: axis of the file that points up.
        lower: pelvis and legs, None if they are not requested or the file has none.
    """

    positions: np.ndarray
    seconds: float
    fps: float
    joint_map: str
    unit: float
    up: str
    lower: LowerBody | None = None


def read_motion(
    path: str | os.PathLike, skeleton: Skeleton, *, source_fps: float | None = None, **options: Any
) -> BvhMotion:
    """Read the motion of a file of `read_tree` as joints of a skeleton.

    Args:
        source_fps: frames per second of the file; None uses the rate stored in it.
        options: options of `to_motion`.

    Raises:
        UserError: the file is none of these, or its motion cannot be used.
    """
    return to_motion(read_tree(path, source_fps), path, skeleton, **options)


def read_tree(path: str | os.PathLike, source_fps: float | None) -> Bvh:
    """Read the tree of joints of a BVH file, of the animation of a glTF file or of a `.csv` of `ha2g export`.

    Raises:
        UserError: the file is none of these, or damaged.
    """
    path = pathlib.Path(path)
    check_regular(path, f"motion of joints: {', '.join(TREES)}")
    read = {".glb": read_gltf, ".csv": read_csv}.get(container_of(path), read_bvh)
    return read(path, source_fps)


def to_motion(
    bvh: Bvh,
    path: str | os.PathLike,
    skeleton: Skeleton,
    *,
    fps: float | None,
    joint_map: str = AUTO,
    unit: float | None = None,
    with_legs: bool = False,
) -> BvhMotion:
    """Convert the motion of a tree of joints, such as that of a BVH file, to joints of a skeleton.

    Args:
        path: path of the file, for messages.
        fps: frames per second of the result; None keeps those of the file.
        joint_map: "auto", one of `joint_maps.MAPS` or the path of a JSON or YAML file.
        unit: metres in one unit of the file; None uses the unit of the joint map, or else that among millimetres,
            centimetres, inches and metres for which the arms have a length closest to an adult's.
        with_legs: whether to read pelvis and legs, if the file has them.

    Raises:
        UserError: the motion is longer than `MAX_MINUTES`, its joints do not fit the map, its arms do not have a
            person's length, or its left and right are mirrored.
    """
    path = pathlib.Path(path)
    if (minutes := bvh.seconds / 60) > MAX_MINUTES:
        raise UserError(
            f"{shown(path)} has {minutes:.0f} minutes of motion; expected at most {MAX_MINUTES:.0f}: cut the file"
        )
    names, places = choose_map(bvh.joints, skeleton, joint_map, path)
    legs = find_legs(names, bvh.joints, path)
    shown_face = [joint for joint in FACE if joint in skeleton.joints]
    # In TED-Gesture it is another joint, except in our own files of that skeleton.
    is_other = HEAD in shown_face and rigs.OTHER_NAMES[HEAD] not in bvh.joints
    face = {} if is_other else find(names, bvh.joints, shown_face, path)
    own = [*(joint for joint in places if joint != HEAD), *face]
    found = [*((places | face)[joint] for joint in own), places[HEAD]]
    with naming(path):
        world, rotations = world_motion(bvh, fps or bvh.fps, [*found, *(legs.values() if with_legs else ())])
        positions = np.zeros((len(world), skeleton.num_joints, 3))
        positions[:, [skeleton.joint(joint) for joint in own]] = world[:, : len(own)]
        up = choose_up(positions, skeleton, names.up)
        is_own = _rests_on_rig(bvh, names.name, places, skeleton) and not is_turned(positions, skeleton, up)
        up = "y" if is_own else up
        if not is_own:
            _check_sides(bvh, positions, fps or bvh.fps, skeleton, legs)
        unit = _find_unit(positions, skeleton, unit or names.unit)
        positions *= unit
        axes = np.diag(export_axes(skeleton)) if is_own else mean_heading(positions, skeleton, up=up)
        if len(face) < len(shown_face) and is_own:
            positions = add_rest_face(positions, rotations[len(own)], skeleton)
        elif len(face) < len(shown_face):
            positions = add_face(positions, world[:, len(own)] * unit, rotations[len(own)], skeleton, up=up)
        lower = None
        if with_legs and legs:
            places_of_legs = world[:, len(found) :] * unit
            lower = _lower(positions, places_of_legs, rotations[len(found) :], list(legs), skeleton, axes)
        positions = to_skeleton_axes(positions, skeleton, axes=axes)
    return BvhMotion(positions.astype(np.float32), bvh.seconds, bvh.fps, names.name, unit, up, lower)


def _rests_on_rig(bvh: Bvh, name: str, places: Mapping[str, int], skeleton: Skeleton) -> bool:
    """Return whether the rest pose is, within a degree, that of files of `ha2g export` with a rig: y up, facing +z.

    Its axes, sides and head are then known and need not be estimated from the motion.
    """
    if name not in rigs.RIGS:
        return False
    armature = rigs.armature_of(rigs.load_rig(name), ha2g_armature(skeleton))
    _, theirs = rest_positions(armature)
    where = rigs.places(armature)
    rest = np.zeros_like(bvh.offsets)
    for joint, parent in enumerate(bvh.parents):
        rest[joint] = bvh.offsets[joint] + (rest[parent] if parent >= 0 else 0)
    pairs = [tuple(skeleton.joints[joint] for joint in bone) for bone in skeleton.bones]
    pairs = [pair for pair in pairs if {*pair} <= (places.keys() - {HEAD}) & where.keys()]
    expected = unit_vectors(np.array([theirs[where[end]] - theirs[where[start]] for start, end in pairs]))
    found = unit_vectors(np.array([rest[places[end]] - rest[places[start]] for start, end in pairs]))
    return bool((np.sum(expected * found, axis=-1) > _ALIKE).all())


def _check_sides(bvh: Bvh, positions: np.ndarray, fps: float, skeleton: Skeleton, legs: dict[str, int]) -> None:
    """Raise UserError where left and right are mirrored in positions (T, joints, 3) at `fps` frames per second."""
    names = [f"{side}_{part}" for side in ("left", "right") for part in ("ankle", "foot")]
    frames, feet = np.arange(len(positions)), None
    if all(name in legs for name in names):  # feet point ahead in most frames, so that a few suffice
        rate = min(fps, _FEET_FPS)
        feet, _ = world_motion(bvh, rate, [legs[name] for name in names])
        frames = np.minimum(np.round(np.arange(len(feet)) * (fps / rate)).astype(int), len(positions) - 1)
    if is_mirrored(positions[frames], skeleton, feet):
        raise UserError(
            "left and right are mirrored, as in left-handed axes: the toes or the bent fingers point to the person's "
            "back; export it with right-handed axes, or correct the sides in the joint map"
        )


def _lower(
    positions: np.ndarray,
    legs: np.ndarray,
    rotations: list[np.ndarray],
    names: list[str],
    skeleton: Skeleton,
    axes: np.ndarray,
) -> LowerBody | None:
    """Return pelvis and legs from positions (T, n, 3) and rotations of the joints that the file has, whose `axes` of
    the skeleton are those of `mean_heading`; None if two joints of a leg, or both hips, are at one place.
    """
    axes = axes * export_axes(skeleton)
    points = np.full((len(legs), len(LOWER_JOINTS), 3), np.nan)
    turns = np.tile(np.eye(3), (len(legs), len(LOWER_JOINTS), 1, 1))
    for index, name in enumerate(names):
        points[:, LOWER_JOINTS.index(name)] = legs[:, index] @ axes
        turns[:, LOWER_JOINTS.index(name)] = axes.T @ rotations[index]
    if any(np.linalg.norm(points[:, end] - points[:, start], axis=-1).mean() < MIN_BONE for start, end in _LEG_BONES):
        return None
    return from_captured(points, turns, positions[:, skeleton.joint("spine")] @ axes)


def _find_unit(positions: np.ndarray, skeleton: Skeleton, unit: float | None) -> float:
    """Return the metres in one unit, checked or found by the median length of the arms.

    A metric unit is taken if it gives arms of a possible length, those of a child included; an adult's arms in inches,
    read as centimetres, would be too short.
    """
    length = arm_length(positions, skeleton, "left", "right")
    fitting = [metres for metres in _METRIC_UNITS if ARM_RANGE[0] <= length * metres <= ARM_RANGE[1]]
    metres = unit or min(fitting or _UNITS, key=lambda metres: abs(np.log(max(length * metres, 1e-12) / ARM)))
    check_arms(length, metres)
    return metres

"""Skeletons (joints, bones, levels and angle pairs) and the geometry that is derived from them.

A pose is the set of unit direction vectors of the bones, parent to child (HA2G, section 3.1).
Everything that depends on the skeleton - the channels of each level, mirroring, forward kinematics, joint angles - is
derived from a `Skeleton`.
The functions are pure and take numpy and jax arrays.

Axes are those of the TED data: metres, y points down, the person's left is +x in TED-Expressive.
"""

import dataclasses
import functools
import importlib.resources
import json
from typing import Any

import numpy as np

SKELETONS = ("ted_expressive", "ted_gesture")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")

MIN_NORM = 1e-8
# Keeps arccos, and so its gradient, finite at parallel bones.
_MAX_COSINE = 1 - 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of joints with the statistics of its data set. Skeletons are compared by value, including arrays.

    Attributes:
        name: name of the skeleton file, such as "ted_expressive".
        joints: names of the joints; joint 0 is the root.
        bones: indices of the parent joint and the child joint of each bone.
        lengths: (bones,) mean bone lengths in metres.
        levels: bones of each level of the motion hierarchy, from coarse to fine; each contains the level before.
        angle_pairs: pairs of bones whose angle is constrained; an index >= the number of bones is a palm normal.
        palms: pairs of finger bones whose cross product is a palm normal.
        mean_directions: (bones, 3) mean direction vectors, not of unit length.
        mean_pose: (joints, 3) mean joint positions in metres.
        angle_mean: (pairs,) means of the angles divided by pi.
        angle_variance: (pairs,) variances of the angles divided by pi squared.
        angle_change: (pairs,) mean absolute changes of the angles per frame divided by pi.
    """

    name: str
    joints: tuple[str, ...]
    bones: tuple[tuple[int, int], ...]
    lengths: np.ndarray
    levels: tuple[tuple[int, ...], ...]
    angle_pairs: tuple[tuple[int, int], ...]
    palms: tuple[tuple[int, int], ...]
    mean_directions: np.ndarray
    mean_pose: np.ndarray
    angle_mean: np.ndarray
    angle_variance: np.ndarray
    angle_change: np.ndarray

    def __repr__(self) -> str:
        return f"Skeleton({self.name!r}, {self.num_joints} joints, {self.num_bones} bones, {self.num_levels} levels)"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Skeleton) and self._values == other._values

    def __hash__(self) -> int:
        return self._hash

    @functools.cached_property
    def _values(self) -> tuple[Any, ...]:
        values = (getattr(self, field.name) for field in dataclasses.fields(self))
        return tuple((it.shape, str(it.dtype), it.tobytes()) if isinstance(it, np.ndarray) else it for it in values)

    @functools.cached_property
    def _hash(self) -> int:
        return hash(self._values)

    @property
    def num_joints(self) -> int:
        return len(self.joints)

    @property
    def num_bones(self) -> int:
        return len(self.bones)

    @property
    def num_levels(self) -> int:
        return len(self.levels)

    @property
    def pose_dim(self) -> int:
        return 3 * self.num_bones

    @property
    def level_channels(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the channels of each level in the flat pose of `pose_dim` values."""
        return tuple(tuple(3 * bone + axis for bone in level for axis in range(3)) for level in self.levels)

    @property
    def left(self) -> float:
        """1 where the person's left is at +x, as in TED-Expressive, -1 where it is at -x, as in TED-Gesture."""
        return 1.0 if self.mean_pose[self.joint("left_shoulder"), 0] > 0 else -1.0

    def joint(self, name: str) -> int:
        return self.joints.index(name)

    def bone(self, child: str) -> int:
        """Return the index of the bone that ends in the joint `child`."""
        return [bone[1] for bone in self.bones].index(self.joint(child))

    @functools.cached_property
    def paths(self) -> np.ndarray:
        """(joints, bones) float32 matrix that is 1 where the bone is between the root and the joint, 0 elsewhere."""
        paths = np.zeros((self.num_joints, self.num_bones), np.float32)
        pending = list(enumerate(self.bones))
        reached = {0}
        while pending:
            bone, (parent, child) = next(item for item in pending if item[1][0] in reached)
            paths[child] = paths[parent]
            paths[child, bone] = 1
            reached.add(child)
            pending.remove((bone, (parent, child)))
        return paths

    @functools.cached_property
    def mirror_bones(self) -> np.ndarray:
        """(bones,) index of the bone on the other side, or of the bone itself on the midline."""
        other = {"left": "right", "right": "left"}
        children = [self.joints[child] for _, child in self.bones]
        swapped = ["_".join(other.get(part, part) for part in child.split("_")) for child in children]
        return np.array([children.index(child) for child in swapped])


@functools.cache
def load_skeleton(name: str) -> Skeleton:
    """Load a skeleton, one of `SKELETONS`."""
    text = (importlib.resources.files("ha2g_jax") / "assets" / "skeletons" / f"{name}.json").read_text()
    facts = json.loads(text)
    num_bones = len(facts["bones"])
    uses_palms = max(max(pair) for pair in facts["angle_pairs"]) >= num_bones
    return Skeleton(
        name=facts["name"],
        joints=tuple(facts["joints"]),
        bones=tuple((bone["parent_index"], bone["child_index"]) for bone in facts["bones"]),
        lengths=np.array([bone["mean_length"] for bone in facts["bones"]], np.float32),
        levels=tuple(tuple(level) for level in facts["hierarchy_bones"]),
        angle_pairs=tuple((first, second) for first, second in facts["angle_pairs"]),
        palms=_PALMS[name] if uses_palms else (),
        mean_directions=np.array(facts["mean_dir_vec"], np.float32).reshape(num_bones, 3),
        mean_pose=np.array(facts["mean_pose"], np.float32).reshape(-1, 3),
        angle_mean=np.array(facts["angle_mean_over_pi"], np.float32),
        angle_variance=np.array(facts["angle_variance_over_pi2"], np.float32),
        angle_change=np.array(facts["mean_absolute_angle_change_over_pi"], np.float32),
    )


# Wrist-to-pinky and wrist-to-thumb bones, of the left and of the right hand.
_PALMS = {"ted_expressive": ((11, 17), (28, 34))}


def normalize(vectors: Any) -> Any:
    """Return vectors (..., 3) scaled to unit length; a zero vector stays zero, with a finite gradient.

    Integers become floats. The range of float16 is too small.
    """
    xp = vectors.__array_namespace__()
    squared = xp.sum(vectors * vectors, axis=-1, keepdims=True)
    return vectors / xp.sqrt(xp.maximum(squared, MIN_NORM**2))


def directions_to_positions(skeleton: Skeleton, directions: Any) -> Any:
    """Compute forward kinematics with the mean bone lengths and the root at the origin.

    Direction vectors (..., bones, 3) of any positive length, which are normalised (decision D1), become positions (...,
    joints, 3) in metres.
    """
    xp = directions.__array_namespace__()
    unit = normalize(directions)
    return xp.matmul(xp.asarray(skeleton.paths * skeleton.lengths, dtype=unit.dtype), unit)


def positions_to_directions(skeleton: Skeleton, positions: Any) -> Any:
    """Compute unit direction vectors (..., bones, 3) from joint positions (..., joints, 3)."""
    return normalize(_bone_vectors(skeleton, positions))


def bone_lengths(skeleton: Skeleton, positions: Any) -> Any:
    """Compute the lengths (..., bones) of the bones of positions (..., joints, 3)."""
    xp = positions.__array_namespace__()
    return xp.linalg.vector_norm(_bone_vectors(skeleton, positions), axis=-1)


def _bone_vectors(skeleton: Skeleton, positions: Any) -> Any:
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    return positions[..., children, :] - positions[..., parents, :]


def joint_angles(skeleton: Skeleton, directions: Any) -> Any:
    """Compute the angles between the pairs of bones, theta_j = arccos(d_j . d_k) (HA2G, Eq. 8 and 12).

    Direction vectors (..., bones, 3) of any positive length, not residuals from the mean, give angles (..., pairs) in
    radians; the gradient is finite at parallel bones.
    """
    xp = directions.__array_namespace__()
    vectors = directions
    if skeleton.palms:
        first, second = (list(bones) for bones in zip(*skeleton.palms, strict=True))
        normals = _cross(directions[..., first, :], directions[..., second, :])
        vectors = xp.concat([directions, normals], axis=-2)
    vectors = normalize(vectors)
    first, second = (list(bones) for bones in zip(*skeleton.angle_pairs, strict=True))
    cosine = xp.sum(vectors[..., first, :] * vectors[..., second, :], axis=-1)
    return xp.acos(xp.clip(cosine, -_MAX_COSINE, _MAX_COSINE))


def _cross(a: Any, b: Any) -> Any:
    shift, shift_back = [1, 2, 0], [2, 0, 1]
    return a[..., shift] * b[..., shift_back] - a[..., shift_back] * b[..., shift]


def mirror_directions(skeleton: Skeleton, directions: Any) -> Any:
    """Mirror poses, given as directions (..., bones, 3): exchange left and right bones and negate x."""
    xp = directions.__array_namespace__()
    swapped = directions[..., skeleton.mirror_bones, :]
    return xp.concat([-swapped[..., :1], swapped[..., 1:]], axis=-1)


def hand_joints(skeleton: Skeleton) -> list[int]:
    """Return the indices of the joints of both hands: wrists and fingers."""
    return [number for number, name in enumerate(skeleton.joints) if any(part in name for part in ("wrist", *FINGERS))]

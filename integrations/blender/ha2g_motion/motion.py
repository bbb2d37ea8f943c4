"""What every file is read to: joints in their rest pose, and how each is turned from it over time."""

import dataclasses

import numpy as np

from . import rotations


class MotionError(Exception):
    """A file, a name or an armature that does not fit: one line, what was found and what to do."""


@dataclasses.dataclass(frozen=True)
class Body:
    """A skinned mesh in the rest pose.

    Attributes:
        points: (V, 3) metres.
        faces: (F, 3) corners of the triangles.
        joints, weights: (V, 4) joints that carry a point, and how much.
        materials: (F,) index of each face's colour.
        colours: (name, (red, green, blue, alpha), roughness) of each material, linear.
    """

    points: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    materials: np.ndarray
    colours: tuple[tuple[str, tuple[float, ...], float], ...]


@dataclasses.dataclass(frozen=True)
class Motion:
    """Joints that move; metres, y up, the figure faces +z and has its left at +x.

    Attributes:
        name: of the rig, or of the file.
        joints: names, each after its parent.
        parents: index of each joint's parent, -1 for the root.
        places: (J, 3) where the joints are in the rest pose.
        turns: (T, J, 4) rotation of each joint in the world from its rest pose; x, y, z, w.
        root: (T, 3) place of the root.
        fps: frames per second.
        body: a mesh, or None.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    places: np.ndarray
    turns: np.ndarray
    root: np.ndarray
    fps: float
    body: Body | None = None

    @property
    def num_frames(self) -> int:
        return len(self.turns)

    @property
    def moves(self) -> np.ndarray:
        """(J,) whether a joint ever leaves its rest pose."""
        return np.abs(self.turns[..., :3]).max(axis=(0, 2)) > 1e-5


def from_local(
    name: str,
    joints: tuple[str, ...],
    parents: tuple[int, ...],
    offsets: np.ndarray,
    rest: np.ndarray,
    rotated: np.ndarray,
    root: np.ndarray,
    fps: float,
    body: Body | None = None,
) -> Motion:
    """Return the motion of joints that are given relative to their parents, as files give them.

    Args:
        offsets: (J, 3) from the parent's origin, in the parent's axes; that of the root is not used.
        rest: (J, 4) rotation relative to the parent at rest.
        rotated: (T, J, 4) rotation relative to the parent, the rest rotation included.
        root: (T, 3) place of the root.

    Raises:
        ValueError: there are no frames, or a value is not a number.
    """
    if len(rotated) == 0 or not fps > 0:
        raise ValueError(f"{len(rotated)} frames at {fps} a second")
    if not all(np.isfinite(values).all() for values in (offsets, rest, rotated, root)):
        raise ValueError("values that are not numbers")
    still, moved = np.empty(rest.shape), np.empty(rotated.shape)
    places = np.zeros(offsets.shape)
    for joint, parent in enumerate(parents):
        if parent < 0:
            still[joint], moved[:, joint], places[joint] = rest[joint], rotated[:, joint], root[0]
            continue
        still[joint] = rotations.multiply(still[parent], rest[joint])
        moved[:, joint] = rotations.multiply(moved[:, parent], rotated[:, joint])
        places[joint] = places[parent] + rotations.rotate(still[parent], offsets[joint])
    turns = rotations.unit(rotations.multiply(moved, rotations.conjugate(still)))
    return Motion(name, joints, parents, places, rotations.continuous(turns), root, fps, body)

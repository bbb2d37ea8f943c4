"""Motion that is read from a file: joints in their rest pose, and their rotations from it over time."""

import dataclasses

import numpy as np

from . import checks, rotations


class MotionError(Exception):
    """A mistake of the user; the message is one line that says what was found and what to do."""


@dataclasses.dataclass(frozen=True)
class Body:
    """A skinned mesh in the rest pose.

    Attributes:
        points: (V, 3) metres.
        faces: (F, 3) corners of the triangles.
        joints: (V, 4) indices of the joints that move each point.
        weights: (V, 4) weights of these joints.
        materials: (F,) index of the material of each face.
        colours: name, linear colour (red, green, blue, alpha) and roughness of each material.
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
        name: name of the rig, or of the file.
        joints: names of the joints, each after its parent.
        parents: index of each joint's parent, -1 for the root.
        places: (J, 3) positions of the joints in the rest pose.
        rotations: (T, J, 4) rotation of each joint in the world from its rest pose; x, y, z, w.
        root: (T, 3) positions of the root.
        fps: frames per second.
        body: skinned mesh, or None.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    places: np.ndarray
    rotations: np.ndarray
    root: np.ndarray
    fps: float
    body: Body | None = None

    @property
    def num_frames(self) -> int:
        return len(self.rotations)

    @property
    def moves(self) -> np.ndarray:
        """(J,) whether each joint leaves its rest pose at any time."""
        return np.abs(self.rotations[..., :3]).max(axis=(0, 2)) > 1e-5


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
    """Build a motion from rotations relative to the parents, as in files.

    Args:
        name: name of the rig, or of the file.
        joints: names of the joints, each after its parent.
        parents: index of each joint's parent, -1 for the root.
        offsets: (J, 3) metres from the parent's origin, in the parent's axes; that of the root is not used.
        rest: (J, 4) rotation relative to the parent at rest.
        rotated: (T, J, 4) rotation relative to the parent, the rest rotation included.
        root: (T, 3) positions of the root in metres.
        fps: frames per second.
        body: skinned mesh, or None.

    Raises:
        ValueError: there are no or too many frames or joints, the frame rate is out of range, the arrays do not fit
            together, or a value is not a number.
    """
    frames, count = len(rotated), len(joints)
    checks.check_size(frames, count)
    checks.check_joints(joints, parents)
    if not checks.MIN_FPS <= fps <= checks.MAX_FPS:
        raise ValueError(f"{fps:g} frames a second, expected {checks.MIN_FPS:g} to {checks.MAX_FPS:g}")
    shapes = (offsets.shape, rest.shape, rotated.shape, root.shape)
    if shapes != ((count, 3), (count, 4), (frames, count, 4), (frames, 3)):
        raise ValueError(f"arrays of shape {', '.join(map(str, shapes))} for {frames} frames of {count} joints")
    checks.check_values([offsets, root], [rest, rotated])
    if body is not None:
        _check_body(body, count)
    still, moved, from_rest = np.empty(rest.shape), np.empty(rotated.shape), np.empty(rotated.shape)
    places = np.zeros(offsets.shape)
    for joint, parent in enumerate(parents):
        if parent < 0:
            still[joint], moved[:, joint], places[joint] = rest[joint], rotated[:, joint], root[0]
        else:
            still[joint] = rotations.multiply(still[parent], rest[joint])
            moved[:, joint] = rotations.multiply(moved[:, parent], rotated[:, joint])
            places[joint] = places[parent] + rotations.rotate(still[parent], offsets[joint])
        turned = rotations.multiply(moved[:, joint], rotations.conjugate(still[joint]))
        from_rest[:, joint] = rotations.continuous(rotations.unit(turned))
    return Motion(checks.shown(name)[:60], joints, parents, places, from_rest, root, fps, body)


def _check_body(body: Body, joints: int) -> None:
    """Raise a ValueError if the arrays of a skinned mesh do not fit together, or a value is out of range."""
    points, faces = len(body.points), len(body.faces)
    if points > checks.MAX_POINTS or faces > checks.MAX_FACES:
        raise ValueError(f"a mesh of {points} points and {faces} faces")
    checks.check_values([body.points], [])
    shapes = (body.joints.shape, body.weights.shape, body.faces.shape, body.materials.shape)
    if shapes != ((points, 4), (points, 4), (faces, 3), (faces,)):
        raise ValueError(f"a mesh with arrays of shape {', '.join(map(str, shapes))} for {points} points")
    for values, most in ((body.joints, joints), (body.faces, points), (body.materials, len(body.colours))):
        if values.size and not (values.min() >= 0 and values.max() < most):
            raise ValueError("a mesh with an index out of range")
    if not (np.abs(body.weights) <= 1).all():
        raise ValueError("a mesh with a weight out of range")
    for _, colour, roughness in body.colours:
        numbers = np.array([*colour, roughness], float)
        if numbers.shape != (5,) or not (np.abs(numbers) <= 1).all():
            raise ValueError("a material with a colour out of range")

"""Pelvis, legs and place of a person over time, which direction vectors of the upper body do not hold.

Axes: metres, y up, the person faces +z on average, the person's left is at +x.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.rotations import rotate

JOINTS = (
    "pelvis",
    *("left_hip", "left_knee", "left_ankle", "left_foot"),
    *("right_hip", "right_knee", "right_ankle", "right_foot"),
)
"""Names of the joints, each after its parent; a foot is the joint at the ball of the foot."""

PARENTS = (-1, 0, 1, 2, 3, 0, 5, 6, 7)

OPTIONAL = ("left_foot", "right_foot")
"""Joints that a file may lack."""

ARRAYS = ("lower_offsets", "lower_rotations", "lower_translation")
"""Names of the arrays in a file of `Motion.save`."""

SOLE = 0.02
"""Metres from the ball of the foot to the floor."""

_MAX_METRES = 1e4
_TRUSTED = 0.1  # metres within which the height 0 of a file is assumed to be the floor
_LOWEST = 0.05  # quantile of the heights of the lower foot that counts as standing


@dataclasses.dataclass(frozen=True)
class LowerBody:
    """Rotations of pelvis and legs, and the place of the pelvis.

    Attributes:
        offsets: (10, 3) metres from the parent in the T-pose of each of `JOINTS`, zero for the pelvis, and from the
            pelvis to the joint `spine` of the skeletons on average, as the spine between them bends.
        rotations: (T, 9, 4) rotation of each joint in the world, none in the T-pose, as quaternions x, y, z, w.
        translation: (T, 3) position of the pelvis in metres, from the origin of the file.
    """

    offsets: np.ndarray
    rotations: np.ndarray
    translation: np.ndarray

    def __repr__(self) -> str:
        return f"LowerBody({len(self.rotations)} frames)"

    def positions(self) -> np.ndarray:
        """Compute (T, 9, 3) positions of `JOINTS` in metres from the origin of the file."""
        places = np.empty((*self.rotations.shape[:2], 3))
        places[:, 0] = self.translation
        for joint, parent in enumerate(PARENTS[1:], start=1):
            places[:, joint] = places[:, parent] + rotate(self.rotations[:, parent], self.offsets[joint])
        return places

    @property
    def floor(self) -> float:
        """Height of the floor in metres: 0, or where the feet stand if that is more than 10 cm from 0.

        SMPL-X measures `trans` from a point of its body model, so that 0 need not be the floor.
        """
        lowest = self.positions()[..., 1].min(axis=1)
        height = float(np.quantile(lowest, _LOWEST)) - SOLE
        return 0.0 if abs(height) <= _TRUSTED else height

    def check(self, num_frames: int) -> None:
        """Raise a UserError if an array has another shape, or values that are not finite, too large or no rotations."""
        shapes = ((len(JOINTS) + 1, 3), (num_frames, len(JOINTS), 4), (num_frames, 3))
        for name, array, shape in zip(ARRAYS, self.as_arrays().values(), shapes, strict=True):
            if array.shape != shape or array.dtype.kind != "f":
                raise UserError(
                    f"the motion's {name} are {array.dtype} of shape {array.shape}; expected floats, {shape}"
                )
            if not (np.abs(array) <= _MAX_METRES).all():
                raise UserError(f"the motion's {name} have values that are not finite or too large; export it again")
        if (np.abs(np.linalg.norm(self.rotations, axis=-1) - 1) > 1e-2).any():
            raise UserError("the motion's lower_rotations are no unit quaternions; export it again")

    def as_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of a file, by the names of `ARRAYS`."""
        return dict(zip(ARRAYS, (self.offsets, self.rotations, self.translation), strict=True))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> "LowerBody | None":
        """Return the lower body of a file, None where the file has none; some of `ARRAYS` are a UserError."""
        found = [arrays[name] for name in ARRAYS if name in arrays]
        if not found:
            return None
        if len(found) < len(ARRAYS):
            raise UserError(f"only some of {', '.join(ARRAYS)} are there; expected all or none")
        return cls(*found)

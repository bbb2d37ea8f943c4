"""The joints of SMPL-X, and a neutral body to which its rotations can be applied: an adult of 1.7 m in the T-pose.

Names, order and parents of the joints are those of SMPL-X; its licensed body model is not used. The lengths are rounded
from anthropometry: limbs between joint centres from De Leva (1996), finger bones from Buryanov and Kotiuk (2010),
heights of trunk and head from Drillis and Contini (1966).
"""

import os
import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, shown

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")

JOINTS = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle"),
    *("spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder"),
    *("right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "jaw", "left_eyeball"),
    "right_eyeball",
    *(f"{side}_{finger}_{number}" for side in ("left", "right") for finger in _FINGERS for number in (1, 2, 3)),
)
_BODY_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15)
PARENTS = _BODY_PARENTS + tuple(
    (20 if index < 40 else 21) if (index - 25) % 3 == 0 else index - 1 for index in range(25, 55)
)
HEAD = JOINTS.index("head")

# Points fixed on the head. In arrays of joint positions, all but the crown follow the joints, in this order.
FACE = ("nose", "right_eye", "left_eye", "right_ear", "left_ear", "head")
# Position in the T-pose of the joints on the midline and on the left, from the pelvis.
_REST = {
    "pelvis": (0.0, 0.0, 0.0),
    "left_hip": (0.085, -0.08, 0.0),
    "left_knee": (0.09, -0.48, 0.0),
    "left_ankle": (0.09, -0.90, -0.03),
    "left_foot": (0.10, -0.95, 0.10),
    "spine1": (0.0, 0.11, -0.02),
    "spine2": (0.0, 0.21, -0.03),
    "spine3": (0.0, 0.29, -0.03),
    "neck": (0.0, 0.49, -0.02),
    "head": (0.0, 0.585, 0.0),
    "jaw": (0.0, 0.575, 0.015),
    "left_eyeball": (0.031, 0.642, 0.075),
    "left_collar": (0.05, 0.43, -0.01),
    "left_shoulder": (0.175, 0.44, -0.03),
    "left_elbow": (0.455, 0.44, -0.03),
    "left_wrist": (0.715, 0.44, -0.03),
}
# From the left wrist to the first joint of each finger, and from there to the second and the third.
_HAND = {
    "index": ((0.090, 0.0, 0.024), (0.040, 0.0, 0.002), (0.022, 0.0, 0.001)),
    "middle": ((0.088, 0.003, 0.002), (0.045, 0.0, 0.0), (0.026, 0.0, 0.0)),
    "pinky": ((0.072, -0.004, -0.034), (0.032, 0.0, -0.006), (0.018, 0.0, -0.003)),
    "ring": ((0.081, 0.0, -0.017), (0.041, 0.0, -0.003), (0.026, 0.0, -0.002)),
    "thumb": ((0.024, -0.012, 0.026), (0.030, -0.008, 0.033), (0.024, -0.004, 0.020)),
}
_FACE_REST = {
    "nose": (0.0, 0.600, 0.115),
    "left_eye": (0.031, 0.642, 0.086),
    "left_ear": (0.068, 0.630, 0.003),
    "head": (0.0, 0.720, 0.0),
}

_NUM_VERTICES = 10475
_FACE_VERTICES = {"nose": 9120, "right_eye": 9929, "left_eye": 9448, "right_ear": 616, "left_ear": 6}
_ARRAYS = ("v_template", "shapedirs", "J_regressor", "kintree_table")
_MAX_BYTES = 1 << 29

# A file with all shape directions has 300 of them before 100 of expression, a short one 10 before 10.
_ALL_SHAPES, _ALL_DIRECTIONS, _FEW_SHAPES = 300, 400, 10


class Body(NamedTuple):
    """A body in the T-pose: metres, y up, facing +z, left on +x.

    Attributes:
        points: (61, 3) positions of the 55 joints and the 6 points of `FACE`.
        directions: (61, 3, n) displacement of the points for each of n shape coefficients.
    """

    points: np.ndarray
    directions: np.ndarray

    def shaped(self, betas: np.ndarray) -> np.ndarray:
        """Return the (61, 3) points of a person with shape coefficients (m,), of which the first n are used."""
        count = min(len(betas), self.directions.shape[-1])
        return self.points + self.directions[..., :count] @ betas[:count]


def template() -> Body:
    """Return the neutral body, which has no shape coefficients."""
    rest = {name: np.array(place) for name, place in _REST.items()}
    for finger, bones in _HAND.items():
        for number, place in enumerate(rest["left_wrist"] + np.cumsum(bones, axis=0), start=1):
            rest[f"left_{finger}_{number}"] = place
    points = [_side(name, rest) for name in JOINTS] + [_side(name, _FACE_REST) for name in FACE]
    return Body(np.array(points), np.zeros((len(points), 3, 0)))


def _side(name: str, left: dict) -> np.ndarray:
    return np.array(left[name.replace("right", "left")]) * (-1 if name.startswith("right") else 1, 1, 1)


def read_body_model(path: str | os.PathLike) -> Body:
    """Read the joints of an SMPL-X model file, J = R (v + S b) with the regressor R, and the points of the face.

    Raises:
        UserError: the file is a pickle, or not an SMPL-X model such as `SMPLX_NEUTRAL.npz`.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() in (".pkl", ".pickle"):
        raise UserError(
            f"{shown(path)} is a pickle, which may run code when it is read; give the .npz of the same download"
        )
    check_regular(path, "a body model such as SMPLX_NEUTRAL.npz")
    arrays = read_npz(path, max_bytes=_MAX_BYTES, names=_ARRAYS)
    if missing := [name for name in _ARRAYS if name not in arrays]:
        raise UserError(f"{shown(path)} has no {', '.join(missing)}; expected a body model such as SMPLX_NEUTRAL.npz")
    vertices, shapes, regressor, tree = (arrays[name] for name in _ARRAYS)
    found = (vertices.shape, shapes.shape[:2], shapes.ndim, regressor.shape, tree.shape)
    expected = ((_NUM_VERTICES, 3), (_NUM_VERTICES, 3), 3, (len(JOINTS), _NUM_VERTICES), (2, len(JOINTS)))
    # The parent of the root is -1 in an integer type that varies, so it is not compared.
    if found != expected or tree[0, 1:].tolist() != list(PARENTS[1:]):
        raise UserError(
            f"{shown(path)} is not a model of SMPL-X; expected one such as SMPLX_NEUTRAL.npz, with 55 joints"
        )
    if any(array.dtype.kind != "f" or not np.isfinite(array).all() for array in (vertices, shapes, regressor)):
        raise UserError(f"{shown(path)} has values that are not finite numbers; download the model again")
    count = _ALL_SHAPES if shapes.shape[-1] >= _ALL_DIRECTIONS else _FEW_SHAPES
    # The crown is the highest vertex of the T-pose.
    corners = [_FACE_VERTICES.get(name, int(vertices[:, 1].argmax())) for name in FACE]
    shapes = shapes[..., :count]
    directions = np.concatenate([np.tensordot(regressor, shapes, 1), shapes[corners]])
    return Body(np.concatenate([regressor @ vertices, vertices[corners]]), directions)

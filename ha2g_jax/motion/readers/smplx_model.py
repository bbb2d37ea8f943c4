"""Reader of a user's own SMPL-X body model, reduced to the joints and the points of the face."""

import os
import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, shown
from ha2g_jax.motion.readers.smplx_template import FACE, JOINTS, PARENTS, Body

_NUM_VERTICES = 10475
_FACE_VERTICES = {"nose": 9120, "right_eye": 9929, "left_eye": 9448, "right_ear": 616, "left_ear": 6}
_ARRAYS = ("v_template", "shapedirs", "J_regressor", "kintree_table")
_MAX_BYTES = 1 << 29

# A file with all shape directions has 300 of them before 100 of expression, a short one 10 before 10.
_ALL_SHAPES, _ALL_DIRECTIONS, _FEW_SHAPES = 300, 400, 10


def read_body_model(path: str | os.PathLike) -> Body:
    """Read the joints of an SMPL-X model file, J = R (v + S b) with the regressor R, and the points of the face.

    Args:
        path: path of `SMPLX_NEUTRAL.npz` or a similar file.

    Raises:
        UserError: the file is a pickle, or not an SMPL-X model.
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

"""A user's body model gives its own joints and shapes; what is not one is refused."""

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import FACE, PARENTS, read_body_model, template
from ha2g_jax.skeleton import load_skeleton

NUM_VERTICES = 10475
CORNERS = {"nose": 9120, "right_eye": 9929, "left_eye": 9448, "right_ear": 616, "left_ear": 6}


def _model(**changes) -> dict[str, np.ndarray]:
    """Arrays of a model file whose joints are those of the template, and whose first shape makes it larger."""
    points, _ = template()
    vertices = np.zeros((NUM_VERTICES, 3))
    regressor = np.zeros((55, NUM_VERTICES), np.float32)
    vertices[1000:1055] = points[:55]
    regressor[range(55), range(1000, 1055)] = 1
    for name, corner in CORNERS.items():
        vertices[corner] = points[55 + FACE.index(name)]
    vertices[5000] = points[60]
    shapes = np.zeros((NUM_VERTICES, 3, 20))
    shapes[..., 0] = 0.1 * vertices
    shapes[..., 10] = 99  # of the expression
    tree = np.array([PARENTS, range(55)], np.int64)
    tree[0, 0] = 2**32 - 1
    return {"v_template": vertices, "shapedirs": shapes, "J_regressor": regressor, "kintree_table": tree} | changes


def test_joints_and_face_come_from_the_model(tmp_path):
    np.savez_compressed(tmp_path / "SMPLX_NEUTRAL.npz", allow_pickle=True, parts=np.array({"arm": 1}), **_model())
    body = read_body_model(tmp_path / "SMPLX_NEUTRAL.npz")
    np.testing.assert_allclose(body.points, template().points, atol=1e-6)
    assert body.directions.shape == (61, 3, 10)
    # The file's own shape coefficients may be more, or fewer, than the model knows.
    np.testing.assert_allclose(body.shaped(np.array([2.0])), 1.2 * template().points, atol=1e-6)
    np.testing.assert_allclose(body.shaped(np.full(300, 1.0)), 1.1 * template().points, atol=1e-6)


def test_a_model_with_all_shapes_has_300(tmp_path):
    shapes = np.zeros((NUM_VERTICES, 3, 400), np.float16)
    np.savez_compressed(tmp_path / "a.npz", allow_pickle=True, **_model(shapedirs=shapes))
    assert read_body_model(tmp_path / "a.npz").directions.shape == (61, 3, 300)


def test_betas_of_a_file_shape_the_skeleton(tmp_path):
    np.savez(tmp_path / "model.npz", allow_pickle=True, **_model())
    body = read_body_model(tmp_path / "model.npz")
    skeleton = load_skeleton("ted_expressive")
    arms = []
    for first in (0.0, 1.0):
        np.savez(tmp_path / "a.npz", poses=np.zeros((2, 165)), betas=np.full(300, first), mocap_frame_rate=30)
        positions = read_smplx(tmp_path / "a.npz", skeleton, body, fps=15).positions[0]
        arms.append(np.linalg.norm(positions[skeleton.joint("left_elbow")] - positions[skeleton.joint("left_wrist")]))
    np.testing.assert_allclose(arms, [0.26, 0.286], rtol=1e-5)


BAD = {
    "no regressor": ({"J_regressor": None}, "has no J_regressor"),
    "sparse regressor": ({"J_regressor": np.array({"row": 1})}, "Python objects"),
    "SMPL": ({"v_template": np.zeros((6890, 3))}, "not a model of SMPL-X"),
    "other tree": ({"kintree_table": np.zeros((2, 55), np.int32)}, "not a model of SMPL-X"),
    "nan": ({"v_template": np.full((NUM_VERTICES, 3), np.nan)}, "not finite numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_other_files_are_refused_in_one_line(tmp_path, name):
    changes, message = BAD[name]
    arrays = {key: array for key, array in _model(**changes).items() if array is not None}
    np.savez_compressed(tmp_path / "a.npz", allow_pickle=True, **arrays)
    with pytest.raises(UserError, match=message) as error:
        read_body_model(tmp_path / "a.npz")
    assert "\n" not in str(error.value)


def test_a_pickle_is_refused_unread(tmp_path):
    (tmp_path / "SMPLX_NEUTRAL.pkl").write_bytes(b"cos\nsystem\n")
    with pytest.raises(UserError, match=r"is a pickle.*give the \.npz"):
        read_body_model(tmp_path / "SMPLX_NEUTRAL.pkl")

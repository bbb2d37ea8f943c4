"""The neutral body, the body model of a file, and the package smplx agree."""

import numpy as np
import pytest

from ha2g_jax.apps.genea import sample
from ha2g_jax.errors import UserError
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.armature import rest_positions, world
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import smplx as ours
from ha2g_jax.motion.readers import smplx_arrays
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import FACE, JOINTS, PARENTS, read_body_model, template
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.skeleton import load_skeleton, normalize

NUM_VERTICES = 10475
FRAMES, MILLIMETRE = 20, 1e-3
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
    all_shapes = _model(shapedirs=np.zeros((NUM_VERTICES, 3, 400), np.float16))
    np.savez(tmp_path / "all.npz", allow_pickle=True, **all_shapes)
    assert read_body_model(tmp_path / "all.npz").directions.shape == (61, 3, 300)
    # The file's own shape coefficients may be more, or fewer, than the model knows.
    np.testing.assert_allclose(body.shaped(np.array([2.0])), 1.2 * template().points, atol=1e-6)
    np.testing.assert_allclose(body.shaped(np.full(300, 1.0)), 1.1 * template().points, atol=1e-6)


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
    "SMPL": ({"v_template": np.zeros((6890, 3))}, "not a model of SMPL-X"),
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


def write_model(path, joints: np.ndarray) -> None:
    """Write all arrays that the package asks for; each joint is a random mean of the vertices about it."""
    random = np.random.default_rng(0)
    owner = np.arange(NUM_VERTICES) % len(JOINTS)
    vertices = joints[owner] + random.normal(0, 0.05, (NUM_VERTICES, 3))
    regressor = np.where(owner == np.arange(len(JOINTS))[:, None], random.random((len(JOINTS), NUM_VERTICES)), 0)
    regressor /= regressor.sum(axis=1, keepdims=True)
    vertices += (joints - regressor @ vertices)[owner]
    arrays = _model(v_template=vertices, J_regressor=regressor)
    arrays |= {f"hands_components{side}": np.zeros((45, 45)) for side in "lr"}
    arrays |= {f"hands_mean{side}": np.zeros(45) for side in "lr"}
    arrays |= {
        "shapedirs": random.normal(0, 0.01, (NUM_VERTICES, 3, 20)),
        "posedirs": random.normal(0, 1e-3, (NUM_VERTICES, 3, 486)),
        "weights": np.eye(len(JOINTS))[owner],
        "f": random.integers(0, NUM_VERTICES, (100, 3)),
        "lmk_faces_idx": np.zeros(51, int),
        "lmk_bary_coords": np.full((51, 3), 1 / 3),
        "dynamic_lmk_faces_idx": np.zeros((79, 17), int),
        "dynamic_lmk_bary_coords": np.full((79, 17, 3), 1 / 3),
    }
    np.savez(path, allow_pickle=True, **arrays)


@pytest.fixture
def package():
    """A function from a body model and the arrays of a file to the joints (T, 55, 3) of the package."""
    torch, smplx = pytest.importorskip("torch"), pytest.importorskip("smplx")

    def joints(path, arrays) -> np.ndarray:
        poses = arrays["poses"].reshape(len(arrays["poses"]), -1)
        parts = {
            "global_orient": poses[:, :3],
            "body_pose": poses[:, 3:66],
            "jaw_pose": poses[:, 66:69],
            "leye_pose": poses[:, 69:72],
            "reye_pose": poses[:, 72:75],
            "left_hand_pose": poses[:, 75:120],
            "right_hand_pose": poses[:, 120:],
            "transl": arrays["trans"],
            "betas": np.repeat(arrays["betas"][None, :10], len(poses), axis=0),
            "expression": np.zeros((len(poses), 10)),
        }
        model = smplx.SMPLX(str(path), use_pca=False, flat_hand_mean=True, batch_size=len(poses), dtype=torch.float64)
        values = {name: torch.tensor(np.asarray(value), dtype=torch.float64) for name, value in parts.items()}
        with torch.no_grad():
            return model(**values).joints[:, : len(JOINTS)].numpy()

    return joints


@pytest.mark.torch
def test_what_is_read_has_the_joints_of_the_package(package, tmp_path):
    random = np.random.default_rng(1)
    write_model(tmp_path / "SMPLX_NEUTRAL.npz", template().points[: len(JOINTS)])
    arrays = {
        "poses": random.normal(0, 0.4, (FRAMES, 165)),
        "trans": random.normal(0, 1, (FRAMES, 3)),
        "betas": random.normal(0, 2, 10),
    }
    theirs = package(tmp_path / "SMPLX_NEUTRAL.npz", arrays)
    read = smplx_arrays.to_arrays(arrays | {"mocap_frame_rate": np.array(30)})
    body = read_body_model(tmp_path / "SMPLX_NEUTRAL.npz")
    found = ours.joints_at_origin(read, body.shaped(read.betas), 30) + arrays["trans"][:, None]
    assert np.abs(body.shaped(read.betas)[:55] - template().points[:55]).max() > 5 * MILLIMETRE  # shapes do something
    np.testing.assert_allclose(found, theirs, atol=MILLIMETRE / 1000)


@pytest.mark.torch
def test_what_is_written_has_our_joints_in_the_package(package, tmp_path):
    """A pack of `ha2g genea`, read by the package with a body that has the bones of the rig."""
    skeleton, random = load_skeleton("ted_expressive"), np.random.default_rng(2)
    waves = np.sin(np.arange(FRAMES)[:, None, None] * random.uniform(0.1, 0.4, (1, skeleton.num_bones, 3)))
    directions = normalize(skeleton.mean_directions + 0.2 * waves)
    motion = Motion.from_directions(skeleton, directions, 30)
    animation = retarget(solver.animate(motion), rigs.load_rig("smplx"))
    assert tuple(PARENTS) == tuple(animation.armature.parents)
    _, places = world(animation)
    sample.from_motion(motion, FRAMES).write(tmp_path / "x.npz")
    write_model(tmp_path / "SMPLX_NEUTRAL.npz", rest_positions(animation.armature)[1])
    with np.load(tmp_path / "x.npz") as arrays:
        theirs = package(tmp_path / "SMPLX_NEUTRAL.npz", dict(arrays))
    np.testing.assert_allclose(theirs - theirs[:, :1], places - places[:, :1], atol=MILLIMETRE / 10)

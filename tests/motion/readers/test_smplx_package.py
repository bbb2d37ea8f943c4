"""Joints of SMPL-X agree with those of the `smplx` package, to which a made-up body model of random shapes is given.

The package needs a body model with a licence of its own, which is not here; what is tested holds for any model.
"""

from typing import Any

import numpy as np
import pytest

from ha2g_jax.apps.genea import sample
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import smplx as ours
from ha2g_jax.motion.readers import smplx_arrays
from ha2g_jax.motion.readers.smplx_body import JOINTS, PARENTS, read_body_model, template
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.skeleton import load_skeleton, normalize

pytestmark = pytest.mark.torch
VERTICES, FRAMES = 10475, 20
MILLIMETRE = 1e-3


def write_model(path, joints: np.ndarray, seed: int = 0) -> None:
    """Write all arrays that the package asks for; each joint is a random mean of the vertices about it."""
    random = np.random.default_rng(seed)
    owner = np.arange(VERTICES) % len(JOINTS)
    vertices = joints[owner] + random.normal(0, 0.05, (VERTICES, 3))
    regressor = np.where(owner == np.arange(len(JOINTS))[:, None], random.random((len(JOINTS), VERTICES)), 0)
    regressor /= regressor.sum(axis=1, keepdims=True)
    vertices += (joints - regressor @ vertices)[owner]
    tree = np.array([PARENTS, range(len(JOINTS))], np.int64)
    tree[0, 0] = 2**32 - 1
    hands: dict[str, Any] = {f"hands_{part}{side}": np.zeros(shape) for part, shape in HANDS.items() for side in "lr"}
    np.savez(
        path,
        v_template=vertices,
        shapedirs=random.normal(0, 0.01, (VERTICES, 3, 20)),
        posedirs=random.normal(0, 1e-3, (VERTICES, 3, 486)),
        J_regressor=regressor,
        kintree_table=tree,
        weights=np.eye(len(JOINTS))[owner],
        f=random.integers(0, VERTICES, (100, 3)),
        lmk_faces_idx=np.zeros(51, int),
        lmk_bary_coords=np.full((51, 3), 1 / 3),
        dynamic_lmk_faces_idx=np.zeros((79, 17), int),
        dynamic_lmk_bary_coords=np.full((79, 17, 3), 1 / 3),
        **hands,
    )


HANDS = {"components": (45, 45), "mean": (45,)}


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
    offsets = animation.armature.offsets
    rest = np.zeros_like(offsets)
    for joint, parent in enumerate(PARENTS[1:], start=1):
        rest[joint] = rest[parent] + offsets[joint]
    write_model(tmp_path / "SMPLX_NEUTRAL.npz", rest)
    with np.load(tmp_path / "x.npz") as arrays:
        theirs = package(tmp_path / "SMPLX_NEUTRAL.npz", dict(arrays))
    np.testing.assert_allclose(theirs - theirs[:, :1], places - places[:, :1], atol=MILLIMETRE / 10)

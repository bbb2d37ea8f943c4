"""SMPL-X poses become the positions that the rotations mean, on a body with the proportions of a person."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import FACE, JOINTS, PARENTS, template
from ha2g_jax.skeleton import load_skeleton

EXPRESSIVE, GESTURE = load_skeleton("ted_expressive"), load_skeleton("ted_gesture")
BODY = template()
RNG = np.random.default_rng(0)


def _poses(num_frames: int, **axis_angles) -> np.ndarray:
    """(frames, 165) T-poses, but for joints rotated by an axis-angle."""
    poses = np.zeros((num_frames, len(JOINTS), 3))
    for joint, axis_angle in axis_angles.items():
        poses[:, JOINTS.index(joint)] = axis_angle
    return poses.reshape(num_frames, -1)


def _read(folder, skeleton=EXPRESSIVE, fps=30.0, source_fps=None, up=None, **arrays) -> dict[str, np.ndarray]:
    """Joint -> (frames, 3) of a file with these arrays."""
    np.savez(folder / "a.npz", allow_pickle=True, **({"mocap_frame_rate": 30} | arrays))
    motion = read_smplx(folder / "a.npz", skeleton, BODY, fps=fps, source_fps=source_fps, up=up)
    return dict(zip(skeleton.joints, motion.positions.swapaxes(0, 1), strict=True))


def _directions(joints: dict[str, np.ndarray], start: str, end: str) -> np.ndarray:
    bone = joints[end] - joints[start]
    return bone / np.linalg.norm(bone, axis=-1, keepdims=True)


def test_the_template_is_a_tree_of_symmetric_bones_like_an_adults():
    assert len(JOINTS) == len(PARENTS) == 55
    assert all(parent < joint for joint, parent in enumerate(PARENTS))
    names = (*JOINTS, *FACE)
    left = np.array([point for name, point in zip(names, BODY.points) if name.startswith("left")])
    right = np.array([point for name, point in zip(names, BODY.points) if name.startswith("right")])
    np.testing.assert_array_equal(left * [-1, 1, 1], right)
    assert BODY.points[:, 1].max() - BODY.points[:, 1].min() == pytest.approx(1.7, abs=0.05)


@pytest.mark.parametrize(("skeleton", "left", "ahead"), [(EXPRESSIVE, 1, -1), (GESTURE, -1, 1)])
def test_a_t_pose_stands_upright_and_faces_as_the_skeleton_does(tmp_path, skeleton, left, ahead):
    joints = _read(tmp_path, skeleton, poses=_poses(2))
    np.testing.assert_allclose(joints["spine"], skeleton.mean_pose[[0, 0]], atol=1e-6)
    for start, end in (("left_shoulder", "left_elbow"), ("left_elbow", "left_wrist")):
        np.testing.assert_allclose(_directions(joints, start, end), [[left, 0, 0]] * 2, atol=1e-6)
    assert (_directions(joints, "spine", "neck")[:, 1] < -0.99).all()
    assert (_directions(joints, "neck", "nose")[:, 2] * ahead > 0.5).all()


def test_a_t_pose_is_written_as_it_was_read(tmp_path):
    """Our T-pose has an upright trunk and level palms, that of SMPL-X has not; the rig accounts for it."""
    np.savez(tmp_path / "a.npz", poses=_poses(2), mocap_frame_rate=30)
    export(read_motion(tmp_path / "a.npz"), tmp_path / "b.npz", rig="smplx")
    written = np.load(tmp_path / "b.npz")["poses"].reshape(-1, len(JOINTS), 3)
    of_another_shape = [
        JOINTS.index(name)
        for name in ("neck", "head", *(f"{side}_thumb_{part}" for side in ("left", "right") for part in (1, 2)))
    ]
    np.testing.assert_allclose(np.delete(written, of_another_shape, axis=1), 0, atol=1e-4)
    np.testing.assert_allclose(written, 0, atol=0.04)


def test_the_face_is_fixed_on_the_head(tmp_path):
    poses = np.tile(_poses(1), (3, 1)).reshape(3, 55, 3)
    poses[1, JOINTS.index("head")] = (0, np.pi / 2, 0)
    poses[2, JOINTS.index("jaw")] = (0.4, 0, 0)
    joints = _read(tmp_path, poses=poses.reshape(3, -1))
    ahead = joints["nose"] - (joints["left_ear"] + joints["right_ear"]) / 2
    assert ahead[0, 2] < -0.1
    assert ahead[1, 0] > 0.1  # to the left
    np.testing.assert_allclose(ahead[[0, 1], [0, 2]], 0, atol=1e-6)
    np.testing.assert_array_equal(joints["nose"][2], joints["nose"][0])


def test_bones_keep_their_length_at_any_frame_rate_and_known_frames_their_pose(tmp_path):
    poses = RNG.uniform(-1, 1, (31, 55, 3))
    poses[:, :10] *= 0.1
    slow, same = (_read(tmp_path, poses=poses.reshape(31, -1), fps=fps) for fps in (12, 30))
    assert len(slow["neck"]) == 12
    for parent, child in EXPRESSIVE.bones:
        if EXPRESSIVE.joints[child] in ("nose", "left_shoulder", "right_shoulder"):
            continue  # no bones of SMPL-X
        lengths = np.linalg.norm(slow[EXPRESSIVE.joints[child]] - slow[EXPRESSIVE.joints[parent]], axis=-1)
        np.testing.assert_allclose(lengths, lengths[0], atol=1e-6)
    # Each second frame at 12 fps is each fifth of the file; only the mean facing differs.
    reach = [np.linalg.norm(joints["left_wrist"] - joints["right_elbow"], axis=-1) for joints in (slow, same)]
    np.testing.assert_allclose(reach[0][::2], reach[1][:30:5], atol=1e-6)


def test_half_way_between_two_frames_an_elbow_has_turned_by_half(tmp_path):
    poses = np.stack([_poses(1)[0], _poses(1, left_elbow=(0, -np.pi / 2, 0))[0]])
    joints = _read(tmp_path, poses=poses, fps=60)
    cosines = _directions(joints, "left_elbow", "left_wrist") @ _directions(joints, "left_shoulder", "left_elbow")[0]
    np.testing.assert_allclose(cosines, np.cos([0, np.pi / 4, np.pi / 2, np.pi / 2]), atol=1e-6)


TURNS = {"y": (0, 0, 0), "z": (np.pi / 2, 0, 0), "-y": (0, 0, np.pi), "-z": (-np.pi / 2, 0, 0), "x": (0, 0, -np.pi / 2)}


@pytest.mark.parametrize("up", TURNS)
def test_the_way_up_is_found(tmp_path, up):
    np.savez(tmp_path / "a.npz", poses=_poses(2, pelvis=TURNS[up]), mocap_framerate=120.0)
    motion = read_smplx(tmp_path / "a.npz", EXPRESSIVE, BODY, fps=15)
    assert motion.up == up
    np.testing.assert_allclose(motion.positions[0], _straight(tmp_path), atol=1e-6)


def _straight(folder) -> np.ndarray:
    return np.stack([place[0] for place in _read(folder, poses=_poses(1)).values()])


def _positions_file(folder, count: int, suffix: str = ".npz", **more):
    """The T-pose in a camera's axes, y down and away from the camera on z, as a pose estimator gives it."""
    points = BODY.points[: min(count, 60)] * [1, -1, -1] + [0.3, 0.2, 4.0]
    frames = np.tile(np.concatenate([points, np.zeros((count - len(points), 3))]), (4, 1, 1)).astype(np.float32)
    path = folder / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, frames)
    else:
        np.savez(path, allow_pickle=True, **({"joints": frames} | more))
    return path


@pytest.mark.parametrize(("count", "suffix"), [(55, ".npz"), (76, ".npz"), (127, ".npz"), (144, ".npz"), (144, ".npy")])
def test_positions_of_an_estimator_give_the_same_joints(tmp_path, count, suffix):
    motion = read_smplx(_positions_file(tmp_path, count, suffix), EXPRESSIVE, BODY, fps=15, source_fps=15)
    assert (motion.up, motion.kind) == ("-y", f"positions of {count} joints")
    measured = [joint not in FACE or count > 55 for joint in EXPRESSIVE.joints]
    np.testing.assert_allclose(motion.positions[0][measured], _straight(tmp_path)[measured], atol=1e-6)
    joints = dict(zip(EXPRESSIVE.joints, motion.positions[0], strict=True))
    assert joints["nose"][2] < joints["neck"][2] - 0.05
    assert joints["left_ear"][0] > 0.03 > -0.03 > joints["right_ear"][0]
    assert joints["left_eye"][1] < joints["neck"][1] - 0.05


def test_positions_of_an_estimator_give_a_head_to_the_other_skeleton(tmp_path):
    motion = read_smplx(_positions_file(tmp_path, 127, fps=25), GESTURE, BODY, fps=15)
    joints = dict(zip(GESTURE.joints, motion.positions[0], strict=True))
    assert joints["head"][1] < joints["nose"][1] - 0.05 < joints["neck"][1] - 0.1


def _bad_frame(value: float) -> np.ndarray:
    poses = _poses(5)
    poses[3, 7] = value
    return poses


BAD = {
    "body of SMPL": ({"poses": np.zeros((4, 72))}, r"poses has shape \(4, 72\); expected \(frames, 165\)"),
    "nan": ({"poses": _bad_frame(np.nan)}, "frame 4 of poses"),
    "hours": ({"poses": _poses(9000), "mocap_frame_rate": 1}, "150 minutes at 1 frames per second"),
    "endless": ({"joints": np.zeros((400_001, 55, 3), np.float16)}, "has 400001 frames"),
    "rate of 0": ({"poses": _poses(4), "mocap_frame_rate": 0}, "mocap_frame_rate is '0'"),
    "trans of other length": ({"poses": _poses(4), "trans": np.zeros((3, 3))}, r"trans has shape \(3, 3\)"),
    "millimetres": (
        {"joints": np.tile(BODY.points[:55] * 1000, (3, 1, 1))},
        r"the metres in one unit \(--unit\)",
    ),
    "degrees": ({"poses": np.degrees(_poses(4) + 0.5)}, "many turns, such as those in degrees; expected radians"),
    "places in millimetres": (
        {"poses": _poses(4), "trans": np.linspace(0, 3000, 12).reshape(4, 3)},
        r"moves more than 1000 m; give the metres in one unit \(--unit\)",
    ),
    "objects": ({"poses": np.array([None, 1])}, "Python objects"),
}


@pytest.mark.parametrize("name", BAD)
def test_files_that_are_no_motion_are_refused_in_one_line(tmp_path, name):
    arrays, message = BAD[name]
    with pytest.raises(UserError, match=message) as error:
        _read(tmp_path, **arrays)
    assert str(error.value).count(str(tmp_path / "a.npz")) == 1
    assert "\n" not in str(error.value)


def test_the_chest_above_the_pelvis_is_that_of_the_bent_spine(tmp_path):
    poses, bend = np.zeros((4, 55, 3)), 0.2
    spine = [JOINTS.index(name) for name in ("spine1", "spine2", "spine3")]
    poses[:, spine[:2], 0] = bend
    np.savez(tmp_path / "a.npz", poses=poses.reshape(4, -1), mocap_frame_rate=30)
    lower = read_smplx(tmp_path / "a.npz", EXPRESSIVE, BODY, fps=30).lower
    assert lower is not None
    first, second, third = BODY.points[spine] - BODY.points[0]
    turned = Rotation.from_euler("x", [[bend], [2 * bend]])
    expected = first + turned[0].apply(second - first) + turned[1].apply(third - second)
    np.testing.assert_allclose(lower.offsets[-1], expected, atol=1e-4)


def test_a_file_without_frame_rate_asks_for_it(tmp_path):
    np.savez(tmp_path / "a.npz", poses=_poses(4))
    with pytest.raises(UserError, match="--source-fps"):
        read_smplx(tmp_path / "a.npz", EXPRESSIVE, BODY, fps=15)
    assert read_smplx(tmp_path / "a.npz", EXPRESSIVE, BODY, fps=15, source_fps=60).seconds == pytest.approx(4 / 60)


def test_a_rate_for_each_frame_and_an_empty_shape_are_read(tmp_path):
    np.savez(tmp_path / "a.npz", poses=_poses(4), mocap_frame_rate=np.full(4, 60.0), betas=np.zeros((0, 10)))
    assert read_smplx(tmp_path / "a.npz", EXPRESSIVE, BODY, fps=15).seconds == pytest.approx(4 / 60)

"""Axes, left and right, and the face of captured bodies."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from motion.readers.conftest import BEAT, GENEA, MIXAMO, ZEROEGGS, bvh
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.body import FACE, add_face, choose_up, to_skeleton_axes
from ha2g_jax.motion.readers.smplx_body import JOINTS

# Degrees about x, y and z that take y up to another axis.
TO_UP = {"y": (0, 0, 0), "-y": (0, 0, 180), "z": (90, 0, 0), "-z": (-90, 0, 0), "x": (0, 0, -90), "-x": (0, 0, 90)}


def mocap(skeleton, yaw=0.0, sway=0.0) -> np.ndarray:
    """40 frames of the mean pose in a world with y up, rotated by `yaw` and to and fro by `sway` degrees."""
    flip = np.array([1, -1, -1]) if skeleton.name == "ted_expressive" else np.array([-1, -1, 1])
    pose = skeleton.mean_pose * flip  # y up, facing +z, the left at +x
    angles = yaw + sway * np.sin(np.arange(40))
    return np.stack([Rotation.from_euler("y", angle, degrees=True).apply(pose) for angle in angles])


@pytest.mark.parametrize("up", TO_UP)
@pytest.mark.parametrize("yaw", [0.0, 100.0, -170.0])
def test_the_mean_pose_comes_back(skeleton, up, yaw):
    positions = Rotation.from_euler("xyz", TO_UP[up], degrees=True).apply(mocap(skeleton, yaw).reshape(-1, 3))
    positions = positions.reshape(40, -1, 3) + np.array([5.0, 2.0, -3.0])
    assert choose_up(positions, skeleton, None) == choose_up(positions, skeleton, up) == up
    with pytest.raises(UserError, match=f"but the trunk points along {up}; correct it"):
        choose_up(positions, skeleton, "z" if up != "z" else "x")
    found = to_skeleton_axes(positions, skeleton, up=up)
    pose = skeleton.mean_pose
    shoulders = pose[skeleton.joint("left_shoulder")] - pose[skeleton.joint("right_shoulder")]
    own_yaw = np.arctan2(shoulders[2], abs(shoulders[0]))  # the mean pose's shoulders are not quite square
    expected = Rotation.from_euler("y", np.sign(shoulders[0]) * own_yaw).apply(pose - pose[0])
    np.testing.assert_allclose(found[0], expected + pose[0], atol=1e-6)


def test_one_rigid_motion_for_the_recording(skeleton):
    positions = mocap(skeleton, yaw=30, sway=40) + np.linspace(0, 1, 40)[:, None, None]
    found = to_skeleton_axes(positions, skeleton)
    assert found.dtype == np.float64
    before, after = (motion.reshape(-1, 3)[::7] for motion in (positions, found))
    np.testing.assert_allclose(
        np.linalg.norm(before[:, None] - before, axis=-1), np.linalg.norm(after[:, None] - after, axis=-1), atol=1e-9
    )
    np.testing.assert_allclose(found[:, 0].mean(axis=0), skeleton.mean_pose[0], atol=1e-6)


def test_somebody_who_turns_round_and_round(skeleton):
    """Facing nowhere on average, such a person faces as the mean pose at first."""
    positions = np.concatenate([mocap(skeleton, yaw)[:1] for yaw in range(0, 360, 10)])
    found = to_skeleton_axes(positions, skeleton)
    left = skeleton.joint("left_shoulder"), skeleton.joint("right_shoulder")
    across = found[0, left[0]] - found[0, left[1]]
    assert np.sign(across[0]) == np.sign(skeleton.mean_pose[left[0], 0]) and abs(across[2]) < 1e-6


def test_shoulders_one_above_the_other(skeleton):
    lying = Rotation.from_euler("z", 90, degrees=True).apply(mocap(skeleton).reshape(-1, 3)).reshape(40, -1, 3)
    with pytest.raises(UserError, match="shoulders lie along the y axis"):
        to_skeleton_axes(lying, skeleton)


@pytest.mark.parametrize(("joint", "has_legs"), [("ToeBase", True), ("Foot", False), ("Leg", False)])
def test_bones_of_legs_without_a_length(joint, has_legs, person, tmp_path):
    """A toe at the ankle is no toe; a knee at the hip leaves no leg to turn."""
    text, count = re.subn(rf"((?:Left|Right){joint}\s*\{{\s*OFFSET)[^\n]*", r"\1 0 0 0", bvh(person, MIXAMO))
    assert count == 2
    (tmp_path / "x.bvh").write_text(text)
    found = read_motion(tmp_path / "x.bvh")
    assert (found.lower is not None) == has_legs
    if found.lower is not None:
        assert np.isfinite(found.lower.positions()).all()


def head_of(positions, skeleton, head_angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A head joint over the middle of the shoulders and its rotations, from rotation vectors in degrees (T, 3)."""
    shoulders = [skeleton.joint("left_shoulder"), skeleton.joint("right_shoulder")]
    place = positions[:, shoulders].mean(axis=1) + np.array([0, 0.15, 0])
    return place, Rotation.from_rotvec(head_angles, degrees=True).as_matrix()


def test_the_face_turns_with_the_head(skeleton):
    """A nod of 20 degrees, a rotation of 30: the nose goes where a nose goes, and the face keeps its shape."""
    positions = mocap(skeleton)
    head_angles = np.zeros((40, 3))
    head_angles[0], head_angles[1] = [0, 30, 0], [0, -30, 0]  # to the person's left and right, y up
    head_angles[2], head_angles[3] = [20, 0, 0], [-20, 0, 0]  # down and up
    place, rotations = head_of(positions, skeleton, head_angles)
    face = add_face(positions, place, rotations, skeleton)
    found = to_skeleton_axes(face, skeleton)
    nose, left = skeleton.joint("nose"), np.sign(skeleton.mean_pose[skeleton.joint("left_shoulder"), 0])
    rest = found[10, nose]
    assert left * (found[0, nose, 0] - rest[0]) > 0.02 and left * (found[1, nose, 0] - rest[0]) < -0.02
    assert found[2, nose, 1] - rest[1] > 0.005 and found[3, nose, 1] - rest[1] < -0.005  # y points down
    joints = [index for index, name in enumerate(skeleton.joints) if name in FACE]
    lengths = np.linalg.norm(face[:, joints] - face[:, joints[:1]], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=1e-9)
    others = [joint for joint in range(skeleton.num_joints) if joint not in joints]
    np.testing.assert_array_equal(face[:, others], positions[:, others])


def test_on_average_the_face_is_the_mean_poses(skeleton):
    positions = mocap(skeleton, sway=25)
    angles = 25 * np.sin(np.arange(40))
    head_angles = np.stack([0 * angles, angles, 0 * angles], axis=-1)  # the head goes with the body
    found = to_skeleton_axes(add_face(positions, *head_of(positions, skeleton, head_angles), skeleton), skeleton)
    shoulders = [skeleton.joint("left_shoulder"), skeleton.joint("right_shoulder")]
    middle, expected = found[:, shoulders].mean(axis=1), skeleton.mean_pose[shoulders].mean(axis=0)
    for joint in (index for index, name in enumerate(skeleton.joints) if name in FACE):
        distance = np.linalg.norm(skeleton.mean_pose[joint] - expected)
        np.testing.assert_allclose(np.linalg.norm(found[:, joint] - middle, axis=-1), distance, atol=0.01)


def test_the_rest_pose_of_the_head_makes_no_difference(skeleton):
    """Bones stored along their own axes: any fixed rotation may come before the head's."""
    positions = mocap(skeleton, yaw=20, sway=20)
    head_angles = 15 * np.sin(np.arange(120).reshape(40, 3))
    place, rotations = head_of(positions, skeleton, head_angles)
    rest = Rotation.from_rotvec([70, -120, 40], degrees=True).as_matrix()
    turned = add_face(positions, place, rotations @ rest, skeleton)
    np.testing.assert_allclose(add_face(positions, place, rotations, skeleton), turned, atol=1e-9)


NAMES = {"mixamo": MIXAMO, "zeroeggs": ZEROEGGS, "beat": BEAT, "genea": GENEA, "ha2g": None}
# Axes x, y, z of a file as rows, where the person's left is x, up is y and ahead is z: all that lie along those.
AXES = [
    np.diag(signs)[list(order)]
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1, -1), repeat=3)
]
RIGHT = [axes for axes in AXES if np.linalg.det(axes) > 0]
LEFT = [axes for axes in AXES if np.linalg.det(axes) < 0]


def up_of(axes) -> str:
    """The axis of the file that points up, such as "-z"."""
    row = int(np.abs(axes[:, 1]).argmax())
    return "-" * int(axes[row, 1] < 0) + "xyz"[row]


def write(path, person, names, axes):
    path.write_text(bvh(person, NAMES[names], axes))


def check_mirrored(path):
    with pytest.raises(UserError, match=r"x\.bvh: left and right are mirrored, as in left-handed axes") as caught:
        read_motion(path)
    assert "\n" not in str(caught.value)


@pytest.fixture
def straight(person):
    """The person with straight fingers, whose hands cannot tell."""
    fingers = [index for index, name in enumerate(JOINTS) if index >= 25]
    poses = person.poses.copy()
    poses[:, fingers] = 0
    return dataclasses.replace(person, poses=poses)


Y_UP, Z_UP = np.eye(3), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRRORED = np.diag([-1, 1, 1])


@pytest.mark.parametrize("names", NAMES)
@pytest.mark.parametrize("axes", [Y_UP, Z_UP], ids=["y", "z"])
def test_each_joint_map_tells_the_hands(names, axes, person, tmp_path):
    if names == "ha2g" and up_of(axes) != "y":
        pytest.skip("the map ha2g is of our own files, whose axes are known")
    path = tmp_path / "x.bvh"
    write(path, person, names, axes)
    facts = read_motion(path).meta["read_from"]
    assert (facts["joint_map"], facts["up"]) == (names, up_of(axes))
    write(path, person, names, MIRRORED @ axes)
    check_mirrored(path)


@pytest.mark.parametrize("axes", RIGHT, ids=str)
def test_right_handed_axes_are_read_whatever_is_up(axes, person, tmp_path):
    path, other = tmp_path / "x.bvh", tmp_path / "y.bvh"
    write(path, person, "mixamo", axes)
    write(other, person, "mixamo", Y_UP)
    motion, expected = read_motion(path), read_motion(other)
    assert motion.meta["read_from"]["up"] == up_of(axes)
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-4)
    assert motion.lower is not None and expected.lower is not None
    np.testing.assert_allclose(motion.lower.positions()[:, :, 1], expected.lower.positions()[:, :, 1], atol=1e-4)


@pytest.mark.parametrize("axes", LEFT, ids=str)
def test_left_handed_axes_are_named_whatever_is_up(axes, person, tmp_path):
    write(tmp_path / "x.bvh", person, "mixamo", axes)
    check_mirrored(tmp_path / "x.bvh")


def test_a_warning_names_mirrored_positions(person, tmp_path, caplog):
    write(tmp_path / "x.bvh", person, "mixamo", Y_UP)
    motion = read_motion(tmp_path / "x.bvh")
    for name, axes in (("good", Y_UP), ("mirrored", MIRRORED)):
        values = {"positions": motion.positions @ axes, "fps": motion.fps, "joint_names": motion.joint_names}
        np.savez(tmp_path / f"{name}.npz", **values)
        read_motion(tmp_path / f"{name}.npz")
    (record,) = caplog.records
    assert "mirrored.npz looks mirrored, as in left-handed axes" in record.getMessage()


@pytest.mark.parametrize("names", ["mixamo", "genea"])
def test_feet_tell_where_fingers_are_straight(names, straight, tmp_path):
    path = tmp_path / "x.bvh"
    write(path, straight, names, Y_UP)
    read_motion(path)
    write(path, straight, names, MIRRORED)
    check_mirrored(path)

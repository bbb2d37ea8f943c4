"""Tables of rigs hold the names and rest poses of their programs, and the motion on them is the motion."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ha2g_jax.motion import lower_body, rigs, rotations
from ha2g_jax.motion.armature import Animation, add_lower_body, ha2g_armature, rest_positions, world
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.skeleton import load_skeleton

SIDES = {"left": 1.0, "right": -1.0}
FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# A few names of each program, from its documentation, and the joint of ours each follows.
NAMES = {
    "mixamo": {"spine": "mixamorig:Spine2", "right_index_2": "mixamorig:RightHandIndex2"},
    "unreal": {"spine": "spine_05", "left_shoulder": "upperarm_l", "right_index_0": "index_metacarpal_r"},
    "unity": {"spine": "UpperChest", "left_elbow": "LeftLowerArm", "right_pinky_3": "RightLittleDistal"},
    "vrm": {"spine": "upperChest", "left_thumb_1": "leftThumbMetacarpal", "right_ring_2": "rightRingIntermediate"},
    "smplx": {"spine": "spine3", "left_clavicle": "left_collar", "right_middle_3": "right_middle3"},
}
COUNTS = {"mixamo": 65, "unreal": 64, "unity": 52, "vrm": 52, "smplx": 55}
PROGRAMS = tuple(COUNTS)
# Bones without which an avatar is no VRM (VRMC_vrm-1.0, humanoid.md).
VRM_REQUIRED = ["hips", "spine", "head"] + [
    side + part for side in SIDES for part in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
]


def make_animation(skeleton: str = "ted_expressive", size: float = 0.3, frames: int = 6) -> Animation:
    """Every joint that carries a bone is turned at random; those of the palm hardly, as in people."""
    armature = ha2g_armature(load_skeleton(skeleton))
    vectors = np.random.default_rng(1).normal(0, size, (frames, len(armature.joints), 3))
    still = [index for index in range(len(armature.joints)) if index not in armature.parents]
    still += [armature.joint(name) for name in ("neck", "nose")]
    vectors[:, still] = 0
    local = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_quat().reshape(frames, -1, 4)
    return Animation(armature, local, np.zeros((frames, 3)), 15.0, {"seed": 1})


@pytest.mark.parametrize("name", [name for name in rigs.RIGS if name != "ha2g"])
def test_a_table_names_joints_of_ours_and_has_each_after_its_parent(name):
    rig = rigs.load_rig(name)
    assert rig.name == name
    assert len({joint.name for joint in rig.joints}) == len(rig.joints)
    assert [joint.parent for joint in rig.joints].count(-1) == 1
    assert all(joint.parent < index for index, joint in enumerate(rig.joints))
    assert all(0 < joint.weight <= 1 for joint in rig.joints)
    lower = {"pelvis", *(f"{side}_{part}" for side in SIDES for part in ("hip", "knee", "ankle", "foot"))}
    ours = {*ha2g_armature(load_skeleton("ted_expressive")).joints, *lower}
    assert {joint.carries for joint in rig.joints} | {joint.place for joint in rig.joints} <= ours | {None}


@pytest.mark.parametrize("name", [name for name in PROGRAMS if not rigs.load_rig(name).has_own_lengths])
def test_the_chest_of_a_person_who_leans_is_in_its_place(name):
    """The joints of the spine bend the offset of the chest, which is already that of the bent spine."""
    rest = np.tile(rotations.IDENTITY, (3, len(lower_body.JOINTS), 1))
    offsets = np.array([[0, 0, 0], *[[0.1, -0.4, 0], [0, -0.4, 0], [0, -0.4, 0], [0, 0, 0.1]] * 2, [0, 0.25, 0.15]])
    upright = make_animation(size=0, frames=3)
    lean = Rotation.from_euler("x", [[20], [30], [40]], degrees=True).as_quat()
    leaning = dataclasses.replace(upright, rotations=np.concatenate([lean[:, None], upright.rotations[:, 1:]], axis=1))
    ours = add_lower_body(leaning, LowerBody(offsets, rest, np.zeros((3, 3))))
    theirs = retarget(ours, rigs.load_rig(name))
    where = rigs.places(theirs.armature)
    found, true = (world(each)[1] for each in (theirs, ours))
    away = found[:, where["neck"]] - true[:, ours.armature.joint("neck")]
    assert np.linalg.norm(away.mean(axis=0)) < 0.004 and np.linalg.norm(away, axis=-1).max() < 0.03


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_table_has_the_names_of_its_program(name):
    rig = rigs.load_rig(name)
    assert len(rig.joints) == COUNTS[name]
    for ours, theirs in NAMES[name].items():
        assert rig.names[ours] == theirs


def test_the_bones_that_vrm_requires_are_there():
    assert set(VRM_REQUIRED) <= {joint.name for joint in rigs.load_rig("vrm").joints}


@pytest.mark.parametrize("name", PROGRAMS)
def test_our_t_pose_is_a_t_on_every_rig(name):
    """Whatever the rig's rest pose: arms along x, fingers along the arm, head up, feet below, facing +z."""
    animation = retarget(make_animation(size=0, frames=1), rigs.load_rig(name))
    _, positions = world(animation)
    places = {joint: positions[0, index] for joint, index in rigs.places(animation.armature).items()}
    for side, sign in SIDES.items():
        for first, second in (("shoulder", "wrist"), ("middle_1", "middle_2")):
            bone = rotations.unit(places[f"{side}_{second}"] - places[f"{side}_{first}"])
            np.testing.assert_allclose(bone, [sign, 0, 0], atol=1e-3)
        assert places[f"{side}_thumb_2"][2] > places[f"{side}_thumb_1"][2] + 0.01
        assert places[f"{side}_foot"][2] > places[f"{side}_ankle"][2]
        assert 0 < places[f"{side}_ankle"][1] < 0.2
    assert places["neck"][1] - places["spine"][1] > 0.15
    assert places["pelvis"][1] > 0.9


@pytest.mark.parametrize("name", [name for name in PROGRAMS if name != "smplx"])
@pytest.mark.parametrize("skeleton", ["ted_expressive", "ted_gesture"])
def test_joints_lie_where_ours_lie(name, skeleton):
    """Relative to the chest, arms and shoulders agree to the last digit where the rig has our lengths."""
    ours = make_animation(skeleton)
    _, our_positions = world(ours)
    theirs = retarget(ours, rigs.load_rig(name))
    _, positions = world(theirs)
    places = rigs.places(theirs.armature)
    for joint in ("neck", *(f"{side}_{part}" for side in SIDES for part in ("shoulder", "elbow", "wrist"))):
        expected = our_positions[:, ours.armature.joint(joint)] - our_positions[:, 0]
        found = positions[:, places[joint]] - positions[:, places["spine"]]
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("name", PROGRAMS)
def test_bones_point_where_ours_point(name):
    """Also on a rig with lengths and a rest pose of its own, and in the fingers."""
    ours = make_animation()
    _, our_positions = world(ours)
    theirs = retarget(ours, rigs.load_rig(name))
    _, positions = world(theirs)
    places = rigs.places(theirs.armature)
    bones = [("shoulder", "elbow"), ("elbow", "wrist")]
    # Collarbones rotate from their rest pose by as much as ours; with other lengths the rest pose differs.
    bones += [("clavicle", "shoulder")] if name != "smplx" else []
    bones += [(f"{finger}_{part}", f"{finger}_{part + 1}") for finger in FINGERS for part in (1, 2)]
    for side in SIDES:
        for first, second in bones:
            start, end = (ours.armature.joint(f"{side}_{joint}") for joint in (first, second))
            expected = rotations.unit(our_positions[:, end] - our_positions[:, start])
            bone = positions[:, places[f"{side}_{second}"]] - positions[:, places[f"{side}_{first}"]]
            np.testing.assert_allclose(rotations.unit(bone), expected, atol=2e-3, err_msg=f"{side} {first}")


@pytest.mark.parametrize("name", PROGRAMS)
def test_hands_turn_as_ours_from_the_t_pose(name):
    """The roll of a hand is no matter of directions: it must survive a rest pose that is not ours."""
    ours, still = make_animation(), make_animation(size=0, frames=1)
    rig = rigs.load_rig(name)
    theirs, at_t = retarget(ours, rig), retarget(still, rig)
    turned, expected = world(theirs)[0], world(ours)[0]
    straight = world(at_t)[0]
    for side in SIDES:
        for joint in (f"{side}_wrist", f"{side}_elbow", f"{side}_clavicle", f"{side}_index_2"):
            index = rigs.carriers(theirs.armature)[joint]
            rotation = rotations.multiply(turned[:, index], rotations.conjugate(straight[:, index]))
            away = rotations.angle_between(rotation, expected[:, ours.armature.joint(joint)])
            np.testing.assert_allclose(away, 0, atol=1e-7)


def test_neck_and_spine_share_what_ours_do_in_one_joint():
    ours = make_animation()
    theirs = retarget(ours, rigs.load_rig("mixamo"))
    turned = world(theirs)[0]
    armature = theirs.armature
    angles = [
        rotations.angle_between(
            turned[:, armature.joint("mixamorig:Hips")], turned[:, armature.joint(f"mixamorig:{name}")]
        )
        for name in ("Spine", "Spine1", "Spine2")
    ]
    np.testing.assert_allclose(angles[0], angles[2] / 3, atol=1e-3)
    np.testing.assert_allclose(angles[1], 2 * angles[2] / 3, atol=1e-3)
    head = rotations.angle_between(
        turned[:, armature.joint("mixamorig:Head")], world(ours)[0][:, ours.armature.joint("head")]
    )
    np.testing.assert_allclose(head, 0, atol=1e-7)


def test_legs_stand_still():
    theirs = retarget(make_animation(), rigs.load_rig("unreal"))
    for joint in ("thigh_l", "calf_r", "foot_l", "pelvis"):
        index = theirs.armature.joint(joint)
        np.testing.assert_allclose(
            theirs.rotations[:, index], theirs.rotations[:1, index].repeat(6, axis=0), atol=1e-12
        )


def axes_at_rest(name: str) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    armature = retarget(make_animation(size=0, frames=1), rigs.load_rig(name)).armature
    turned, positions = rest_positions(armature)
    matrices = rotations.to_matrix(turned)
    return dict(zip(armature.joints, matrices)), dict(zip(armature.joints, positions))


def test_mixamo_has_y_along_its_bones():
    axes, places = axes_at_rest("mixamo")
    for side in ("Left", "Right"):
        chain = [f"mixamorig:{side}{part}" for part in ("Arm", "ForeArm", "Hand", "HandMiddle1", "HandMiddle2")]
        for joint, child in itertools.pairwise(chain):
            np.testing.assert_allclose(axes[joint][:, 1], rotations.unit(places[child] - places[joint]), atol=2e-3)


def test_the_mannequin_stands_in_its_a_pose_with_x_along_its_bones():
    axes, places = axes_at_rest("unreal")
    for side, sign in (("l", 1), ("r", -1)):
        arm = rotations.unit(places[f"lowerarm_{side}"] - places[f"upperarm_{side}"])
        assert 35 < np.rad2deg(np.arcsin(-arm[1])) < 55
        for joint, child in (("upperarm", "lowerarm"), ("lowerarm", "hand"), ("thumb_01", "thumb_02")):
            bone = rotations.unit(places[f"{child}_{side}"] - places[f"{joint}_{side}"])
            np.testing.assert_allclose(axes[f"{joint}_{side}"][:, 0], sign * bone, atol=2e-3)


@pytest.mark.parametrize("name", ["vrm", "unity", "smplx"])
def test_rigs_without_axes_of_their_own_rest_unturned(name):
    armature = retarget(make_animation(size=0, frames=1), rigs.load_rig(name)).armature
    np.testing.assert_array_equal(armature.rest, np.tile(rotations.IDENTITY, (len(armature.joints), 1)))


def test_the_thumbs_of_a_vrm_rest_level_at_45_degrees():
    _, places = axes_at_rest("vrm")
    for side, sign in SIDES.items():
        bone = rotations.unit(places[f"{side}ThumbDistal"] - places[f"{side}ThumbMetacarpal"])
        np.testing.assert_allclose(bone, np.array([sign, 0, 1]) / np.sqrt(2), atol=1e-3)


def test_fingers_that_the_motion_lacks_stay_at_rest():
    theirs = retarget(make_animation("ted_gesture"), rigs.load_rig("unity"))
    index = theirs.armature.joint("LeftIndexProximal")
    np.testing.assert_allclose(theirs.rotations[:, index], [[0, 0, 0, 1]] * 6, atol=1e-12)
    assert np.linalg.norm(theirs.armature.offsets[index]) > 0.08

"""The add-on reads what we write, finds any armature's bones, and moves them as we do."""

import dataclasses
import importlib
import json
import pathlib
import struct
import subprocess
import sys
import tomllib
import types
import zipfile

import av
import numpy as np
import pytest
import soundfile
from fixtures.blender import blender_python
from fixtures.motions import swaying

from ha2g_jax.motion import rigs, rotations, solver
from ha2g_jax.motion.armature import Animation, world
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.rigs import retarget

ROOT = pathlib.Path(__file__).parent.parent
MILLIMETRE = 1e-3
NTSC = 30000 / 1001  # frames per second
BONES = {  # of Unreal's mannequin: those whose direction is that of ours
    ("upperarm_l", "lowerarm_l"): ("left_shoulder", "left_elbow"),
    ("lowerarm_l", "hand_l"): ("left_elbow", "left_wrist"),
    ("upperarm_r", "lowerarm_r"): ("right_shoulder", "right_elbow"),
    ("lowerarm_r", "hand_r"): ("right_elbow", "right_wrist"),
    ("index_01_l", "index_02_l"): ("left_index_1", "left_index_2"),
    ("pinky_02_r", "pinky_03_r"): ("right_pinky_2", "right_pinky_3"),
    ("thumb_01_r", "thumb_02_r"): ("right_thumb_1", "right_thumb_2"),
    ("hand_l", "index_01_l"): ("left_wrist", "left_index_1"),
    ("hand_l", "pinky_01_l"): ("left_wrist", "left_pinky_1"),
}


@pytest.fixture(scope="module")
def addon() -> types.SimpleNamespace:
    """The modules of the add-on that need no Blender, and build.py."""
    folder = ROOT / "integrations" / "blender"
    sys.path.insert(0, str(folder))
    try:
        names = ("motion", "reading", "bone_names", "fitting", "glb", "rotations")
        modules = {name: importlib.import_module(f"ha2g_motion.{name}") for name in names}
        modules["build"] = importlib.import_module("build")
        return types.SimpleNamespace(**modules)
    finally:
        sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def animation() -> Animation:
    return solver.animate(swaying(frames=12, size=0.2))


def positions_of(read) -> np.ndarray:
    """(T, J, 3) forward kinematics of what the add-on has read."""
    places = np.zeros((read.num_frames, len(read.joints), 3))
    for joint, parent in enumerate(read.parents):
        bone = read.places[joint] - read.places[parent]
        places[:, joint] = (
            read.root if parent < 0 else places[:, parent] + rotations.rotate(read.rotations[:, parent], bone)
        )
    return places


FORMATS = [(rig, suffix) for rig in ("ha2g", "mixamo", "unreal") for suffix in (".glb", ".bvh", ".json")]


@pytest.mark.parametrize("skeleton", ["ted_expressive", "ted_gesture"])
@pytest.mark.parametrize(("rig", "suffix"), [*FORMATS, ("vrm", ".vrma")])
def test_what_is_read_is_what_was_written(addon, tmp_path, skeleton, rig, suffix):
    motion = swaying(skeleton, 12, size=0.2)
    export(motion, tmp_path / f"m{suffix}", rig=rig)
    read = addon.reading.read_motion(tmp_path / f"m{suffix}")
    animation = retarget(solver.animate(motion), rigs.load_rig(rig))
    assert read.fps == 15
    _, positions = world(animation)
    order = [read.joints.index(name) for name in animation.armature.joints]
    np.testing.assert_allclose(positions_of(read)[:, order], positions, atol=1e-4)
    assert np.ptp(positions, axis=0).max() > 0.05


def test_the_body_of_a_glb_is_read_whole(addon, tmp_path):
    export(swaying(frames=12, size=0.2), tmp_path / "m.glb")
    body = addon.reading.read_motion(tmp_path / "m.glb").body
    assert len(body.points) > 500
    assert np.unique(body.faces).tolist() == list(range(len(body.points)))
    np.testing.assert_allclose(body.weights.sum(axis=1), 1, atol=1e-5)
    assert set(np.unique(body.materials)) == set(range(len(body.colours)))


def test_a_body_is_at_its_bones_wherever_the_person_stands(addon, tmp_path):
    legs = np.array([[0, 0, 0], [0.1, 0, 0], [0, -0.45, 0], [0, -0.42, 0], [0, -0.06, 0.12]])
    legs = np.concatenate([legs, legs[1:] * [-1, 1, 1], [[0, 0.2, 0]]])
    found = []
    for start in ((0, 0.95, 0), (2, 0.95, -1)):
        place = start + np.linspace(0, [0.1, 0, 0], 10)
        lower = LowerBody(legs, np.tile([0.0, 0, 0, 1], (10, 9, 1)), place)
        export(dataclasses.replace(swaying(frames=10), lower=lower), tmp_path / "m.glb")
        read = addon.reading.read_motion(tmp_path / "m.glb")
        found.append(read.body.points - read.places[0])
    np.testing.assert_allclose(*found, atol=1e-5)
    assert np.abs(found[0].mean(axis=0)).max() < 0.5


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("m.glb", b"no file of that kind, but long enough for its head"),
        ("m.npz", b""),
    ],
)
def test_what_is_no_motion_is_refused_in_one_line(addon, tmp_path, monkeypatch, name, content):
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / name).write_bytes(content)
    with pytest.raises(addon.motion.MotionError) as error:
        addon.reading.read_motion(tmp_path / name)
    assert name in str(error.value)
    assert "ha2g export" in str(error.value)
    assert "\n" not in str(error.value)


def test_the_table_of_bone_names_is_that_of_the_rigs(addon):
    """If this fails: python integrations/blender/build.py --names"""
    written = {rig: dict(rows) for rig, rows in addon.bone_names.tables().items()}
    assert written == {rig: dict(rows) for rig, rows in addon.build.bone_names().items()}
    arms = {f"{side}_{joint}" for side in ("left", "right") for joint in ("clavicle", "shoulder", "elbow", "wrist")}
    for rows in written.values():
        assert arms | {"spine", "head"} <= {joint for joint, weight in rows.values() if weight == 1}


@pytest.fixture(scope="module")
def moving(addon, tmp_path_factory):
    """Reads a motion that was exported with a rig."""

    def read(rig: str = "ha2g", skeleton: str = "ted_expressive"):
        path = tmp_path_factory.mktemp("moving") / "m.json"
        export(swaying(skeleton, 12, size=0.2), path, rig=rig)
        return addon.reading.read_motion(path)

    return read


@pytest.mark.parametrize("prefix", ["mixamorig:", "mixamorig7:", ""])
def test_bones_are_known_whatever_their_prefix(addon, moving, prefix):
    bones = [f"{prefix}{name}" for name in ("Hips", "Spine", "Spine2", "Head", "LeftArm", "RightArm", "LeftHandThumb1")]
    found = addon.bone_names.match(moving(), bones)
    expected = {"LeftArm": ("left_shoulder", 1.0), "LeftHandThumb1": ("left_thumb_1", 1.0), "Spine": ("spine", 0.3333)}
    assert found.items() >= {f"{prefix}{name}": joint for name, joint in expected.items()}.items()
    assert f"{prefix}Hips" not in found


CHARACTERS = {  # upper arms, forearm, hand, thumb and the highest bone of the spine, and a bone that is none of these
    "mixamo": "LeftArm RightArm LeftForeArm LeftHand LeftHandThumb1 Spine2 LeftUpLeg",
    "unreal 4": "upperarm_l upperarm_r lowerarm_l hand_l thumb_01_l spine_03 thigh_l",
    "vroid": "J_Bip_L_UpperArm J_Bip_R_UpperArm J_Bip_L_LowerArm J_Bip_L_Hand J_Bip_L_Thumb1 J_Bip_C_Chest J_Sec_Hair",
    "genesis 8": "lShldrBend rShldrBend lForearmBend lHand lThumb1 chestUpper lForearmTwist",
    "genesis 9": "l_upperarm r_upperarm l_forearm l_hand l_thumb1 spine4 l_thigh",
    "character creator": "CC_Base_L_Upperarm CC_Base_R_Upperarm CC_Base_L_Forearm CC_Base_L_Hand CC_Base_L_Thumb1 "
    "CC_Base_Spine02 CC_Base_L_ForearmTwist01",
    "biped": "Bip01_L_UpperArm Bip01_R_UpperArm Bip01_L_Forearm Bip01_L_Hand Bip01_L_Finger0 Bip01_Spine1 Bip01_L_Calf",
    "makehuman": "upperarm01.L upperarm01.R lowerarm01.L wrist.L finger1-1.L spine01 upperarm02.L",
    "rigify": "DEF-upper_arm.L DEF-upper_arm.R DEF-forearm.L DEF-hand.L DEF-thumb.01.L DEF-spine.003 DEF-thigh.L",
}


@pytest.mark.parametrize("rig", ["ha2g", "mixamo", "unreal", "smplx", "unity"])
@pytest.mark.parametrize("bones", CHARACTERS.values(), ids=CHARACTERS)
def test_each_rig_moves_the_characters_of_many_programs(addon, moving, rig, bones):
    motion = moving(rig)
    found = addon.bone_names.match(motion, bones.split())
    names = addon.bone_names.roles(motion)
    joints = ["left_shoulder", "right_shoulder", "left_elbow", "left_wrist", "left_thumb_1", "spine"]
    assert {bone: names[joint] for bone, (joint, _) in found.items()} == dict(zip(bones.split(), joints))
    assert {weight for _, weight in found.values()} == {1.0}


@pytest.mark.parametrize("version", ["1.0", "0.x"])
def test_a_vrm_character_states_its_bones(addon, moving, tmp_path, version):
    names = {"leftUpperArm": "腕L", "rightUpperArm": "腕R", "leftLowerArm": "肘L", "leftHand": "手L", "chest": "胸"}
    bones = {bone: {"node": index} for index, bone in enumerate(names)}
    as_list = [{"bone": bone, **row} for bone, row in bones.items()]
    key, table = ("VRMC_vrm", bones) if version == "1.0" else ("VRM", as_list)
    tree = {
        "nodes": [{"name": name} for name in names.values()],
        "extensions": {key: {"humanoid": {"humanBones": table}}},
    }
    text = json.dumps(tree).encode()
    head = struct.pack("<5I", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A)
    (tmp_path / "character.vrm").write_bytes(head + text)
    humanoid = addon.glb.humanoid(tmp_path / "character.vrm")
    found = addon.bone_names.match(moving(), names.values(), humanoid=humanoid)
    assert [joint for joint, _ in found.values()] == [
        "left_shoulder",
        "right_shoulder",
        "left_elbow",
        "left_wrist",
        "spine",
    ]


def test_bones_that_constraints_hold_are_refused_or_their_controls_move(addon, moving):
    bones, controls = CHARACTERS["rigify"].split(), ["upper_arm_fk.L", "upper_arm_fk.R", "forearm_fk.L", "hand_fk.L"]
    assert set(addon.bone_names.match(moving(), [*bones, *controls], held=bones)) == set(controls)
    with pytest.raises(addon.motion.MotionError, match=r"constraints hold 1 bones.*DEF-forearm.L"):
        addon.bone_names.match(moving(), bones, held=bones[2:3])


def test_bones_of_the_same_rig_and_of_ted_gesture(addon, moving):
    """Legs are left alone, and the head of TED Gesture is turned by its nose."""
    motion = moving("mixamo")
    found = addon.bone_names.match(motion, motion.joints)
    assert found["mixamorig:LeftArm"] == ("mixamorig:LeftArm", 1.0)
    assert not {"mixamorig:Hips", "mixamorig:LeftUpLeg", "mixamorig:RightFoot"} & set(found)
    found = addon.bone_names.match(moving("ha2g", "ted_gesture"), ["head", "upperarm_l", "upperarm_r", "spine_05"])
    assert found["head"] == ("nose_0", 1.0)


def test_names_that_fit_nothing_are_refused(addon, moving, tmp_path):
    with pytest.raises(addon.motion.MotionError, match=r"no table of names fits.*Bone.001.*--names"):
        addon.bone_names.match(moving(), ["Bone.001", "Bone.002"])
    (tmp_path / "names.json").write_text('{"Bone.001": "left_arm"}')
    own = addon.bone_names.read_names(tmp_path / "names.json")
    with pytest.raises(addon.motion.MotionError, match="no joint left_arm"):
        addon.bone_names.match(moving(), ["Bone.001"], own)


def pose_target(addon, target, fitted: dict[str, np.ndarray]) -> np.ndarray:
    """(T, B, 3) where the bones of an armature lie, as Blender poses them."""
    frames = len(next(iter(fitted.values())))
    posed = np.zeros((frames, len(target.bones), 4))
    heads = np.zeros((frames, len(target.bones), 3))
    for index, (bone, parent) in enumerate(zip(target.bones, target.parents, strict=True)):
        own = fitted.get(bone, np.tile(rotations.IDENTITY, (frames, 1)))
        above = posed[:, parent] if parent >= 0 else rotations.IDENTITY
        rest = rotations.conjugate(target.rest[parent]) if parent >= 0 else rotations.IDENTITY
        relative = rotations.multiply(rest, target.rest[index])
        posed[:, index] = rotations.multiply(above, rotations.multiply(relative, own))
        offset = target.heads[index] - (target.heads[parent] if parent >= 0 else 0)
        start = heads[:, parent] if parent >= 0 else 0
        heads[:, index] = start + rotations.rotate(above, rotations.rotate(rest, offset))
    return heads


def angle_between_bones(starts, ends, our_starts, our_ends) -> float:
    """The greatest angle in degrees between bones of two figures."""
    bones, ours = rotations.unit(ends - starts), rotations.unit(our_ends - our_starts)
    return np.degrees(np.arccos(np.clip(np.sum(bones * ours, axis=-1), -1, 1))).max()


@pytest.mark.parametrize("way", ["upright", "lying", "aside"])
def test_arms_and_fingers_point_where_ours_do_on_any_armature(addon, moving, way):
    """An A-posed armature whose bones have axes of their own, which faces elsewhere."""
    pose = rotations.from_euler(np.array({"upright": (0, 0, 0), "lying": (90, 90, 0), "aside": (0, 45, 0)}[way]), "XYZ")
    theirs = moving("unreal")
    random = np.random.default_rng(1)
    target = addon.fitting.Target(
        theirs.joints,
        theirs.parents,
        rotations.rotate(pose, theirs.places) * 100,
        rotations.unit(random.normal(size=(len(theirs.joints), 4))),
        (True,) * len(theirs.joints),
    )
    motion = moving()
    fitted = addon.fitting.fit(motion, target, addon.bone_names.match(motion, target.bones))
    heads = rotations.rotate(rotations.conjugate(pose), pose_target(addon, target, fitted))
    ours = positions_of(motion)
    for (start, end), (our_start, our_end) in BONES.items():
        found = (heads[:, target.bones.index(name)] for name in (start, end))
        expected = (ours[:, motion.joints.index(name)] for name in (our_start, our_end))
        assert angle_between_bones(*found, *expected) < 0.1, (start, end)


@pytest.mark.parametrize("rig", [rig for rig in rigs.RIGS if rig != rigs.OWN])
def test_each_rig_moves_our_own_armature(addon, moving, animation, rig):
    """Its joints have names of SMPL-X too, by which the trunk would stand still."""
    own, motion = moving(), moving(rig)
    rest = np.tile(rotations.IDENTITY, (len(own.joints), 1))
    target = addon.fitting.Target(own.joints, own.parents, own.places, rest, (True,) * len(rest))
    found = addon.bone_names.match(motion, own.joints)
    assert {"spine", "left_clavicle", "right_clavicle", "head"} <= set(found)
    heads = pose_target(addon, target, addon.fitting.fit(motion, target, found))
    _, places = world(animation)
    wrists = [own.joints.index(f"{side}_wrist") for side in ("left", "right")]
    ours = [animation.armature.joint(f"{side}_wrist") for side in ("left", "right")]
    distance = np.linalg.norm(heads[:, wrists] - places[:, ours], axis=-1).max()
    assert distance < (0.04 if rig == "smplx" else MILLIMETRE)  # the spine of SMPL-X bends elsewhere


def test_our_own_armature_gets_the_solvers_rotations(addon, moving, animation):
    motion = moving()
    rest = np.tile(rotations.IDENTITY, (len(motion.joints), 1))
    target = addon.fitting.Target(motion.joints, motion.parents, motion.places, rest, (True,) * len(rest))
    fitted = addon.fitting.fit(motion, target, addon.bone_names.match(motion, motion.joints))
    assert {"spine", "left_elbow", "right_wrist", "left_thumb_0", "head"} <= set(fitted)
    for name, rotation in fitted.items():
        ours = animation.rotations[:, animation.armature.joint(name)]
        assert np.degrees(rotations.angle_between(rotation, ours)).max() < 0.01, name
        assert (np.sum(rotation[1:] * rotation[:-1], axis=-1) > 0.7).all(), "signs must not jump"


def test_the_extension_is_what_blender_installs(addon, tmp_path):
    for name in ("a.zip", "b.zip"):
        addon.build.write_zip(tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert {"__init__.py", "blender_manifest.toml", "bone_names.json", "panel.py"} <= set(archive.namelist())
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    # docs.blender.org/manual/en/latest/advanced/extensions/getting_started.html, "Required values"
    required = ["schema_version", "id", "version", "name", "tagline", "maintainer", "type"]
    required += ["blender_version_min", "license"]
    assert all(manifest.get(key) for key in required)
    assert len(manifest["tagline"]) <= 64
    assert not manifest["tagline"].endswith(".")


@pytest.fixture(scope="module")
def in_blender(tmp_path_factory) -> tuple[pathlib.Path, dict]:
    """What `in_blender.py` did there: the folder of its files, and what it found in them."""
    python = blender_python()
    folder = tmp_path_factory.mktemp("blender")
    motion = swaying(frames=12, size=0.2)
    for name in ("motion.glb", "motion.bvh", "motion.json"):
        export(motion, folder / name)
    export(motion, folder / "unreal.json", rig="unreal")
    export(swaying(frames=12, fps=NTSC, size=0.2), folder / "ntsc.glb")
    soundfile.write(folder / "tone.wav", 0.25 * np.sin(np.arange(12800) / 8), 16000)
    command = [python, str(ROOT / "tests" / "in_blender.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (folder / "results.json").is_file(), done.stdout + done.stderr
    return folder, json.loads((folder / "results.json").read_text())


@pytest.mark.parametrize("where", ["scene", "fbx", "panel_scene"])
def test_joints_in_blender_are_where_ours_are(in_blender, animation, where):
    """In a .blend from the script, in an .fbx read back, and by the panel's button with another first frame."""
    found = in_blender[1][where]
    _, positions = world(animation)
    assert set(found) == set(animation.armature.joints)
    for index, name in enumerate(animation.armature.joints):
        np.testing.assert_allclose(np.array(found[name]), positions[:, index], atol=MILLIMETRE, err_msg=name)


def test_the_scene_has_the_motions_time_and_a_body_that_moves(in_blender):
    _, results = in_blender
    assert results["scene_time"] == [15, 0, 11]
    assert 0.2 < results["body_moved"] < 1.5


def test_the_panel_keeps_what_is_in_the_scene_and_says_what_is_wrong(in_blender):
    _, results = in_blender
    assert results["panel"] == ["FINISHED"]
    assert results["panel_sounds"] == ["tone.wav"]  # also after the motion was applied again
    assert results["panel_frames"] == [3, 31]  # those of both figures
    expected = {
        "tweak": "is in tweak mode of the NLA",
        "frames": "frames 1048574 to 1048585",
        "missing": "no motion at",
        "linked": "is linked from another file",
    }
    for case, sentence in expected.items():
        assert sentence in results["panel_errors"][case]
    assert results["is_unregistered"]


def test_a_glb_from_blender_has_a_fractional_frame_rate(in_blender):
    assert read_motion(in_blender[0] / "ntsc_again.glb").fps == pytest.approx(NTSC, rel=1e-5)


def test_another_character_does_what_our_figure_does(in_blender, animation):
    _, results = in_blender
    positions = world(animation)[1][..., [2, 1, 0]] * [1, 1, -1]  # bob faces +x
    for (start, end), (our_start, our_end) in BONES.items():
        found = (np.array(results["bob"][name]) for name in (start, end))
        expected = (positions[:, animation.armature.joint(name)] for name in (our_start, our_end))
        assert angle_between_bones(*found, *expected) < 0.2, (start, end)
    assert results["bob_thigh"] == pytest.approx([0.8, 0.6, 0, 0], abs=1e-6)


def test_the_controls_of_rigify_move_its_bones(in_blender, animation):
    """The controls of arms and fingers hang on the bones that they move, by constraints."""
    positions = world(animation)[1]
    chains = {("upper_arm", "forearm"): ("shoulder", "elbow"), ("forearm", "hand"): ("elbow", "wrist")}
    chains |= {("f_index.02", "f_index.03"): ("index_2", "index_3"), ("thumb.01", "thumb.02"): ("thumb_1", "thumb_2")}
    for (start, end), joints in chains.items():
        for side, letter in (("left", "L"), ("right", "R")):
            found = (np.array(in_blender[1]["rigify"][f"DEF-{name}.{letter}"]) for name in (start, end))
            expected = (positions[:, animation.armature.joint(f"{side}_{joint}")] for joint in joints)
            assert angle_between_bones(*found, *expected) < 0.2, (start, side)


def test_what_cannot_be_done_is_refused(in_blender):
    folder, results = in_blender
    expected = {
        "no body": "would be empty",
        "no character": "cannot open motion.bvh; expected one of .blend",
        "over the motion": "the result would overwrite",
        "over the character": "the result would overwrite",
        "no sound": "motion.json has no sound that Blender can read; give an audio file",
        "no time": "no pose at nan s",
        "after the end": "motion.glb lasts 0.80 s",
        "frames": "frames 1048570 to 1048581",
        "start": "'99999999999' is not a whole number from 0 to 1048574",
        "size": "'0x0' is not a size; give WxH or one number, 4 to 65536 pixels",
        "words": "'large' is not a size",
        "samples": "'-3' is not a whole number from 1 to 16777216",
        "two armatures": "the armatures",
        "camera": "the camera behind of the character's file does not show",
    }
    for case, sentence in expected.items():
        assert sentence in results["says"][case]
        assert results["says"][case].count("\n") == 1
    assert not [name for name in ("bones.png", "x.blend", "x.png", "filmed.png") if (folder / name).exists()]


def test_a_film_lasts_as_long_as_the_motion_and_has_its_sound(in_blender):
    folder, results = in_blender
    assert results["film"] == 0
    with av.open(str(folder / "film.mp4")) as container:
        assert {stream.type for stream in container.streams} == {"video", "audio"}
        pictures = [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]
    assert len(pictures) == 12
    assert np.abs(pictures[0] - pictures[6]).max() > 20
    with av.open(str(folder / "film.mp4")) as container:
        heard = np.concatenate([frame.to_ndarray()[0] for frame in container.decode(audio=0)])
    assert np.abs(heard).max() > 0.1


def test_a_mistake_is_one_line_and_leaves_no_file(tmp_path):
    script = ROOT / "integrations" / "blender" / "ha2g_blender.py"
    command = [blender_python(), str(script), "--", str(tmp_path / "no.glb"), "-o", str(tmp_path / "x.blend")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.strip() == f"ha2g_blender: no motion at {tmp_path / 'no.glb'}; give a file of ha2g export"
    assert list(tmp_path.iterdir()) == []

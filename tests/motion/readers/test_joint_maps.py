"""Joint maps: "auto" finds the naming, and what is missing is said; for the places of joints see test_kinds."""

import dataclasses
import json

import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.joint_maps import MAPS, choose_map, load_map
from ha2g_jax.motion.rigs import load_rig
from ha2g_jax.skeleton import load_skeleton

EXPRESSIVE, GESTURE = load_skeleton("ted_expressive"), load_skeleton("ted_gesture")
FINGERS = {"Thumb": "T", "Index": "I", "Middle": "M", "Ring": "R", "Pinky": "P"}
SIDES = {"Left": "L", "Right": "R"}
ZEROEGGS = [*("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck", "Neck1", "Head", "HeadEnd")]
ZEROEGGS += [side + part for side in SIDES for part in ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")]
ZEROEGGS += [f"{side}Hand{finger}{part}" for side in SIDES for finger in FINGERS for part in (1, 2, 3, 4)]
MIXAMO = [name for name in ZEROEGGS if name not in ("Spine3", "Neck1", "HeadEnd")]
BEAT = [*("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck", "Neck1", "Head", "HeadEnd")]
BEAT += [side + part for side in SIDES.values() for part in ("Shoulder", "Arm", "Arm1", "Hand", "UpLeg", "Leg", "Foot")]
BEAT += [f"{side}Hand{finger}" for side in SIDES.values() for finger in "RPI"]  # within the palm
BEAT += [f"{side}Hand{finger}{part}" for side in SIDES.values() for finger in FINGERS.values() for part in (1, 2, 3, 4)]


def places_of(naming: list[str], joint_map: str = "auto", skeleton=EXPRESSIVE) -> tuple[str, dict[str, str]]:
    found, places = choose_map(naming, skeleton, joint_map, "a.bvh")
    return found.name, {joint: naming[place] for joint, place in places.items()}


AFFIXES = ("{}", "mixamorig:{}", "mixamorig1:{}", "mixamorig{}", "Armature|mixamorig:{}", "Char01_{}", "{}_jnt")
AFFIXES += ("Actor 2:Skin_{}.001", "b_{}", "LeftHand_{}", "TAKE|{}_Joint")


@pytest.mark.parametrize("affix", AFFIXES)
@pytest.mark.parametrize("name", MAPS)
def test_what_the_names_of_most_joints_share_makes_no_difference(name, affix):
    names = {joint: several[-1 if name == "mixamo" else 0] for joint, several in load_map(name).names.items()}
    found, places = places_of(["Reference", *(affix.format(joint).title() for joint in names.values())])
    assert found == name and len(places) == 38 + 1
    assert all(place == affix.format(names[joint]).title() for joint, place in places.items())


def test_a_file_without_fingers():
    bare = [name for name in MIXAMO if not any(finger in name for finger in FINGERS)]
    name, places = places_of(bare, skeleton=GESTURE)
    assert name == "mixamo" and len(places) == 8 + 1
    with pytest.raises(UserError, match=r"left_index_1 \(LeftHandIndex1\).* choose the skeleton ted_gesture"):
        places_of(bare)


def test_what_is_missing_is_said():
    """By the map that comes nearest, with the joints of the file and how to write a map."""
    with pytest.raises(UserError) as caught:
        places_of([*(name for name in BEAT if name != "RArm1"), "Elbow"])
    message = str(caught.value)
    assert "a.bvh does not fit the joint map beat: it lacks right_elbow (RArm1 or RightForeArm);" in message
    assert "`right_elbow: NAME`" in message and "--joint-map" in message and "Elbow" in message
    assert "\n" not in message and "ted_gesture" not in message


def test_names_that_are_those_of_no_map():
    """Of which one or another may be in a map by chance."""
    blender = ["pelvis", "spine", "neck", *(f"{name}.{side}" for name in ("upper_arm", "forearm") for side in "LR")]
    with pytest.raises(UserError, match=r"a.bvh fits no known joint map \(.*--joint-map; .* spine, neck, upper_arm.L"):
        places_of(blender)
    with pytest.raises(UserError, match=r"a.bvh does not fit the joint map mixamo"):
        places_of(blender, "mixamo")


def test_a_rig_without_a_head_has_a_map():
    rig = load_rig("mixamo")
    arms = dataclasses.replace(rig, joints=tuple(joint for joint in rig.joints if joint.carries != "head"))
    assert "head" not in joint_maps._of_rig(arms).names and "head" in joint_maps._of_rig(rig).names


def test_two_people_in_one_file():
    both = [f"{who}:{joint}" for who in ("ada", "ben") for joint in MIXAMO]
    with pytest.raises(UserError, match="ada:Spine2 and ben:Spine2, and either may be spine"):
        places_of(both)


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_map_of_ones_own(suffix, tmp_path):
    path = tmp_path / f"mine{suffix}"
    lines = {"spine": "Chest", "neck": "rig:Nacken", "head": ["Kopf", "Haupt"], "left_shoulder": "a"}
    lines |= {
        "left_elbow": "b",
        "left_hip": "",
        "left_wrist": "c",
        "right_shoulder": "d",
        "right_elbow": "e",
        "right_wrist": 1,
    }
    lines |= {"unit": 0.01, "up": "z", "comment": "my actor " * 50}
    as_yaml = "\n".join(f"{key}: {json.dumps(value)}" for key, value in lines.items())
    path.write_text(json.dumps(lines) if suffix == ".json" else f"# my actor\n{as_yaml}")
    mine = load_map(str(path))
    assert (mine.unit, mine.up, mine.names["head"]) == (0.01, "z", ("Kopf", "Haupt"))
    name, places = places_of(["Root", "Chest", "Nacken", "Haupt", *"abcde", "1"], str(path), GESTURE)
    assert name == str(path) and places["head"] == "Haupt" and places["right_wrist"] == "1"
    path.write_text(path.read_text().replace('"b"', '"c"'))
    with pytest.raises(UserError, match="uses c for both left_elbow and left_wrist"):
        places_of(["Root", "Chest", "Nacken", "Haupt", *"abcde", "1"], str(path), GESTURE)


FAULTS = {
    "not yaml": (".yaml", "spine: [", "is not YAML"),
    "a name that is a truth": (".yaml", "spine: no", "no name for spine"),
    "unit below zero": (".yaml", "unit: -1", "has `unit: -1"),
    "an object": (".yaml", "spine: !!python/object/apply:os.getcwd []", "is not YAML"),
    "a joint misspelt": (".json", '{"left_hpi": "LeftUpLeg"}', "unknown entry left_hpi; did you mean left_hip?"),
    "an option in capitals": (".yaml", "Unit: 0.01", "unknown entry Unit; did you mean unit?"),
    "too long": (".yaml", "# " + "x" * (1 << 18), "more than 65536 bytes"),
    "JSON without end": (".json", '{"spine": ' + "[" * 20000, "is not JSON"),
}


@pytest.mark.parametrize(("suffix", "text", "found"), FAULTS.values(), ids=FAULTS)
def test_a_map_that_is_none(suffix, text, found, tmp_path):
    path = tmp_path / f"mine{suffix}"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        load_map(str(path))
    message = str(caught.value)
    assert path.name in message and found in message and "\n" not in message and len(message) < 500


def test_no_such_map():
    with pytest.raises(UserError, match=r"no joint map nothing; give auto, zeroeggs, beat, .*, vrm or the path"):
        load_map("nothing")

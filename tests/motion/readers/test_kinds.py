"""Motion of every kind goes through every command, at the joint positions that a reader of its own finds."""

import functools
import json
import shutil
from typing import Any

import numpy as np
import pygltflib
import pytest
from fixtures.bvh_readers import pybvh_places
from motion.readers import bvh_files
from motion.readers.conftest import FRAMES, Person

from ha2g_jax import cli
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import scoring
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.motion import formats
from ha2g_jax.motion.armature import export_axes
from ha2g_jax.motion.lower_body import JOINTS as LOWER
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import at_rate, read_motion
from ha2g_jax.motion.readers.smplx_body import JOINTS
from ha2g_jax.skeleton import load_skeleton

KINDS = (
    *("own", "BEAT2", "AMASS SMPL-X", "AMASS SMPL-H", "AMASS parts", "smplx package"),
    *("SMPL-X joints", "SMPL-X joints array", "BVH", "GENEA BVH", "BEAT BVH", "ZeroEGGS BVH"),
    *("directions", "directions less mean", "TED-Gesture directions", "TED-Expressive positions"),
    *("TED-Gesture positions", "named positions", "named positions npz", "glTF", "VRM animation", "table"),
)
POSED = (
    *("BEAT2", "AMASS SMPL-X", "AMASS SMPL-H", "AMASS parts", "smplx package"),
    *("BVH", "GENEA BVH", "BEAT BVH", "ZeroEGGS BVH"),
)
WITHOUT_RATE = {
    *("directions", "directions less mean", "TED-Gesture directions", "TED-Expressive positions"),
    *("TED-Gesture positions", "SMPL-X joints array"),
}
NAMES = {"spine": "spine3"}


def rigid(points: np.ndarray, to: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that brings points (n, 3) nearest to others, `points @ rotation`; never a reflection."""
    left, _, right = np.linalg.svd(points.reshape(-1, 3).T @ to.reshape(-1, 3))
    sign = np.diag([1, 1, np.sign(np.linalg.det(left @ right))])
    return left @ sign @ right


def lower_of(motion: Motion) -> LowerBody:
    assert motion.lower is not None
    return motion.lower


def run(*arguments) -> int:
    return cli.main([str(argument) for argument in arguments])


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """Intervals of ten draws, which take no time."""
    monkeypatch.setattr(scoring, "evaluate", functools.partial(evaluate, draws=10))


def go_through_all(path, folder, capsys, *rate):
    """Give a file to every command, which must succeed."""
    for suffix in formats.SUFFIXES:
        assert run("export", path, *rate, "-o", folder / f"x{suffix}") == 0
    assert run("export", path, *rate, "-o", folder / "smplx.npz", "--rig", "smplx") == 0
    assert run("view", path, *rate, "-o", folder / "x.html") == 0
    assert run("keyframes", path, *rate, "-o", folder / "x.svg", "--size", 64, "--count", 2) == 0
    assert run("video", path, *rate, "-o", folder / "x.mp4", "--size", "64x64") == 0
    for name in ("a", "b"):
        (folder / name).mkdir()
        shutil.copy(path, folder / name / f"talk{path.suffix}")
    capsys.readouterr()
    assert run("evaluate", "--motion", folder / "a", "--reference", folder / "b", *rate) == 0
    assert "1 clips" in capsys.readouterr().out
    assert Motion.load(folder / "x.npz").num_frames == FRAMES


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read(kind, files):
    motion = read_motion(files[kind], source_fps=30 if kind in WITHOUT_RATE else None)
    assert (motion.num_frames, motion.fps) == (FRAMES, 30)


@pytest.mark.parametrize("fps", [np.inf, 1e9, 0])
def test_a_rate_that_no_motion_has_is_refused(fps, files):
    with pytest.raises(UserError, match=r"frames per second of the result; expected 0\.1 to 1000"):
        read_motion(files["BVH"], fps=fps)


@pytest.mark.parametrize(
    "kind", ["own", "BEAT2", "BVH", "glTF", "directions", "TED-Gesture positions", "named positions"]
)
def test_kinds_go_through_every_command(kind, files, tmp_path, capsys):
    go_through_all(files[kind], tmp_path, capsys, *(("--source-fps", 30) if kind in WITHOUT_RATE else ()))


def test_a_real_recording_goes_through_every_command(private_data, tmp_path, capsys):
    [path] = private_data.glob("zeroeggs_067/*.bvh")
    (tmp_path / "real.bvh").write_text(bvh_files.first_frames(path.read_text(), FRAMES))
    go_through_all(tmp_path / "real.bvh", tmp_path, capsys)


@pytest.mark.parametrize("kind", [*POSED, "SMPL-X joints"])
def test_joints_are_where_an_independent_reader_finds_them(kind, files, person):
    motion = read_motion(files[kind])
    names = [name for name in motion.joint_names if NAMES.get(name, name) in JOINTS and name != "head"]
    ours = motion.positions[:, [motion.joint_names.index(name) for name in names]].astype(np.float64)
    theirs = np.stack([person.at(NAMES.get(name, name)) for name in names], axis=1) - person.at("spine3")[:, None]
    assert len(names) == 38
    turn = rigid(theirs, ours)
    np.testing.assert_allclose(theirs @ turn, ours, atol=1e-5)
    assert turn[1, 1] == pytest.approx(-1, abs=1e-6)  # up became y down
    assert turn[2, 2] < -0.9  # ahead became -z
    if kind == "SMPL-X joints":
        return
    lower = lower_of(motion)
    theirs = np.stack([person.at(name) for name in LOWER], axis=1)
    turn = rigid(theirs - theirs[:, :1], lower.positions() - lower.positions()[:, :1])
    np.testing.assert_allclose(theirs @ turn, lower.positions(), atol=1e-5)
    assert turn[1, 1] == pytest.approx(1, abs=1e-6)


def test_a_real_recording_of_beat2_has_its_joints_and_its_sound_is_cut(private_data, tmp_path, caplog):
    [path] = private_data.glob("beat2_scott/*.npz")
    with np.load(path) as arrays:
        person = Person(arrays["poses"].reshape(-1, 55, 3), arrays["trans"])
    joints = person.joints - person.at("spine3")[:, None]
    motion = read_motion(path)
    names = [name for name in motion.joint_names if NAMES.get(name, name) in JOINTS and name != "head"]
    ours = motion.positions[:, [motion.joint_names.index(name) for name in names]].astype(np.float64)
    theirs = joints[:, [JOINTS.index(NAMES.get(name, name)) for name in names]]
    np.testing.assert_allclose(theirs @ rigid(theirs, ours), ours, atol=1e-3)
    assert run("data", "import", path.parent, tmp_path / "corpus", "--no-words") == 0
    assert "63.53 s of motion and 64.10 s of audio; cut to the shorter, without the last 0.6 s of audio" in caplog.text


def test_legs_and_place_reach_the_files_of_other_programs(files, tmp_path):
    """To the places of our own BVH and GLB see test_other_readers."""
    motion = read_motion(files["BEAT2"])
    formats.export(motion, tmp_path / "mixamo.bvh", rig="mixamo")
    found = pybvh_places(tmp_path / "mixamo.bvh")["mixamorig:LeftFoot"]
    np.testing.assert_allclose(found, lower_of(motion).positions()[:, 3], atol=1e-3)
    formats.export(motion, tmp_path / "x.json")
    tree = json.loads((tmp_path / "x.json").read_text())
    roots = np.array([frame["positions"][0] for frame in tree["frames"]])
    np.testing.assert_allclose(roots, lower_of(motion).translation, atol=1e-3)
    formats.export(motion, tmp_path / "x.vrma")
    gltf: Any = pygltflib.GLTF2().load_binary(str(tmp_path / "x.vrma"))
    moved = {(gltf.nodes[channel.target.node].name, channel.target.path) for channel in gltf.animations[0].channels}
    assert {("hips", "translation"), ("leftUpperLeg", "rotation"), ("rightFoot", "rotation")} <= moved


def test_a_face_of_fewer_values_is_carried_to_other_kinds_and_back(files, tmp_path):
    formats.export(read_motion(files["smplx package"]), tmp_path / "own.npz")
    formats.export(read_motion(tmp_path / "own.npz"), tmp_path / "smplx.npz", rig="smplx")
    with np.load(files["smplx package"]) as given, np.load(tmp_path / "smplx.npz") as found:
        np.testing.assert_allclose(found["expressions"], given["expression"], atol=1e-6)
        np.testing.assert_allclose(found["poses"][:, 66:69], given["jaw_pose"], atol=1e-6)


def test_smplx_keeps_root_legs_and_face(files, person, tmp_path):
    read_motion(files["BEAT2"]).save(tmp_path / "own.npz")
    formats.export(read_motion(tmp_path / "own.npz"), tmp_path / "x.npz", rig="smplx")
    with np.load(files["BEAT2"]) as given, np.load(tmp_path / "x.npz") as found:
        for name in ("expressions", "arkit"):
            np.testing.assert_allclose(found[name], given[name], atol=1e-6)
        legs = [JOINTS.index(name) for name in LOWER[1:]]
        poses = found["poses"].reshape(FRAMES, 55, 3)
        np.testing.assert_allclose(poses[:, legs], person.poses[:, legs], atol=1e-5)
        np.testing.assert_allclose(poses[:, 22], person.poses[:, 22], atol=1e-6)
        assert found["trans"].shape == (FRAMES, 3)
        np.testing.assert_allclose(found["trans"][:, 1], person.trans[:, 1], atol=1e-6)


def test_direction_arrays_are_read_whole_and_less_the_mean(files):
    expected = read_motion(files["BEAT2"]).directions
    for kind, is_residual in (("directions", False), ("directions less mean", True)):
        motion = read_motion(files[kind])
        np.testing.assert_allclose(motion.directions, expected, atol=1e-5)
        assert motion.fps == 15
        assert motion.meta["read_from"]["mean_was_subtracted"] is is_residual


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_directions_that_may_be_either_are_refused(scale, files, tmp_path):
    np.save(tmp_path / "x.npy", scale * np.load(files["directions"]))
    with pytest.raises(UserError, match=r"x\.npy has vectors whose lengths differ from 1") as caught:
        read_motion(tmp_path / "x.npy")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["x.pkl", "x.npy"])
def test_a_pickle_is_refused_by_its_name_and_by_its_content(name, tmp_path, capsys):
    import pickle

    (tmp_path / name).write_bytes(pickle.dumps({"poses": [1]}))
    for command, out in (("export", "x.bvh"), ("view", "x.html"), ("keyframes", "x.svg"), ("video", "x.mp4")):
        assert run(command, tmp_path / name, "-o", tmp_path / out) == 2
        assert "is a pickle, which may run code" in capsys.readouterr().err


def test_the_kind_is_found_by_content_and_not_by_suffix(files, tmp_path):
    for kind in ("BEAT2", "BVH", "directions", "named positions"):
        shutil.copy(files[kind], tmp_path / "motion.dat")
        assert read_motion(tmp_path / "motion.dat").meta["read_from"] == read_motion(files[kind]).meta["read_from"]


def test_one_frame_is_a_motion(files, tmp_path):
    (tmp_path / "x.bvh").write_text(bvh_files.first_frames(files["BVH"].read_text(), 1))
    with np.load(files["BEAT2"]) as arrays:
        first = {name: array[:1] if array.ndim > 1 else array for name, array in arrays.items()}
    np.savez(tmp_path / "x.npz", **first)
    np.save(tmp_path / "x.npy", np.load(files["directions"])[:1])
    for name in ("x.bvh", "x.npz", "x.npy"):
        assert read_motion(tmp_path / name).num_frames == 1


def save(path, files, **changes):
    with np.load(files["BEAT2"]) as given:
        arrays = dict(given)
    arrays |= {name: change(arrays[name]) if callable(change) else change for name, change in changes.items()}
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})


ODD_NPZ = {
    "gender as bytes": {"gender": np.array(b"neutral")},
    "rate as text": {"mocap_frame_rate": np.array("30")},
    "rate in an array": {"mocap_frame_rate": np.array([[30.0]])},
    "no betas": {"betas": None},
    "betas of each frame": {"betas": np.zeros((60, 300))},
    "no trans": {"trans": None},
    "half floats": {"poses": lambda poses: poses.astype(np.float16)},
    "big-endian floats": {"poses": lambda poses: poses.astype(">f8")},
    "poses by columns": {"poses": np.asfortranarray},
    "facts of another program": {"model": np.array({"a": 1}, object), "labels": np.array([None, "a"], object)},
}


@pytest.mark.parametrize("case", ODD_NPZ)
def test_an_odd_npz_is_the_same_motion(case, files, tmp_path):
    save(tmp_path / "x.npz", files, **ODD_NPZ[case])
    motion, expected = read_motion(tmp_path / "x.npz"), read_motion(files["BEAT2"])
    np.testing.assert_allclose(motion.positions, expected.positions, atol=2e-3 if case == "half floats" else 1e-5)
    assert motion.fps == 30


ODD_NAMES = {
    "bytes": lambda names: names.astype(bytes),
    "in a column": lambda names: names[:, None],
    "in capitals": np.char.upper,
}


@pytest.mark.parametrize("case", ODD_NAMES)
def test_names_of_joints_in_another_form_are_read(case, files, tmp_path):
    with np.load(files["named positions npz"]) as arrays:
        names = ODD_NAMES[case](arrays["joint_names"])
        np.savez(tmp_path / "x.npz", **{**arrays, "joint_names": names, "borders": [30.0, 9, 30]})
    motion, expected = read_motion(tmp_path / "x.npz"), read_motion(files["named positions npz"])
    np.testing.assert_array_equal(motion.positions, expected.positions)
    assert motion.meta["borders"] == [9, 30]


def _changed(files, tmp_path, **changes):
    with np.load(files["named positions npz"]) as arrays:
        np.savez(tmp_path / "x.npz", **{**arrays, **{name: change(arrays[name]) for name, change in changes.items()}})
    return tmp_path / "x.npz"


def test_unit_and_axis_of_a_map_are_those_of_positions(files, tmp_path):
    path = _changed(files, tmp_path, positions=lambda places: 100 * places)
    (tmp_path / "map.json").write_text('{"spine": "spine", "unit": 0.01}')
    found, expected = (read_motion(path, **stated) for stated in ({"joint_map": tmp_path / "map.json"}, {"unit": 0.01}))
    np.testing.assert_array_equal(found.positions, expected.positions)
    (tmp_path / "map.json").write_text('{"spine": "spine", "unit": 0.5}')
    with pytest.raises(UserError, match="arms"):
        read_motion(path, joint_map=tmp_path / "map.json")


def test_two_joints_of_one_name_are_refused(files, tmp_path):
    twice = {"positions": lambda places: np.tile(places, (1, 2, 1)), "joint_names": lambda names: np.tile(names, 2)}
    with pytest.raises(UserError, match="two joints named"):
        read_motion(_changed(files, tmp_path, **twice))


def test_a_finger_that_is_missing_is_said(files, tmp_path, caplog):
    other = {"left_pinky_3": "end", "left_ear": "head"}
    path = _changed(files, tmp_path, joint_names=lambda names: np.array([other.get(name, name) for name in names]))
    assert read_motion(path).meta["skeleton"] == "ted_gesture"
    assert "is read without hands, as it lacks left_pinky_3" in caplog.text
    del other["left_ear"]
    path = _changed(files, tmp_path, joint_names=lambda names: np.array([other.get(name, name) for name in names]))
    with pytest.raises(UserError, match="lacks left_pinky_3 of the skeleton ted_expressive"):
        read_motion(path)


@pytest.mark.parametrize(("frames", "fps", "new"), [(33, 30, 15), (121, 120, 15), (31, 15, 30), (40, 125, 125)])
def test_every_format_has_the_same_frames_at_another_rate(frames, fps, new, tmp_path):
    skeleton = load_skeleton("ted_expressive")
    motion = Motion.from_directions(skeleton, np.repeat(skeleton.mean_directions[None], frames, axis=0), fps)
    for suffix in (".bvh", ".glb", ".json", ".csv"):
        formats.export(motion, tmp_path / f"m{suffix}")
        found = read_motion(tmp_path / f"m{suffix}", fps=new)
        assert (found.num_frames, found.fps) == (at_rate(motion, new).num_frames, new)


@pytest.mark.parametrize("kind", ["own", "directions"])
def test_motion_is_read_without_its_fingers_beside_one_that_has_none(kind, files):
    """The arms stay where they are, and the head shows the same turn in the joints of the other skeleton."""
    with pytest.raises(UserError, match="no skeleton 'smpl'; expected ted_expressive or"):
        read_motion(files[kind], skeleton="smpl")
    motion, bare = read_motion(files[kind]), read_motion(files[kind], skeleton="ted_gesture")
    assert bare.meta["skeleton"] == "ted_gesture" and bare.num_frames == motion.num_frames
    for joint in ("neck", "left_elbow", "right_wrist"):
        places = [each.positions[:, each.skeleton.joint(joint)] * export_axes(each.skeleton) for each in (motion, bare)]
        np.testing.assert_allclose(places[0], places[1], atol=1e-4)
    noses = [each.directions[:, each.skeleton.bone("nose")] * export_axes(each.skeleton) for each in (motion, bare)]
    turns = [nose - nose.mean(axis=0) for nose in noses]
    assert np.corrcoef(*(turn[:, 0] for turn in turns))[0, 1] > 0.9

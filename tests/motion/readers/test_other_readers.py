"""Joints that we read from BVH, and write to BVH and GLB, are where Blender, bvhio and pybvh find them, to 1 mm."""

import pathlib
import subprocess
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.blender import blender_python
from fixtures.bvh_readers import bvhio_places, pybvh_places
from motion.formats.conftest import blender  # noqa: F401
from motion.readers import bvh_files
from motion.readers.test_kinds import lower_of, rigid

from ha2g_jax.motion import formats, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.lower_body import JOINTS as LOWER
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import joint_maps, read_motion
from ha2g_jax.motion.readers.bvh import read_bvh

MILLIMETRE = 1e-3
FRAMES = [0, 7, 29, 58]  # that are compared
MADE_UP = ("neck", "nose", "left_eye", "right_eye", "left_ear", "right_ear", "head")  # not, or not as such, in a BVH

Places = dict[str, np.ndarray]


@pytest.fixture(params=["bvhio", "pybvh", "blender"])
def places_of(request) -> Callable[[pathlib.Path], Places]:
    """A function from the path of a BVH to positions in metres, by a reader of others."""
    if request.param == "blender":
        read = request.getfixturevalue("blender")
        return lambda path: read(path, FRAMES, 30)
    read = {"bvhio": bvhio_places, "pybvh": pybvh_places}[request.param]
    return lambda path: {name: places[FRAMES] for name, places in read(path).items()}


def check_reading(path: pathlib.Path, motion: Motion, places: Places) -> None:
    """Compare joints and legs of a BVH, which may be rotated as one rigid body."""
    _, found = joint_maps.choose_map(read_bvh(path).joints, motion.skeleton, "auto", path)
    names = read_bvh(path).joints
    ours = [name for name in motion.joint_names if name in found and name not in MADE_UP]
    assert len(ours) > 30
    theirs = np.stack([places[names[found[name]]] for name in ours], axis=1)
    theirs = theirs - places[names[found["spine"]]][:, None]
    kept = motion.positions[FRAMES][:, [motion.joint_names.index(name) for name in ours]].astype(np.float64)
    turn = rigid(theirs, kept)
    np.testing.assert_allclose(theirs @ turn, kept, atol=MILLIMETRE)
    legs = joint_maps.find_legs(joint_maps.choose_map(names, motion.skeleton, "auto", path)[0], names, path)
    theirs = np.stack([places[names[legs[name]]] for name in LOWER], axis=1)
    kept = lower_of(motion).positions()[FRAMES]
    turn = rigid(theirs - theirs[:, :1], kept - kept[:, :1])
    np.testing.assert_allclose(theirs @ turn, kept, atol=MILLIMETRE)


@pytest.mark.parametrize("kind", ["BVH", "GENEA BVH"])
def test_a_bvh_is_read_where_others_find_its_joints(kind, files, places_of, tmp_path):
    path = tmp_path / "x.bvh"  # Blender's positions are written beside it
    path.write_text(files[kind].read_text())
    check_reading(path, read_motion(path), places_of(path))


def test_a_real_recording_is_read_where_others_find_its_joints(private_data, places_of, tmp_path):
    [source] = private_data.glob("zeroeggs_067/*.bvh")
    path = tmp_path / "real.bvh"
    path.write_text(bvh_files.first_frames(source.read_text(), 90))
    check_reading(path, read_motion(path), places_of(path))


def check_writing(motion: Motion, places: Places) -> None:
    """Compare all joints, whose bones have the mean lengths of the motion, on a floor at y = 0."""
    animation = solver.animate(motion)
    _, expected = world(animation)
    expected = expected[FRAMES] - [0, lower_of(motion).floor, 0]
    assert set(animation.armature.joints) <= set(places)
    found = np.stack([places[name] for name in animation.armature.joints], axis=1)
    np.testing.assert_allclose(found, expected, atol=MILLIMETRE)
    legs = np.stack([places[name] for name in LOWER], axis=1)
    floor = np.array([0, lower_of(motion).floor, 0])
    np.testing.assert_allclose(legs, lower_of(motion).positions()[FRAMES] - floor, atol=MILLIMETRE)


@pytest.mark.parametrize("kind", ["BEAT2", "GENEA BVH"])
def test_a_bvh_is_written_where_others_find_its_joints(kind, files, places_of, tmp_path):
    motion = read_motion(files[kind])
    formats.export(motion, tmp_path / "x.bvh")
    check_writing(motion, places_of(tmp_path / "x.bvh"))


def test_what_blender_writes_to_a_glb_is_read_where_it_was(files, tmp_path):
    """Armatures, keys and names as Blender's exporter leaves them, of a BVH, whose first frame Blender calls 1."""
    script = (
        "import bpy, sys; bpy.ops.wm.read_factory_settings(use_empty=True); "
        "bpy.ops.import_anim.bvh(filepath=sys.argv[1], update_scene_fps=True); "
        "bpy.ops.export_scene.gltf(filepath=sys.argv[2])"
    )
    command = [blender_python(), "-c", script, str(files["BVH"]), str(tmp_path / "x.glb")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (tmp_path / "x.glb").is_file(), done.stdout + done.stderr
    found, expected = read_motion(tmp_path / "x.glb"), read_motion(files["BVH"])
    assert found.fps == expected.fps and found.num_frames == expected.num_frames + 1
    read = [joint for joint, name in enumerate(found.joint_names) if name not in MADE_UP]
    theirs, ours = (places[:, read].astype(np.float64) for places in (expected.positions, found.positions[1:]))
    np.testing.assert_allclose(theirs @ rigid(theirs, ours), ours, atol=MILLIMETRE)


def test_blender_finds_what_is_written_to_a_glb(files, request, tmp_path):
    motion = read_motion(files["BEAT2"])
    formats.export(motion, tmp_path / "x.glb")
    check_writing(motion, request.getfixturevalue("blender")(tmp_path / "x.glb", FRAMES, 30))

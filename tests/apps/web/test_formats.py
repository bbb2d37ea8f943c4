"""Files that a page writes are those of Python: the same motion, places of the joints and rotations.

It needs node and the modules of web/ (npm ci there), and is skipped without them.
"""

import json
import pathlib
import subprocess

import numpy as np
import pytest
from fixtures.bundles import bundle
from fixtures.glb_reader import GlbReader

import ha2g_jax
from ha2g_jax.motion import rigs, rotations, solver
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.formats.gltf import write_figure
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.bvh import read_bvh
from ha2g_jax.motion.readers.bvh_motion import world_motion
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.skeleton import load_skeleton

ROOT = pathlib.Path(__file__).parents[3]
SECONDS = 5
MILLIMETRE = 1e-3


def speech_motion():
    """The first seconds of the demo's gestures, with the bone lengths of its training data."""
    model = ha2g_jax.load("demo")
    whole = model.generate(ROOT / "examples" / "hello.wav")
    directions = whole.directions[: round(SECONDS * whole.fps)]
    return Motion.from_directions(model.assets.skeleton, directions, whole.fps, whole.meta), model.assets.skeleton


def wild_motion(name):
    """A motion that leaves the range of the joints and reverses bones; its text needs more than ASCII."""
    skeleton = load_skeleton(name)
    random = np.random.default_rng(1)
    phases, speeds = random.uniform(0, 6, (2, skeleton.num_bones, 3))
    time = np.arange(40)[:, None, None] / 15
    directions = skeleton.mean_directions + 1.2 * np.sin(phases + speeds * time)
    return Motion.from_directions(skeleton, directions, 15.0, {"speech": "größe 🎤.wav", "duration": 2.7}), skeleton


MOTIONS = {
    "speech": speech_motion,
    "wild": lambda: wild_motion("ted_expressive"),
    "ted_gesture": lambda: wild_motion("ted_gesture"),
}


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    """The script that writes the files, with the modules of web/ in it."""
    return bundle(pathlib.Path(__file__).with_name("write_formats.ts"), tmp_path_factory.mktemp("script"))


@pytest.fixture(scope="module", params=MOTIONS)
def written(request, script, tmp_path_factory):
    """The motion, the folder with the files of both, and the rotations that the page computes."""
    folder = tmp_path_factory.mktemp(request.param)
    motion, skeleton = MOTIONS[request.param]()
    for suffix in ("npz", "bvh", "glb"):
        export(motion, folder / f"python.{suffix}")
    write_figure(folder / "figure.glb", skeleton)
    names = ("lengths", "mean_directions", "mean_pose")
    facts = {"name": skeleton.name, "joints": skeleton.joints, "bones": skeleton.bones}
    values = {
        "skeleton": facts | {name: getattr(skeleton, name).tolist() for name in names},
        "directions": motion.directions.ravel().tolist(),
        "fps": motion.fps,
        "meta": motion.meta,
    }
    (folder / "motion.json").write_text(json.dumps(values))
    command = [*script, folder / "motion.json", folder / "figure.glb", folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return motion, folder, json.loads(done.stdout)


def degrees_between(found, expected):
    """The largest angle between two arrays of quaternions, whatever their signs."""
    return float(np.rad2deg(rotations.angle_between(rotations.unit(found), rotations.unit(expected))).max())


def test_the_npz_is_the_motion(written):
    motion, folder, _ = written
    found = Motion.load(folder / "web.npz")
    np.testing.assert_allclose(found.directions, motion.directions, atol=1e-7)
    np.testing.assert_allclose(found.positions, motion.positions, atol=1e-6)
    assert (found.fps, found.joint_names, found.meta) == (motion.fps, motion.joint_names, motion.meta)


def test_the_bvh_has_the_joints_of_pythons_where_they_are(written):
    _, folder, _ = written
    ours, theirs = (read_bvh(folder / f"{name}.bvh") for name in ("python", "web"))
    assert (theirs.joints, theirs.parents, theirs.channels) == (ours.joints, ours.parents, ours.channels)
    assert theirs.fps == ours.fps
    places, found = (world_motion(bvh, bvh.fps, range(len(bvh.joints)))[0] / 100 for bvh in (ours, theirs))
    np.testing.assert_allclose(found, places, atol=MILLIMETRE)


def test_the_glb_moves_the_nodes_as_pythons(written):
    motion, folder, _ = written
    ours, theirs = (GlbReader(folder / f"{name}.glb") for name in ("python", "web"))
    assert theirs.tree["scenes"][0]["extras"] == ours.tree["scenes"][0]["extras"]
    assert [node["name"] for node in theirs.tree["nodes"]] == [node["name"] for node in ours.tree["nodes"]]
    times, expected = (glb.array(glb.tree["animations"][0]["samplers"][0]["input"]) for glb in (theirs, ours))
    np.testing.assert_allclose(times, expected, atol=1e-6)
    for frame in range(motion.num_frames):
        np.testing.assert_allclose(theirs.matrices(frame), ours.matrices(frame), atol=1e-4)
    for name in ("meshes", "skins", "materials"):
        assert len(theirs.tree[name]) == len(ours.tree[name])
    assert len(theirs.blob) == pytest.approx(len(ours.blob), rel=0.01)


@pytest.mark.parametrize("suffix", ["glb", "bvh"])
def test_what_a_page_writes_is_read(written, suffix):
    motion, folder, _ = written
    found = read_motion(folder / f"web.{suffix}", skeleton=motion.meta["skeleton"])
    assert found.fps == motion.fps
    np.testing.assert_allclose(found.positions, motion.positions, atol=MILLIMETRE)


VALIDATE = """
const bytes = new Uint8Array(require("fs").readFileSync(process.argv[1]));
require("gltf-validator").validateBytes(bytes).then((report) => console.log(JSON.stringify(report.issues)));
"""


def test_the_khronos_validator_finds_no_error(written, script):
    _, folder, _ = written
    if subprocess.run([script[0], "-e", "require('gltf-validator')"], capture_output=True, check=False).returncode:
        pytest.skip("no Khronos validator here (npm install gltf-validator, and set NODE_PATH)")
    command = [script[0], "-e", VALIDATE, folder / "web.glb"]
    issues = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"][:5]


@pytest.mark.parametrize("rig", ["ha2g", "mixamo", "vrm"])
def test_rotations_of_rigs_are_pythons(written, rig):
    motion, _, found = written
    expected = retarget(solver.animate(motion), rigs.load_rig(rig)).rotations
    assert degrees_between(np.reshape(found[rig], expected.shape), expected) < 0.01


def test_live_rotations_are_pythons(written):
    motion, _, found = written
    live = solver.Solver(motion.skeleton, motion.fps)
    pieces = [motion.directions[start : start + 4] for start in range(0, motion.num_frames, 4)]
    expected = np.concatenate([live.animate(piece).rotations for piece in pieces])
    assert degrees_between(np.reshape(found["live"], expected.shape), expected) < 0.01

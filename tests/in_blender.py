"""Run by a Python that has bpy, for test_blender: FOLDER with motion files in it; writes results.json there."""

import contextlib
import io
import json
import math
import pathlib
import sys

import bpy  # type: ignore[import-not-found]

import addon_utils  # type: ignore[import-not-found] # isort: skip
import mathutils  # type: ignore[import-not-found]

ROOT = pathlib.Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "integrations" / "blender"))

import ha2g_blender  # noqa: E402
import ha2g_motion  # noqa: E402
from ha2g_motion import armatures, reading, scene  # noqa: E402

folder = pathlib.Path(sys.argv[1])
results: dict = {}


def perform(*arguments: str) -> int:
    return ha2g_blender.main([str(folder / word) if "." in word else word for word in arguments])


def refuse(*arguments: str) -> str:
    """What a command says that ends with exit code 2, without the usage that argparse prints before it."""
    with contextlib.redirect_stderr(io.StringIO()) as said:
        try:
            assert perform(*arguments) == 2, arguments
        except SystemExit as stop:
            assert stop.code == 2, arguments
    text = said.getvalue()
    return text[text.rindex("ha2g_blender: error") :] if text.startswith("usage") else text


def positions(frames: range, first: float = 0) -> dict[str, list[list[float]]]:
    """Where the bones begin, in the axes of the files: x, z and -y of Blender's."""
    stage = bpy.context.scene
    found: dict[str, list[list[float]]] = {}
    for frame in frames:
        moment = first + frame * scene.rate(stage) / 15
        stage.frame_set(math.floor(moment + 1e-4), subframe=max(0.0, moment - math.floor(moment + 1e-4)))
        for thing in (thing for thing in bpy.data.objects if thing.type == "ARMATURE"):
            for bone in thing.pose.bones:
                x, y, z = thing.matrix_world @ bone.head
                found.setdefault(bone.name, []).append([x, z, -y])
    return found


def a_character() -> None:
    """An A-posed armature that faces +x, with y up and centimetres inside, and with rolled bones: bob, in bob.blend."""
    scene.clear()
    bob = armatures.make_armature(reading.read_motion(folder / "unreal.json"))
    bob.name = "bob"
    bob.rotation_euler, bob.scale = (math.radians(90), 0, 0), (0.01,) * 3
    turn = mathutils.Matrix.Rotation(math.radians(-90), 4, "X") @ mathutils.Matrix.Rotation(math.radians(90), 4, "Z")
    bpy.ops.object.mode_set(mode="EDIT")
    for index, bone in enumerate(bob.data.edit_bones):
        bone.transform(turn @ mathutils.Matrix.Scale(100, 4))
        bone.roll += 0.3 * index
    bpy.ops.object.mode_set(mode="OBJECT")
    bob.pose.bones["thigh_l"].rotation_quaternion = (0.8, 0.6, 0, 0)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "bob.blend"), copy=True)


perform("motion.glb", "-o", "scene.blend")
scene.open_file(folder / "scene.blend")
stage = bpy.context.scene
results["scene"] = positions(range(12))
results["scene_time"] = [scene.rate(stage), stage.frame_start, stage.frame_end]
figure = next(thing for thing in bpy.data.objects if thing.type == "MESH")
stage.frame_set(0)
seen = figure.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
results["body_moved"] = max((a.co - b.co).length for a, b in zip(seen.vertices, figure.data.vertices))

perform("ntsc.glb", "-o", "ntsc_again.glb")

perform("motion.bvh", "-o", "figure.fbx")
scene.open_file(folder / "figure.fbx")
results["fbx"] = positions(range(12), bpy.data.actions[0].frame_range[0])

a_character()
perform("motion.json", "--open", "bob.blend", "-o", "bob_moves.blend")
scene.open_file(folder / "bob_moves.blend")
results["bob"] = positions(range(12))
results["bob_thigh"] = list(bpy.data.objects["bob"].pose.bones["thigh_l"].rotation_quaternion)

results["says"] = {
    "no body": refuse("motion.bvh", "-o", "bones.png"),
    "no character": refuse("motion.json", "--open", "motion.bvh", "-o", "x.blend"),
    "over the motion": refuse("motion.glb", "-o", "motion.glb"),
    "over the character": refuse("motion.glb", "--open", "bob.blend", "-o", "bob.blend"),
    "no sound": refuse("motion.glb", "--audio", "motion.json", "-o", "x.blend"),
    "no time": refuse("motion.glb", "--time", "nan", "-o", "x.png"),
    "after the end": refuse("motion.glb", "--time", "99", "-o", "x.png"),
    "frames": refuse("motion.glb", "--start", "1048570", "-o", "x.blend"),
    "start": refuse("motion.glb", "--start", "99999999999", "-o", "x.blend"),
    "size": refuse("motion.glb", "--size", "0x0", "-o", "x.png"),
    "words": refuse("motion.glb", "--size", "large", "-o", "x.png"),
    "samples": refuse("motion.glb", "--samples", "-3", "-o", "x.png"),
}
armatures.make_armature(reading.read_motion(folder / "motion.json"))
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "two.blend"))
results["says"]["two armatures"] = refuse("motion.json", "--open", "two.blend", "-o", "x.blend")
scene.open_file(folder / "scene.blend")
bpy.context.scene.camera = bpy.data.objects.new("behind", bpy.data.cameras.new("behind"))
bpy.context.collection.objects.link(bpy.context.scene.camera)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "filmed.blend"))
results["says"]["camera"] = refuse("motion.json", "--open", "filmed.blend", "-o", "filmed.png")

scene.clear()
addon_utils.enable("rigify", default_set=True)
bpy.ops.object.armature_human_metarig_add()
bpy.ops.pose.rigify_generate()
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "rigify.blend"))
perform("motion.json", "--open", "rigify.blend", "--rig", "rig", "-o", "rigify_moves.blend")
scene.open_file(folder / "rigify_moves.blend")
bpy.data.objects.remove(bpy.data.objects["metarig"])
results["rigify"] = positions(range(12))

scene.clear()
results["film"] = perform(
    "motion.glb", "--audio", "tone.wav", "--start", "5", "--size", "48", "--samples", "1", "-o", "film.mp4"
)

scene.clear()
ha2g_motion.register()
settings = bpy.context.scene.ha2g
settings.motion, settings.sound, settings.start = str(folder / "motion.glb"), str(folder / "tone.wav"), 3
results["panel"] = list(bpy.ops.ha2g.make_figure())
results["panel_scene"] = positions(range(12), 3)
figure = bpy.context.object
bpy.ops.ha2g.apply_motion()
results["panel_sounds"] = [strip.sound.name for strip in scene._strips(bpy.context.scene)]
settings.start, settings.keep_rate = 20, True
bpy.ops.ha2g.make_figure()
results["panel_frames"] = [bpy.context.scene.frame_start, bpy.context.scene.frame_end]


def panel_error(operator, **changes) -> str:
    """What the panel says; it adds nothing to the file."""
    before = len(bpy.data.objects), len(bpy.data.actions)
    for name, value in changes.items():
        setattr(settings, name, value)
    try:
        operator()
    except RuntimeError as error:
        return str(error) if before == (len(bpy.data.objects), len(bpy.data.actions)) else "something was added"
    return "no error"


bpy.context.view_layer.objects.active = figure
data = figure.animation_data
data.nla_tracks.new().strips.new("motion", 3, data.action)
data.action = None
data.use_tweak_mode = True
errors = {"tweak": panel_error(bpy.ops.ha2g.apply_motion)}
data.use_tweak_mode = False
errors["frames"] = panel_error(bpy.ops.ha2g.make_figure, start=scene.MAX_FRAME)
errors["missing"] = panel_error(bpy.ops.ha2g.apply_motion, start=0, motion=str(folder / "missing.glb"))
with bpy.data.libraries.load(str(folder / "scene.blend"), link=True) as (found, linked):
    linked.objects = found.objects
armature = next(thing for thing in linked.objects if thing.type == "ARMATURE")
bpy.context.scene.collection.objects.link(armature)
bpy.context.view_layer.objects.active = armature
errors["linked"] = panel_error(bpy.ops.ha2g.apply_motion, motion=str(folder / "motion.glb"))
results["panel_errors"] = errors
ha2g_motion.unregister()
results["is_unregistered"] = not hasattr(bpy.types.Scene, "ha2g")

(folder / "results.json").write_text(json.dumps(results))

"""Run by a Python that has bpy: where Blender has the joints of a file. FILE OUT.json FPS FRAME [FRAME ...]"""

import json
import pathlib
import sys

import bpy  # type: ignore[import-not-found]

path, out, fps, *frames = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = round(float(fps))
if path.endswith(".bvh"):
    bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01, frame_start=1)
elif path.endswith(".fbx"):
    bpy.ops.import_scene.fbx(filepath=path)
else:
    bpy.ops.import_scene.gltf(filepath=path)
armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
found: dict[str, list] = {bone.name: [] for bone in armature.pose.bones}
for frame in frames:
    scene.frame_set(int(frame) + path.endswith((".bvh", ".fbx")))  # which Blender starts at frame 1
    for bone in armature.pose.bones:
        x, y, z = armature.matrix_world @ bone.head
        found[bone.name].append([x, z, -y])  # Blender's z is up, and it faces -y
pathlib.Path(out).write_text(json.dumps(found))

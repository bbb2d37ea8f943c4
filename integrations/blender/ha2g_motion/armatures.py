"""Armatures in Blender: a new one from a motion, with its body, or the rest pose of an existing one."""

from collections.abc import Iterable

import bpy
import numpy as np

from . import rotations
from .fitting import Target
from .motion import Body, Motion

# Blender has z up, and its figures face -y: (x, y, z) of a file is (x, -z, y) there, a rotation by 90 degrees about x.
TO_BLENDER = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
# Of Rigify: forward kinematics, and bones that rotate with those above them.
_RIGIFY = {"IK_FK": 1.0, "FK_limb_follow": 0.0, "neck_follow": 1.0, "head_follow": 1.0}
_TIP = 0.02  # metres; length of the bone of the last joint of a chain


def make_armature(motion: Motion) -> bpy.types.Object:
    """Add an armature in the rest pose of a motion, with one bone for each joint, and its body if it has one."""
    data = bpy.data.armatures.new(motion.name)
    armature = bpy.data.objects.new(motion.name, data)
    bpy.context.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    heads = rotations.rotate(TO_BLENDER, motion.places)
    bpy.ops.object.mode_set(mode="EDIT")
    for joint, (name, parent) in enumerate(zip(motion.joints, motion.parents)):
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = heads[joint], heads[joint] + _along(motion, heads, joint)
        if parent >= 0:
            bone.parent = data.edit_bones[motion.joints[parent]]
    bpy.ops.object.mode_set(mode="OBJECT")
    data.display_type = "STICK"
    if motion.body is not None:
        _add_body(motion, motion.body, armature)
    return armature


def pose_of(motion: Motion) -> np.ndarray:
    """Return the rotations (T, J, 4) of the bones of `make_armature` in its axes."""
    return rotations.multiply(rotations.multiply(TO_BLENDER, motion.rotations), rotations.conjugate(TO_BLENDER))


def root_location(motion: Motion, target: Target) -> np.ndarray:
    """Return the locations (T, 3) of the root bone of `make_armature` in the axes of the bone."""
    moved = rotations.rotate(TO_BLENDER, motion.root - motion.places[0])
    return rotations.rotate(rotations.conjugate(target.rest[0]), moved)


def target_of(armature: bpy.types.Object) -> Target:
    """Return the rest pose of an armature's bones."""
    bones = _parents_first(armature.pose.bones)
    names = {bone.name: index for index, bone in enumerate(bones)}
    return Target(
        tuple(names),
        tuple(names[parent.name] if (parent := _above(bone)) else -1 for bone in bones),
        np.array([bone.bone.head_local for bone in bones]),
        np.array([rotations.from_matrix(np.array(bone.bone.matrix_local.to_3x3().normalized())) for bone in bones]),
        tuple(bone.bone.use_inherit_rotation for bone in bones),
    )


def held_bones(armature: bpy.types.Object) -> list[str]:
    """Return the names of the bones of an armature whose constraints decide their rotation."""
    return [bone.name for bone in armature.pose.bones if any("LIMIT" not in rule.type for rule in _rules(bone))]


def follow_keys(armature: bpy.types.Object) -> None:
    """Let arms, neck and head of a rig that Rigify has made follow the keys of their own bones."""
    for name in ("torso", "upper_arm_parent.L", "upper_arm_parent.R"):
        bone = armature.pose.bones.get(name, {})
        for setting in _RIGIFY.keys() & set(bone.keys()):
            bone[setting] = _RIGIFY[setting]
    armature.update_tag()
    bpy.context.view_layer.update()


def _rules(bone: bpy.types.PoseBone) -> list[bpy.types.Constraint]:
    """Return the constraints of a bone that are on."""
    return [rule for rule in bone.constraints if not rule.mute and rule.influence > 0]


def _above(bone: bpy.types.PoseBone) -> bpy.types.PoseBone | None:
    """Return the bone that a bone rotates with: the one whose rotation it copies, or its parent."""
    for rule in _rules(bone):
        if rule.type in ("COPY_TRANSFORMS", "COPY_ROTATION") and rule.target is bone.id_data and rule.influence == 1:
            return bone.id_data.pose.bones.get(rule.subtarget)
    return bone.parent


def _parents_first(bones: Iterable[bpy.types.PoseBone]) -> list[bpy.types.PoseBone]:
    found: dict[str, bpy.types.PoseBone] = {}
    for bone in bones:
        chain: dict[str, bpy.types.PoseBone] = {}
        above: bpy.types.PoseBone | None = bone
        while above and above.name not in found and above.name not in chain:
            chain[above.name] = above
            above = _above(above)
        found.update(reversed(chain.items()))
    return list(found.values())


def _along(motion: Motion, heads: np.ndarray, joint: int) -> np.ndarray:
    """Return the vector from the head to the tail of a bone: to the joints below it, or away from its parent."""
    ends: list[np.ndarray] = []
    pending = [joint]
    for place in pending:
        for child in (index for index, parent in enumerate(motion.parents) if parent == place):
            bone = heads[child] - heads[joint]
            if np.linalg.norm(bone) > 1e-6:
                ends.append(bone)
            else:
                pending.append(child)
    mean = np.mean(ends, axis=0) if ends else np.zeros(3)
    if np.linalg.norm(mean) > 1e-3:
        return mean
    parent = motion.parents[joint]
    while parent >= 0:
        bone = heads[joint] - heads[parent]
        if np.linalg.norm(bone) > 1e-6:
            return _TIP * rotations.unit(bone)
        parent = motion.parents[parent]
    return np.array([0.0, 0.0, _TIP])


def _add_body(motion: Motion, body: Body, armature: bpy.types.Object) -> None:
    """Add the mesh with an armature modifier."""
    mesh = bpy.data.meshes.new("body")
    mesh.from_pydata(rotations.rotate(TO_BLENDER, body.points).tolist(), [], body.faces.tolist())
    for name, colour, roughness in body.colours:
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        surface = material.node_tree.nodes["Principled BSDF"]
        surface.inputs["Base Color"].default_value = colour
        surface.inputs["Roughness"].default_value = roughness
        material.diffuse_color = colour
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", body.materials.astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(body.faces), bool))
    mesh.update()
    figure = bpy.data.objects.new("body", mesh)
    bpy.context.collection.objects.link(figure)
    figure.parent = armature
    groups = [figure.vertex_groups.new(name=name) for name in motion.joints]
    for joint, group in enumerate(groups):
        weights = np.where(body.joints == joint, body.weights, 0).sum(axis=1)
        for weight in np.unique(weights[weights > 0]):
            group.add(np.flatnonzero(weights == weight).tolist(), float(weight), "REPLACE")
    figure.modifiers.new("armature", "ARMATURE").object = armature

"""Key frames of an armature from a motion."""

from collections.abc import Mapping

import bpy
import numpy as np

from . import armatures, bone_names, checks, fitting
from .motion import Motion, MotionError

_LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value


def make_figure(motion: Motion, *, start: float = 0, rate: float | None = None) -> bpy.types.Object:
    """Add an animated armature, with its body if the file has one.

    Args:
        motion: motion of the armature.
        start: frame of the first pose.
        rate: frames per second of the scene; None for those of the motion.
    """
    armature = armatures.make_armature(motion)
    target = armatures.target_of(armature)
    turned = armatures.pose_of(motion)
    wanted = {target.bones.index(name): turned[:, joint] for joint, name in enumerate(motion.joints)}
    local = fitting.local(target, wanted, motion.num_frames)
    curves = _Curves(armature, motion, start, rate)
    _write_rotations(armature, local, curves)
    if np.ptp(motion.root, axis=0).max() > 1e-6:
        root = target.bones[0]
        path = f'pose.bones["{bpy.utils.escape_identifier(root)}"].location'
        curves.write(path, armatures.root_location(motion, target), root)
    return armature


def apply_motion(
    motion: Motion,
    armature: bpy.types.Object,
    *,
    names: bone_names.Names | None = None,
    humanoid: Mapping[str, str] | None = None,
    start: float = 0,
    rate: float | None = None,
) -> bone_names.Names:
    """Add a motion to an armature as a new action; bones without a joint do not change.

    The rotation mode of the bones becomes quaternions. The previous action is kept in the file.

    Args:
        motion: motion to apply.
        armature: armature object.
        names: joint and weight by bone; None to find them, see `bone_names.match`.
        humanoid: name in the VRM standard by bone, where the character's file states it.
        start: frame of the first pose.
        rate: frames per second of the scene; None for those of the motion.

    Returns:
        Joint and weight by bone, as they were used.

    Raises:
        MotionError: the names do not fit, or the armature cannot have another action.
    """
    what = checks.shown(armature.name)
    if armature.library is not None:  # Blender would not store the action
        raise MotionError(f"{what} is linked from another file; make a library override of it first")
    if armature.animation_data is not None and armature.animation_data.use_tweak_mode:
        raise MotionError(f"{what} is in tweak mode of the NLA; leave it (Tab) first")
    armatures.follow_keys(armature)
    target = armatures.target_of(armature)
    held = armatures.held_bones(armature)
    names = bone_names.match(motion, target.bones, names, humanoid=humanoid, held=held)
    local = fitting.fit(motion, target, names)
    _write_rotations(armature, local, _Curves(armature, motion, start, rate))
    return names


class _Curves:
    """A new action of an armature to which whole curves are written, which is faster than single keys."""

    def __init__(self, armature: bpy.types.Object, motion: Motion, start: float, rate: float | None) -> None:
        motions = armature.animation_data or armature.animation_data_create()
        if motions.action is not None:
            motions.action.use_fake_user = True
        self._armature = armature
        self._action = bpy.data.actions.new(f"{armature.name} motion")
        motions.action = self._action
        self._frames = start + np.arange(motion.num_frames) * ((rate or motion.fps) / motion.fps)

    def write(self, path: str, values: np.ndarray, group: str) -> None:
        """Write one curve for each column of values (T, n)."""
        for index, column in enumerate(values.T):
            curve = self._curve(path, index, group)
            curve.keyframe_points.add(len(column))
            points = np.stack([self._frames, column], axis=1)
            curve.keyframe_points.foreach_set("co", points.ravel().astype(np.float32))
            curve.keyframe_points.foreach_set("interpolation", np.full(len(column), _LINEAR, np.int32))
            curve.update()

    def _curve(self, path: str, index: int, group: str) -> bpy.types.FCurve:
        if not hasattr(self._action, "fcurves"):  # since Blender 5
            return self._action.fcurve_ensure_for_datablock(self._armature, path, index=index, group_name=group)
        curve = self._action.fcurves.new(path, index=index, action_group=group)
        if hasattr(self._action, "slots"):  # since Blender 4.4; the first curve makes the slot
            self._armature.animation_data.action_slot = self._action.slots[0]
        return curve


def _write_rotations(armature: bpy.types.Object, local: dict[str, np.ndarray], curves: _Curves) -> None:
    for bone, rotation in local.items():
        armature.pose.bones[bone].rotation_mode = "QUATERNION"
        # Blender's quaternions begin with w.
        path = f'pose.bones["{bpy.utils.escape_identifier(bone)}"].rotation_quaternion'
        curves.write(path, rotation[:, [3, 0, 1, 2]], bone)

"""Panel of the add-on in the sidebar of the 3D view (N), tab HA2G."""

import pathlib

import bpy

from . import bone_names, keys, reading, scene
from .motion import Motion, MotionError


class Ha2gSettings(bpy.types.PropertyGroup):
    """Settings of the panel, which are stored in the scene."""

    motion: bpy.props.StringProperty(  # type: ignore
        name="Motion", description="A .glb, .vrma, .bvh, .json or .npz of ha2g-jax", subtype="FILE_PATH"
    )
    sound: bpy.props.StringProperty(  # type: ignore
        name="Sound", description="The speech (optional)", subtype="FILE_PATH"
    )
    names: bpy.props.StringProperty(  # type: ignore
        name="Bone names",
        description='A JSON file {"BONE": "JOINT"} (optional; by default the names of common rigs)',
        subtype="FILE_PATH",
    )
    start: bpy.props.IntProperty(  # type: ignore
        name="Start", description="Frame of the first pose", default=0, min=0, max=scene.MAX_FRAME
    )
    keep_rate: bpy.props.BoolProperty(  # type: ignore
        name="Keep scene's frame rate",
        description="And its frames. Otherwise the scene takes those of the motion",
        default=False,
    )


class HA2G_OT_make_figure(bpy.types.Operator):
    """Add an animated armature, with a simple body if the file has one"""

    bl_idname = "ha2g.make_figure"
    bl_label = "Add Figure"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    def execute(self, context: bpy.types.Context) -> set[str]:
        return _perform(self, context, None)


class HA2G_OT_apply_motion(bpy.types.Operator):
    """Add the motion to the active armature as a new action"""

    bl_idname = "ha2g.apply_motion"
    bl_label = "Apply to Armature"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and context.object.type == "ARMATURE"

    def execute(self, context: bpy.types.Context) -> set[str]:
        return _perform(self, context, context.object)


class HA2G_PT_motion(bpy.types.Panel):
    """Panel with the settings and the two operators."""

    bl_label = "HA2G Motion"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "HA2G"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.ha2g
        self.layout.use_property_split = True
        for field in ("motion", "sound", "names", "start", "keep_rate"):
            self.layout.prop(settings, field)
        self.layout.operator("ha2g.make_figure", icon="OUTLINER_OB_ARMATURE")
        self.layout.operator("ha2g.apply_motion", icon="POSE_HLT")


_CLASSES = (Ha2gSettings, HA2G_OT_make_figure, HA2G_OT_apply_motion, HA2G_PT_motion)


def register() -> None:
    """Add the panel and its settings."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.ha2g = bpy.props.PointerProperty(type=Ha2gSettings)


def unregister() -> None:
    """Remove the panel and its settings."""
    del bpy.types.Scene.ha2g
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)


def _perform(operator: bpy.types.Operator, context: bpy.types.Context, armature: bpy.types.Object | None) -> set[str]:
    """Run an operator and report a mistake of the user in Blender."""
    settings = context.scene.ha2g
    try:
        motion = reading.read_motion(bpy.path.abspath(settings.motion))
        text = _load(motion, armature, context.scene)
    except MotionError as error:
        operator.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    operator.report({"INFO"}, text)
    return {"FINISHED"}


def _load(motion: Motion, armature: bpy.types.Object | None, stage: bpy.types.Scene) -> str:
    settings = stage.ha2g
    names = bone_names.read_names(bpy.path.abspath(settings.names)) if settings.names else None
    sound = pathlib.Path(bpy.path.abspath(settings.sound)) if settings.sound else None
    if sound:
        scene.check_sound(sound)
    rate = scene.rate(stage) if settings.keep_rate else motion.fps
    scene.last_frame(motion, settings.start, rate)
    # The armature comes first: if its names do not fit, nothing else has changed.
    if armature is None:
        text = f"{keys.make_figure(motion, start=settings.start, rate=rate).name}: {len(motion.joints)} bones"
    else:
        used = keys.apply_motion(motion, armature, names=names, start=settings.start, rate=rate)
        text = f"{armature.name}: {len(used)} bones move"
    scene.set_time(stage, motion, start=settings.start, keep_rate=settings.keep_rate)
    if sound:
        scene.add_sound(stage, sound, settings.start)
    return f"{text}, {motion.num_frames} frames"

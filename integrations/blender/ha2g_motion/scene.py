"""The scene around a figure: its time and sound, opening and writing of files, and images."""

import contextlib
import math
import os
import pathlib
from collections.abc import Iterator

import aud
import bpy
import bpy_extras
import mathutils

from . import checks, glb
from .motion import Motion, MotionError

OUTPUTS = (".blend", ".fbx", ".glb", ".mp4", ".png")
CHARACTERS = (".blend", ".fbx", ".glb", ".gltf", ".vrm")
MAX_FRAME = 1_048_574  # of a scene of Blender, which takes a larger or negative number as the nearest one


def open_file(path: pathlib.Path) -> dict[str, str]:
    """Open a `.blend`, or import a `.fbx`, `.glb`, `.gltf` or `.vrm` into an empty scene.

    Returns:
        The name in the VRM standard of each bone, of a `.glb` or `.vrm` that states it.

    Raises:
        MotionError: there is no such file, or Blender cannot read it.
    """
    if not path.is_file():
        raise MotionError(f"no character at {checks.shown(path)}; give a {', '.join(CHARACTERS)} file")
    suffix = path.suffix.lower()
    if suffix not in CHARACTERS:
        raise MotionError(f"cannot open {checks.shown(path.name)}; expected one of {', '.join(CHARACTERS)}")
    try:
        if suffix == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path))
            return {}
        clear()
        if suffix == ".fbx":
            bpy.ops.import_scene.fbx(filepath=str(path))
        else:
            bpy.ops.import_scene.gltf(filepath=str(path))
        return glb.humanoid(path) if suffix in (".glb", ".vrm") else {}
    except (RuntimeError, ValueError, LookupError, TypeError, AttributeError) as error:
        said = str(error).strip().splitlines()[-1]
        raise MotionError(f"Blender cannot read {checks.shown(path)} ({said})") from error


def clear() -> None:
    """Replace the scene by an empty one, without the cube, lamp and camera of Blender's start file."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def find_armature(name: str | None = None) -> bpy.types.Object:
    """Return the armature of a name, or the only one.

    Raises:
        MotionError: there is no such armature, or there are several and no name.
    """
    armatures = [thing.name for thing in bpy.context.scene.objects if thing.type == "ARMATURE"]
    if name in armatures or (name is None and len(armatures) == 1):
        return bpy.data.objects[name or armatures[0]]
    if not armatures:
        raise MotionError("the character has no armature; give one with bones")
    found = checks.shown(f"the character has the armatures {', '.join(armatures)}")
    raise MotionError(f"{found}, and none is named {name}" if name else f"{found}; choose one with --rig")


def rate(scene: bpy.types.Scene) -> float:
    """Return the frames per second of a scene."""
    return scene.render.fps / scene.render.fps_base


def last_frame(motion: Motion, start: int, rate: float) -> int:
    """Return the last frame of a motion that begins at a frame of a scene.

    Raises:
        MotionError: a scene cannot have these frames.
    """
    end = max(start, start + round(motion.num_frames / motion.fps * rate) - 1)
    if not 0 <= start <= end <= MAX_FRAME:
        raise MotionError(f"frames {start} to {end}, and a scene has 0 to {MAX_FRAME}; give another first frame")
    return end


def set_time(scene: bpy.types.Scene, motion: Motion, *, start: int = 0, keep_rate: bool = False) -> None:
    """Set the frames of a scene, and its frames per second, to those of a motion.

    Args:
        scene: scene to change.
        motion: motion with the length and the frame rate.
        start: frame of the first pose.
        keep_rate: whether to keep the frames per second of the scene; its own frames are then kept too, so that the
            rest of a shot stays in it.

    Raises:
        MotionError: a scene cannot have these frames.
    """
    end = last_frame(motion, start, rate(scene) if keep_rate else motion.fps)
    if keep_rate:
        scene.frame_start, scene.frame_end = min(start, scene.frame_start), max(end, scene.frame_end)
        return
    scene.render.fps = math.ceil(motion.fps)
    scene.render.fps_base = math.ceil(motion.fps) / motion.fps
    scene.frame_start, scene.frame_end = start, end


def check_sound(path: pathlib.Path) -> None:
    """Check that there is a file of sound.

    Raises:
        MotionError: there is no such file, or Blender cannot read it.
    """
    if not path.is_file():
        raise MotionError(f"no sound at {checks.shown(path)}; give an audio file")
    try:
        _ = aud.Sound(str(path)).specs
    except aud.error as error:
        raise MotionError(f"{checks.shown(path)} has no sound that Blender can read; give an audio file") from error


def add_sound(scene: bpy.types.Scene, path: pathlib.Path, start: int = 0) -> None:
    """Add the speech to the sequencer of a scene, unless it is there, and synchronise playback with it.

    Args:
        scene: scene to change.
        path: audio file.
        start: frame of the start of the sound.

    Raises:
        MotionError: there is no such file, or Blender cannot read it.
    """
    check_sound(path)
    strips = _strips(scene)
    scene.sync_mode = "AUDIO_SYNC"
    there = [strip for strip in strips if strip.type == "SOUND" and strip.frame_start == start]
    if any(pathlib.Path(bpy.path.abspath(strip.sound.filepath)).resolve() == path.resolve() for strip in there):
        return
    channel = 1 + max((strip.channel for strip in strips), default=0)
    strips.new_sound(path.stem, str(path.resolve()), channel, start)


def _strips(scene: bpy.types.Scene) -> bpy.types.bpy_prop_collection:
    editor = scene.sequence_editor_create()
    return editor.strips if hasattr(editor, "strips") else editor.sequences  # before Blender 4.4


def write(
    path: pathlib.Path,
    armature: bpy.types.Object,
    *,
    size: tuple[int, int] = (640, 640),
    samples: int = 8,
    engine: str = "CYCLES",
    seconds: float = 0.0,
    start: int = 0,
) -> None:
    """Write the scene to a file in the format that the suffix names.

    Args:
        path: `.blend`; `.fbx` or `.glb` of the armature, its meshes and its motion; `.mp4`, or a `.png` of one moment.
        armature: armature object.
        size: width and height of images in pixels.
        samples: rays per pixel of Cycles.
        engine: render engine: CYCLES, which needs no graphics card, or another of Blender.
        seconds: time of a `.png` in seconds.
        start: frame of the first pose.

    Raises:
        MotionError: the suffix is another, or the file cannot be written.
    """
    scene = bpy.context.scene
    suffix = path.suffix.lower()
    if suffix not in OUTPUTS:
        raise MotionError(f"cannot write {checks.shown(path.name)}; expected one of {', '.join(OUTPUTS)}")
    with _whole(path) as temporary:
        if suffix == ".blend":
            bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, check_existing=False)
        elif suffix in (".fbx", ".glb"):
            _export(temporary, armature)
        else:
            _prepare_picture(scene, armature, size, samples, engine)
            if suffix == ".png":
                moment = start + seconds * rate(scene)
                scene.frame_set(math.floor(moment), subframe=moment - math.floor(moment))
            _render(scene, temporary, is_video=suffix == ".mp4")


def _export(path: pathlib.Path, armature: bpy.types.Object) -> None:
    parts = _parts(bpy.context.scene, armature)
    for thing in bpy.context.scene.objects:
        thing.select_set(thing is armature or thing in parts)
    bpy.context.view_layer.objects.active = armature
    if path.suffix == ".glb":
        _export_glb(path, bpy.context.scene)
        return
    bpy.ops.export_scene.fbx(
        filepath=str(path),
        use_selection=True,
        object_types={"ARMATURE", "MESH"},
        add_leaf_bones=False,
        bake_anim_use_all_actions=False,
        bake_anim_use_nla_strips=False,
        bake_anim_simplify_factor=0.0,
    )


def _export_glb(path: pathlib.Path, scene: bpy.types.Scene) -> None:
    """Write the selection with the speed of the scene, whether the exporter multiplies or divides by `fps_base`.

    The exporter of Blender 4.2 to 5.0 multiplies, although frames per second are `fps / fps_base`.
    """
    wanted, own = rate(scene), scene.render.fps_base
    for base in dict.fromkeys((1 / own, own)):
        scene.render.fps_base = base
        bpy.ops.export_scene.gltf(filepath=str(path), use_selection=True, export_animation_mode="ACTIVE_ACTIONS")
        # The wrong one of the two makes the motion faster or slower by own * own.
        if math.isclose(glb.frame_rate(path), wanted, rel_tol=1 - min(own, 1 / own)):
            break
    scene.render.fps_base = own


def _parts(scene: bpy.types.Scene, armature: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the objects that an armature moves."""
    return [thing for thing in scene.objects if armature in (thing.parent, thing.find_armature())]


def _prepare_picture(
    scene: bpy.types.Scene, armature: bpy.types.Object, size: tuple[int, int], samples: int, engine: str
) -> None:
    """Set engine and size; add a camera in front of the figure, a lamp and a backdrop where they are missing."""
    meshes = [thing for thing in _parts(scene, armature) if thing.type == "MESH" and not thing.hide_render]
    if not meshes:
        what = f"{checks.shown(armature.name)} has bones and no body, so that its image would be empty"
        raise MotionError(f"{what}; export the motion as .glb, or give a character (--open)")
    render = scene.render
    try:
        render.engine = engine
    except TypeError as error:
        raise MotionError(f"this Blender has no engine {engine}; use CYCLES") from error
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    if engine == "CYCLES":
        scene.cycles.samples, scene.cycles.use_denoising = samples, False
    if scene.world is None:
        scene.world = bpy.data.worlds.new("World")
        scene.world.use_nodes = True
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.52, 0.55, 1)
    if not any(thing.type == "LIGHT" for thing in scene.objects):
        sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
        sun.data.energy, sun.data.angle = 2.5, 0.4
        sun.rotation_euler = (math.radians(50), math.radians(-15), math.radians(-30))
        scene.collection.objects.link(sun)
    if scene.camera is None:
        scene.camera = _camera(scene, armature)
    elif not _is_seen(scene, armature):
        what = checks.shown(f"the camera {scene.camera.name} of the character's file does not show {armature.name}")
        raise MotionError(f"{what}; turn it to the figure, or delete it for one that does")


def _is_seen(scene: bpy.types.Scene, armature: bpy.types.Object) -> bool:
    """Return whether the head of any bone is in the camera's view."""
    places = [armature.matrix_world @ bone.head for bone in armature.pose.bones]
    views = [bpy_extras.object_utils.world_to_camera_view(scene, scene.camera, place) for place in places]
    return any(0 < x < 1 and 0 < y < 1 and depth > 0 for x, y, depth in views)


def _camera(scene: bpy.types.Scene, armature: bpy.types.Object) -> bpy.types.Object:
    """Add a camera that shows the whole motion from the front, which is -y in Blender."""
    data = bpy.data.cameras.new("Camera")
    camera = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(camera)
    points = []
    for frame in range(scene.frame_start, scene.frame_end + 1, max(1, (scene.frame_end - scene.frame_start) // 20)):
        scene.frame_set(frame)
        points += [armature.matrix_world @ bone.head for bone in armature.pose.bones]
    low, high = (mathutils.Vector([pick(values) for values in zip(*points)]) for pick in (min, max))
    # The body extends beyond the joints. The angle of a camera is that of the longer side of its image.
    size = scene.render.resolution_x, scene.render.resolution_y
    extent = 1.35 * max((high.x - low.x) * max(size) / size[0], (high.z - low.z) * max(size) / size[1])
    distance = extent / (2 * math.tan(data.angle / 2)) + (high.y - low.y) / 2
    camera.location = (low + high) / 2 - mathutils.Vector((0, distance, 0))
    camera.rotation_euler = (math.radians(90), 0, 0)
    return camera


def _render(scene: bpy.types.Scene, path: pathlib.Path, *, is_video: bool) -> None:
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # since Blender 5
        settings.media_type = "VIDEO" if is_video else "IMAGE"
    settings.file_format = "FFMPEG" if is_video else "PNG"
    if is_video:
        video = scene.render.ffmpeg
        video.format, video.codec, video.constant_rate_factor = "MPEG4", "H264", "HIGH"
        video.audio_codec = "AAC" if any(strip.type == "SOUND" for strip in _strips(scene)) else "NONE"
    scene.render.use_file_extension = False
    scene.render.filepath = str(path)
    bpy.ops.render.render(animation=is_video, write_still=not is_video)


@contextlib.contextmanager
def _whole(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield a temporary name beside `path`, which becomes `path` when the file is complete."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix.lower()}").resolve()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except (OSError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise MotionError(f"cannot write {checks.shown(path)} ({reason}); choose another place") from error
    finally:
        temporary.unlink(missing_ok=True)

"""VRM Animation: a `.glb` without a mesh whose nodes are named by the extension VRMC_vrm_animation."""

import pathlib

from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.formats.gltf import Document, describe

_EXTENSION = "VRMC_vrm_animation"


def write(
    path: str | pathlib.Path, animation: Animation, *, duration: float | None = None, audio_name: str | None = None
) -> None:
    """Writes a `.vrma` of an animation of the rig vrm (vrm-c/vrm-specification, VRMC_vrm_animation-1.0).

    Any VRM avatar can play it: a player turns the avatar's bones as these turn from the VRM T-pose, which is how the
    nodes lie at rest.

    Args:
        duration: seconds of the speech.
        audio_name: file name of the speech.

    Raises:
        UserError: the place cannot be written.
    """
    document = Document()
    nodes = document.add_armature(animation)
    bones = {name: {"node": node} for name, node in zip(animation.armature.joints, nodes, strict=True)}
    document.gltf.extensionsUsed = [_EXTENSION]
    document.gltf.extensions = {_EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    document.gltf.scenes[0].extras = describe(animation, duration, audio_name)
    with whole_file(path) as temporary:
        temporary.write_bytes(document.to_bytes())

"""VRM Animation files: a `.glb` without a mesh whose nodes are assigned by the extension VRMC_vrm_animation."""

import pathlib

from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.formats.gltf import Document, describe

_EXTENSION = "VRMC_vrm_animation"


def write(
    path: str | pathlib.Path, animation: Animation, *, duration: float | None = None, audio_name: str | None = None
) -> None:
    """Write a `.vrma` file (vrm-c/vrm-specification, VRMC_vrm_animation-1.0).

    Any VRM avatar can play it: a player rotates the bones of the avatar as the nodes rotate from the VRM T-pose, which
    is the rest pose of the nodes.

    Args:
        path: file to write.
        animation: animation of the rig vrm.
        duration: length of the speech in seconds.
        audio_name: file name of the speech.

    Raises:
        UserError: the file cannot be written.
    """
    document = Document()
    nodes = document.add_armature(animation)
    bones = {name: {"node": node} for name, node in zip(animation.armature.joints, nodes, strict=True)}
    document.gltf.extensionsUsed = [_EXTENSION]
    document.gltf.extensions = {_EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    document.gltf.scenes[0].extras = describe(animation, duration, audio_name)
    with whole_file(path) as temporary:
        temporary.write_bytes(document.to_bytes())

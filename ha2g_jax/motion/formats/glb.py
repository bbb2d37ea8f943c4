"""GLB files: joints as nodes, one animation, and a skinned body that any glTF viewer shows."""

import pathlib

import numpy as np
import pygltflib

from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.formats.body_mesh import COLOURS, body_mesh
from ha2g_jax.motion.formats.gltf import Document, describe
from ha2g_jax.motion.rigs import rest_positions


def write(
    path: str | pathlib.Path, animation: Animation, *, duration: float | None = None, audio_name: str | None = None
) -> None:
    """Write a `.glb` file (glTF 2.0): metres, y up, facing +z.

    The nodes have the names and the rest pose of the joints, below a node with the name of the rig. The `extras` of
    the scene hold `audio_seconds`, `audio`, `fps`, `frames` and `meta`.

    Args:
        path: file to write.
        animation: animation of any rig.
        duration: length of the speech in seconds.
        audio_name: file name of the speech.

    Raises:
        UserError: the file cannot be written.
    """
    document = Document()
    nodes = document.add_armature(animation)
    _add_body(document, animation, nodes)
    document.gltf.scenes[0].extras = describe(animation, duration, audio_name)
    with whole_file(path) as temporary:
        temporary.write_bytes(document.to_bytes())


def _add_body(document: Document, animation: Animation, nodes: list[int]) -> None:
    """Add the mesh of the body in the rest pose, its materials and its skin."""
    gltf = document.gltf
    root = animation.translation[0]
    parts = body_mesh(animation.armature)
    primitives = []
    for colour, part in parts.items():
        joints, weights = part.bindings
        attributes = pygltflib.Attributes(
            POSITION=document.add_array(
                (part.points + root).astype(np.float32), target=pygltflib.ARRAY_BUFFER, bounds=True
            ),
            NORMAL=document.add_array(part.normals.astype(np.float32), target=pygltflib.ARRAY_BUFFER),
            JOINTS_0=document.add_array(joints.astype(np.uint8), target=pygltflib.ARRAY_BUFFER),
            WEIGHTS_0=document.add_array(weights, target=pygltflib.ARRAY_BUFFER),
        )
        faces = document.add_array(part.faces.reshape(-1).astype(np.uint16), target=pygltflib.ELEMENT_ARRAY_BUFFER)
        primitives.append(pygltflib.Primitive(attributes=attributes, indices=faces, material=len(gltf.materials)))
        gltf.materials.append(_material(colour))
    gltf.meshes.append(pygltflib.Mesh(name="body", primitives=primitives))
    inverse = document.add_array(_inverse_bind(animation, root).astype(np.float32))
    gltf.skins.append(pygltflib.Skin(joints=nodes, skeleton=nodes[0], inverseBindMatrices=inverse))
    gltf.nodes.append(pygltflib.Node(name="body", mesh=0, skin=0))
    document.roots.append(len(gltf.nodes) - 1)


def _material(name: str) -> pygltflib.Material:
    red, green, blue, roughness = COLOURS[name]
    surface = pygltflib.PbrMetallicRoughness(
        baseColorFactor=[red, green, blue, 1.0], metallicFactor=0.0, roughnessFactor=roughness
    )
    return pygltflib.Material(name=name, pbrMetallicRoughness=surface, alphaMode=None, alphaCutoff=None)


def _inverse_bind(animation: Animation, root: np.ndarray) -> np.ndarray:
    """Return (J, 16) inverse bind matrices of the joints, column by column as in glTF."""
    orientations, places = rest_positions(animation.armature)
    back = rotations.to_matrix(rotations.conjugate(orientations))
    matrices = np.zeros((len(places), 4, 4))
    matrices[:, :3, :3] = back
    matrices[:, :3, 3] = -np.einsum("jab,jb->ja", back, places + root)
    matrices[:, 3, 3] = 1
    return matrices.transpose(0, 2, 1).reshape(-1, 16)

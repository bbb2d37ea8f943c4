"""glTF 2.0: `.glb` files with a skinned body, and `.vrma` files, VRM animations without a mesh."""

import json
import pathlib
from typing import Any

import numpy as np
import pygltflib

from ha2g_jax.figure import Colour
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, figure_armature, rest_positions
from ha2g_jax.motion.formats.body_mesh import COLOURS, body_mesh
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.motion.lower_body import SOLE
from ha2g_jax.motion.rigs import places
from ha2g_jax.skeleton import Skeleton

# A joint that changes by less than this needs no channel: its node already has the rest rotation.
_STILL = 1e-9
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_COMPONENTS = {
    np.dtype(np.float32): pygltflib.FLOAT,
    np.dtype(np.uint32): pygltflib.UNSIGNED_INT,
    np.dtype(np.uint16): pygltflib.UNSIGNED_SHORT,
    np.dtype(np.uint8): pygltflib.UNSIGNED_BYTE,
}
_EXTENSION = "VRMC_vrm_animation"


def write_glb(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.glb` file: metres, y up, facing +z.

    The nodes have the names and the rest pose of the joints, below a node with the name of the rig. The `extras` of the
    scene hold `audio_seconds`, `audio`, `fps`, `frames` and `meta`.
    """
    document = Document()
    nodes = document.add_armature(animation)
    _add_body(document, animation, nodes)
    document.write(path, _extras(animation))


def write_vrma(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.vrma` file (VRMC_vrm_animation-1.0), whose nodes rotate from the T-pose as the bones of any VRM
    avatar.
    """
    document = Document()
    nodes = document.add_armature(animation)
    bones = {name: {"node": node} for name, node in zip(animation.armature.joints, nodes, strict=True)}
    document.gltf.extensionsUsed = [_EXTENSION]
    document.gltf.extensions = {_EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    document.write(path, _extras(animation))


def write_figure(path: str | pathlib.Path, skeleton: Skeleton) -> None:
    """Write the figure of a model as a `.glb` file with one frame, the T-pose.

    Its nodes, mesh and skin are those of every `.glb` of a motion of the model; a page replaces the animation.
    """
    armature = figure_armature(skeleton)
    write_glb(path, Animation(armature, armature.rest[None], np.zeros((1, 3)), 15.0, {}))


class Document:
    """A glTF document to which arrays and armatures are added; `roots` are the root nodes of the scene."""

    def __init__(self) -> None:
        self.gltf = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0", generator="ha2g-jax"))
        self.roots: list[int] = []
        self.gltf.scene, self.gltf.scenes = 0, [pygltflib.Scene(nodes=self.roots)]
        self._chunks: list[bytes] = []
        self._length = 0

    def add_array(self, values: np.ndarray, *, target: int | None = None, bounds: bool = False) -> int:
        """Store an array in the binary chunk and return the index of its accessor.

        Args:
            values: (n,), (n, 3), (n, 4) or (n, 16) float32 or unsigned integers.
            target: glTF's constant for the use of the buffer view.
            bounds: whether to store the minimum and maximum of the columns.
        """
        data = np.ascontiguousarray(values).tobytes()
        view = pygltflib.BufferView(buffer=0, byteOffset=self._length, byteLength=len(data), target=target)
        padded = data + bytes(-len(data) % 4)
        self._chunks.append(padded)
        self._length += len(padded)
        self.gltf.bufferViews.append(view)
        flat = values.reshape(len(values), -1)
        accessor = pygltflib.Accessor(
            bufferView=len(self.gltf.bufferViews) - 1,
            componentType=_COMPONENTS[values.dtype],
            count=len(values),
            type=_TYPES[flat.shape[1]],
            min=flat.min(axis=0).tolist() if bounds else None,
            max=flat.max(axis=0).tolist() if bounds else None,
        )
        self.gltf.accessors.append(accessor)
        return len(self.gltf.accessors) - 1

    def add_armature(self, animation: Animation) -> list[int]:
        """Add the animation, and a node for each joint below a node with the name of the rig; return the former."""
        armature, gltf = animation.armature, self.gltf
        top = len(gltf.nodes)
        nodes = [top + 1 + index for index in range(len(armature.joints))]
        gltf.nodes.append(pygltflib.Node(name=armature.name, children=[nodes[0]]))
        self.roots.append(top)
        for index, name in enumerate(armature.joints):
            place = _rest_place(animation) if index == 0 else armature.offsets[index]
            children = [nodes[child] for child, parent in enumerate(armature.parents) if parent == index]
            gltf.nodes.append(
                pygltflib.Node(
                    name=name, translation=_plain(place), rotation=_plain(armature.rest[index]), children=children
                )
            )
        self._animate(animation, nodes)
        return nodes

    def _animate(self, animation: Animation, nodes: list[int]) -> None:
        """Add one linear animation with a channel for the root and for each joint that leaves its rest rotation."""
        time = self.add_array((np.arange(animation.num_frames) / animation.fps).astype(np.float32), bounds=True)
        clip = pygltflib.Animation(name="motion", channels=[], samplers=[])

        def add(node: int, path: str, values: np.ndarray) -> None:
            output = self.add_array(values.astype(np.float32))
            clip.samplers.append(pygltflib.AnimationSampler(input=time, output=output, interpolation="LINEAR"))
            target = pygltflib.AnimationChannelTarget(node=node, path=path)
            clip.channels.append(pygltflib.AnimationChannel(sampler=len(clip.samplers) - 1, target=target))

        if _moves(animation):
            add(nodes[0], "translation", animation.translation)
        for index, node in enumerate(nodes):
            rotations = animation.rotations[:, index]
            if index == 0 or np.abs(rotations - animation.armature.rest[index]).max() > _STILL:
                add(node, "rotation", rotations)
        self.gltf.animations.append(clip)

    def write(self, path: str | pathlib.Path, extras: dict[str, Any]) -> None:
        """Write the document with facts of its scene as a binary container."""
        self.gltf.scenes[0].extras = extras
        blob = b"".join(self._chunks)
        self.gltf.buffers = [pygltflib.Buffer(byteLength=len(blob))]
        self.gltf.set_binary_blob(blob)
        with whole_file(path) as temporary:
            temporary.write_bytes(b"".join(self.gltf.save_to_bytes()))


def _moves(animation: Animation) -> bool:
    return np.ptp(animation.translation, axis=0).max() > _STILL


def _rest_place(animation: Animation) -> np.ndarray:
    """Return the place (3,) of the root in the rest pose: where it stays, or else where a person stands at the origin.

    Players of VRM scale the movement of the hips by their height at rest, which is not that of a person who sits.
    """
    if not _moves(animation):
        return animation.translation[0]
    _, positions = rest_positions(animation.armature)
    legs = [index for name, index in places(animation.armature).items() if name in LOWER_JOINTS]
    return np.array([0.0, SOLE - positions[legs, 1].min(), 0.0]) if legs else animation.translation[0]


def _plain(values: np.ndarray) -> list[float]:
    # Rounded, because 1 and the last bit of a unit quaternion is out of glTF's range.
    return [round(float(value), 9) + 0.0 for value in values]


def _extras(animation: Animation) -> dict[str, Any]:
    """Return the `extras` of a motion: `fps`, `frames`, `audio_seconds` and `audio` of the speech, and `meta`."""
    meta, frames = animation.meta, animation.num_frames
    seconds, speech = meta.get("duration"), meta.get("speech")
    if not isinstance(seconds, int | float):  # the metadata of a file may be any JSON
        seconds = frames / animation.fps
    audio = {"audio": speech} if isinstance(speech, str) else {}
    facts = {"fps": animation.fps, "frames": frames, "audio_seconds": seconds, "meta": meta, **audio}
    return json.loads(json.dumps(facts, sort_keys=True))


def _add_body(document: Document, animation: Animation, nodes: list[int]) -> None:
    gltf = document.gltf
    root = _rest_place(animation)
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
    colour, roughness = COLOURS[name]
    surface = pygltflib.PbrMetallicRoughness(
        baseColorFactor=[*_linear(colour), 1.0], metallicFactor=0.0, roughnessFactor=roughness
    )
    return pygltflib.Material(name=name, pbrMetallicRoughness=surface, alphaMode=None, alphaCutoff=None)


def _linear(colour: Colour) -> list[float]:
    """Convert an sRGB colour of 0 to 255 to the linear colour of glTF."""
    value = np.array(colour) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).round(4).tolist()


def _inverse_bind(animation: Animation, root: np.ndarray) -> np.ndarray:
    """Return (J, 16) inverse bind matrices of the joints, column by column as in glTF."""
    orientations, places = rest_positions(animation.armature)
    back = rotations.to_matrix(rotations.conjugate(orientations))
    matrices = np.zeros((len(places), 4, 4))
    matrices[:, :3, :3] = back
    matrices[:, :3, 3] = -np.einsum("jab,jb->ja", back, places + root)
    matrices[:, 3, 3] = 1
    return matrices.transpose(0, 2, 1).reshape(-1, 16)

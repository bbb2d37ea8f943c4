"""Reader of GLB and VRMA files of `ha2g export`: one animation of the joints of one skin, without scale."""

import dataclasses
import json
import pathlib
import struct
from typing import Any

import numpy as np

from . import checks
from .motion import Body, Motion, from_local

_MAGIC = 0x46546C67
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_MAX_BYTES, _MAX_JSON, _MAX_NODES = 1 << 28, 1 << 24, 4_000
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class _File:
    """The JSON tree of a GLB, and its arrays."""

    def __init__(self, data: bytes) -> None:
        magic, version, _, length, _ = struct.unpack_from("<5I", data)
        if magic != _MAGIC or version != 2:
            raise ValueError("no glTF 2.0 binary")
        if length > _MAX_JSON:
            raise ValueError(f"{length} bytes of JSON, expected at most {_MAX_JSON}")
        self.tree: dict[str, Any] = json.loads(data[20 : 20 + length].decode())
        self._blob = memoryview(data)[20 + length + 8 :]

    def array(self, index: int) -> np.ndarray:
        """Return an accessor, (n, width) or (n,) for scalars; raise ValueError where a number is not finite."""
        accessor = self.tree["accessors"][index]
        view = self.tree["bufferViews"][accessor["bufferView"]]
        width = _WIDTHS[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        dtype = np.dtype(_TYPES[accessor["componentType"]])
        if view.get("byteStride", width * dtype.itemsize) != width * dtype.itemsize:
            raise ValueError("interleaved arrays")
        values = np.frombuffer(self._blob, dtype, accessor["count"] * width, start)
        if not np.isfinite(values).all():
            raise ValueError("values that are not numbers")
        return values.reshape(-1, width) if width > 1 else values


def read(path: pathlib.Path) -> Motion:
    """Read the joints, the animation and, if there is one, the skinned mesh of a `.glb` or `.vrma`.

    Raises:
        ValueError and others: the file has no animation, or not one of `ha2g export`.
    """
    file = _File(checks.read_bytes(path, _MAX_BYTES))
    nodes = file.tree["nodes"]
    if len(nodes) > _MAX_NODES:
        raise ValueError(f"{len(nodes)} nodes, expected at most {_MAX_NODES}")
    if not file.tree.get("animations"):
        raise ValueError("no animation")
    clip = file.tree["animations"][0]
    above = {child: index for index, node in enumerate(nodes) for child in node.get("children", ())}
    joints = _joints(file.tree, clip, above)
    order = {node: index for index, node in enumerate(joints)}
    offsets = np.array([nodes[node].get("translation", (0, 0, 0)) for node in joints], float)
    rest = np.array([nodes[node].get("rotation", (0, 0, 0, 1)) for node in joints], float)
    time = _times(file, clip)
    checks.check_size(len(time), len(joints))
    rotated, root = np.tile(rest, (len(time), 1, 1)), np.tile(offsets[0], (len(time), 1))
    seen: set[tuple[int, str]] = set()
    for channel in clip["channels"]:
        sampler, target = clip["samplers"][channel["sampler"]], channel["target"]
        if (target["node"], target["path"]) in seen:
            raise ValueError("two channels for one joint")
        seen.add((target["node"], target["path"]))
        values = file.array(sampler["output"])
        if len(values) != len(time):
            raise ValueError("channels of different lengths")
        if target["path"] == "rotation":
            rotated[:, order[target["node"]]] = values
        elif target["path"] == "translation" and order[target["node"]] == 0:
            root = values.astype(float)
    extras = file.tree["scenes"][file.tree.get("scene", 0)].get("extras", {})
    fps = extras.get("fps") or _rate(time)
    top = above.get(joints[0])
    name = path.stem if top is None else nodes[top].get("name", path.stem)
    parents = tuple(order.get(above.get(node, -1), -1) for node in joints)
    names = tuple(nodes[node]["name"] for node in joints)
    body = _body(file, order)
    if body is not None:  # the root bone rests where it is in the first frame
        body = dataclasses.replace(body, points=body.points + (root[0] - offsets[0]))
    return from_local(name, names, parents, offsets, rest, rotated, root, float(fps), body)


def humanoid(path: pathlib.Path) -> dict[str, str]:
    """Read the names in the VRM standard of the nodes of a `.glb` or `.vrm`, by their own names.

    Returns:
        The names of VRM 1.0 or 0.x; nothing for a file without them.

    Raises:
        ValueError and others: the file is no GLB.
    """
    tree = _File(checks.read_bytes(path, _MAX_BYTES)).tree
    extensions = tree.get("extensions", {})
    bones = extensions.get("VRMC_vrm", extensions.get("VRM", {})).get("humanoid", {}).get("humanBones", {})
    rows = bones.items() if isinstance(bones, dict) else ((bone["bone"], bone) for bone in bones)
    return {tree["nodes"][bone["node"]]["name"]: name for name, bone in rows}


def frame_rate(path: pathlib.Path) -> float:
    """Measure the frames per second of a `.glb` that Blender has written, by its animation with the most times.

    Returns:
        1 if there is no animation with two times.
    """
    file = _File(path.read_bytes())
    times = [_times(file, clip) for clip in file.tree.get("animations", ())]
    return _rate(max(times, key=len, default=np.zeros(0)))


def _rate(time: np.ndarray) -> float:
    return float((len(time) - 1) / (time[-1] - time[0])) if len(time) > 1 else 1.0


def _times(file: _File, clip: dict[str, Any]) -> np.ndarray:
    """Return the times (T,) in seconds that the samplers have together."""
    inputs = [file.array(index) for index in dict.fromkeys(sampler["input"] for sampler in clip["samplers"])]
    if sum(len(values) for values in inputs) > 2 * checks.MAX_FRAMES:
        raise ValueError("too many times")
    return np.unique(np.concatenate(inputs)).astype(float)


def _joints(tree: dict[str, Any], clip: dict[str, Any], above: dict[int, int]) -> list[int]:
    """Return the nodes of the joints, each after its parent; joint 0 is the root."""
    if tree.get("skins"):
        joints = set(tree["skins"][0]["joints"])
    else:
        bones = tree.get("extensions", {}).get("VRMC_vrm_animation", {}).get("humanoid", {}).get("humanBones", {})
        joints = {bone["node"] for bone in bones.values()} | {channel["target"]["node"] for channel in clip["channels"]}

    def depth(node: int) -> int:
        steps = 0
        while node in above:
            node, steps = above[node], steps + 1
            if steps > len(above):
                raise ValueError("nodes in a circle")
        return steps

    if len(joints) > checks.MAX_JOINTS:
        raise ValueError(f"{len(joints)} joints, expected at most {checks.MAX_JOINTS}")

    return sorted(joints, key=lambda node: (depth(node), node))


def _body(file: _File, order: dict[int, int]) -> Body | None:
    """Return the skinned mesh in the bind pose, which is the rest pose, or None."""
    skinned = [node for node in file.tree["nodes"] if "mesh" in node and "skin" in node]
    if not skinned:
        return None
    joints = np.array([order[node] for node in file.tree["skins"][skinned[0]["skin"]]["joints"]])
    primitives = file.tree["meshes"][skinned[0]["mesh"]]["primitives"]
    if len(primitives) > checks.MAX_MATERIALS:
        raise ValueError(f"a mesh of {len(primitives)} parts, expected at most {checks.MAX_MATERIALS}")
    points, faces, carriers, weights, materials, colours = [], [], [], [], [], []
    for index, primitive in enumerate(primitives):
        arrays = {name: file.array(primitive["attributes"][name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")}
        corners = file.array(primitive["indices"]).reshape(-1, 3)
        if len(arrays["POSITION"]) > checks.MAX_POINTS or len(corners) > checks.MAX_FACES:
            raise ValueError("a mesh of too many points or faces")
        corners = corners.astype(int)
        if corners.size and not (corners.min() >= 0 and corners.max() < len(arrays["POSITION"])):
            raise ValueError("a mesh with an index out of range")
        faces.append(corners + sum(len(part) for part in points))
        points.append(arrays["POSITION"])
        carriers.append(joints[arrays["JOINTS_0"]])
        weights.append(arrays["WEIGHTS_0"])
        materials.append(np.full(len(corners), index))
        colours.append(_colour(file.tree, primitive))
    return Body(
        points=np.concatenate(points),
        faces=np.concatenate(faces),
        joints=np.concatenate(carriers),
        weights=np.concatenate(weights),
        materials=np.concatenate(materials),
        colours=tuple(colours),
    )


def _colour(tree: dict[str, Any], primitive: dict[str, Any]) -> tuple[str, tuple[float, ...], float]:
    material = tree["materials"][primitive["material"]] if "material" in primitive else {}
    surface = material.get("pbrMetallicRoughness", {})
    colour = tuple(surface.get("baseColorFactor", (0.8, 0.8, 0.8, 1.0)))
    return checks.shown(material.get("name", "body"))[:60], colour, surface.get("roughnessFactor", 1.0)

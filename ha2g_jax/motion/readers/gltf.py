"""Reader of the animation of a glTF 2.0 file in one part, `.glb`, `.vrma` or `.vrm`, of any program."""

import pathlib
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import naming, parse_json, read_bytes, reading, shown
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Armature
from ha2g_jax.motion.readers.bvh import Bvh
from ha2g_jax.motion.readers.trees import as_rotations, frame_rate, to_bvh

_MAGIC = b"glTF"
_EXPECTED = "an animation in glTF 2.0 (.glb)"
_OWN = "ha2g-jax"  # the generator of our files, which say their frame rate
_FPS = 30.0  # of an animation whose keys are farther apart than the frames of a motion
_MIN_FPS, _MAX_FPS = 10.0, 240.0  # at which keys are taken for frames
_ROUNDED = 0.0021  # seconds by which steps between times in milliseconds differ
_LATE = 1e-4  # seconds by which rounding may make a time too late
_ROOT = "(scene)"  # the joint above all others, as there may be several roots
_UNEQUAL = 0.01  # relative difference of scales that rounding explains
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_BONES = ("VRMC_vrm_animation", "VRMC_vrm")  # extensions that name the bones of a person, whatever the nodes' names


def read_gltf(path: pathlib.Path, fps: float | None) -> Bvh:
    """Read the only animation of a file as a tree of joints, sampled at its frame rate from the time 0 on.

    The joints are those of the skins, or without a skin all nodes, with the nodes above them; bones of VRM have their
    names. Interpolation may be LINEAR, STEP or CUBICSPLINE, and joints may have sizes that stay as they are.

    Args:
        fps: frames per second of the result, whose frames stay the same; None takes those of the file.

    Raises:
        UserError: the file is not glTF, is compressed or damaged, or has no animation of joints or several.
    """
    content = read_bytes(path, _EXPECTED, limits.MAX_MOTION_BYTES)
    with reading(path, _EXPECTED, LookupError, TypeError, AttributeError), np.errstate(all="ignore"):
        bvh = _File(path, content).read()
    return bvh if fps is None else bvh._replace(fps=fps)


class _File:
    """The parts of one file."""

    def __init__(self, path: pathlib.Path, content: bytes) -> None:
        magic, version, size, kind = struct.unpack_from("<4sI4xI4s", content)
        if (magic, version, kind) != (_MAGIC, 2, b"JSON") or len(content) < 20 + size:
            raise ValueError("its head is none of glTF 2.0, or it is cut off")
        if size > limits.MAX_MOTION_JSON_BYTES:
            raise ValueError(f"{size} bytes of JSON, expected at most {limits.MAX_MOTION_JSON_BYTES}")
        self.num_values = 0
        self.path, self.tree = path, parse_json(content[20 : 20 + size])
        self.blob = memoryview(content)[28 + size :]
        self.nodes: list[dict[str, Any]] = self.tree["nodes"]
        self.bones: dict[int, str] = {}
        for extension in _BONES:
            found = self.tree.get("extensions", {}).get(extension, {}).get("humanoid", {}).get("humanBones", {})
            self.bones |= {bone["node"]: name for name, bone in found.items()}

    def read(self) -> Bvh:
        parents, joints = self._joints()
        tracks = self._tracks(set(joints))
        times, fps = self._times([times for times, _, _ in tracks.values()])
        if len(times) * (1 + len(joints)) > limits.MAX_BVH_VALUES // 4:
            raise ValueError(f"{len(times)} frames of {len(joints)} joints; cut the file")
        number = {node: index for index, node in enumerate(joints, start=1)}
        above = (-1, *(number.get(parents.get(node, -1), 0) for node in joints))
        local = np.tile(rotations.IDENTITY, (len(times), 1 + len(joints), 1))
        rest, offsets, size = local[0].copy(), np.zeros((1 + len(joints), 3)), np.ones(1 + len(joints))
        places = {}
        for index, node in enumerate(joints, start=1):
            move, rest[index], scale = _transform(self.nodes[node])
            if (node, "scale") in tracks:
                scale = _values(tracks[node, "scale"][1])
            least, most = scale.min(), scale.max()
            if index in above and not 0 < most - _UNEQUAL * abs(most) <= least:
                raise ValueError(f"the scale of {self._name(node)} is not the same in all directions and at all times")
            offsets[index] = size[above[index]] * move
            size[index] = size[above[index]] * most
            if (node, "translation") in tracks:
                places[index] = size[above[index]] * _sample(*tracks[node, "translation"], times)
            local[:, index] = rest[index]
            if (node, "rotation") in tracks:
                local[:, index] = _sample(*tracks[node, "rotation"], times)
        names = (_ROOT, *map(self._name, joints))
        if twice := [name for index, name in enumerate(names) if name in names[:index]]:
            raise UserError(f"{shown(self.path)} has two joints named {shown(twice[0])}; keep one person in the file")
        with naming(self.path):
            armature = Armature("", names, above, offsets, as_rotations(rest))
            return to_bvh(armature, local, {0: np.zeros((len(times), 3))} | places, fps)

    def _joints(self) -> tuple[dict[int, int], list[int]]:
        """Return the parents of nodes, and the joints and the nodes above them, each after its parent."""
        parents = {child: index for index, node in enumerate(self.nodes) for child in node.get("children", ())}
        order = [node for node in range(len(self.nodes)) if node not in parents]
        for node in order:  # grows; nodes in a circle are not reached
            children = dict.fromkeys(self.nodes[node].get("children", ()))
            order += [child for child in children if parents[child] == node]
        wanted = {joint for skin in self.tree.get("skins", ()) for joint in skin["joints"]} | {*self.bones}
        for node in reversed(order if wanted else ()):
            wanted |= {parents[node]} if node in wanted and node in parents else set()
        joints = [node for node in order if node in wanted] if wanted else order
        if len(joints) >= limits.MAX_MOTION_JOINTS:
            raise ValueError(f"{len(joints)} joints, expected at most {limits.MAX_MOTION_JOINTS}")
        return parents, joints

    def _name(self, node: int) -> str:
        return self.bones.get(node) or str(self.nodes[node].get("name") or f"node {node}")[: limits.MAX_JOINT_NAME]

    def _tracks(self, joints: set[int]) -> dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]]:
        """Return key times, values and interpolation by node and path of the only animation that rotates joints."""
        found = []
        for number, animation in enumerate(self.tree.get("animations", ())):
            tracks = {key: track for key, track in self._channels(animation) if key[0] in joints}
            if any(path == "rotation" for _, path in tracks):
                found.append((str(animation.get("name") or number), tracks))
        moving = [(name, each) for name, each in found if any(len(times) > 1 for times, _, _ in each.values())]
        chosen = moving or found
        if not chosen:
            raise UserError(f"{shown(self.path)} has no animation of joints; export it with its animation")
        if len(chosen) > 1:
            names = shown(", ".join(name for name, _ in chosen))
            raise UserError(f"{shown(self.path)} has {len(chosen)} animations ({names}); export the one that you want")
        return chosen[0][1]

    def _channels(
        self, animation: dict[str, Any]
    ) -> Iterator[tuple[tuple[int, str], tuple[np.ndarray, np.ndarray, str]]]:
        for channel in animation["channels"]:
            target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
            if target["path"] not in ("translation", "rotation", "scale"):
                continue
            times, values = self._array(sampler["input"])[:, 0], self._array(sampler["output"])
            kind = sampler.get("interpolation", "LINEAR")
            keys = values.reshape(len(times), 3 if kind == "CUBICSPLINE" else 1, -1)
            if keys.shape[2] != (4 if target["path"] == "rotation" else 3) or not np.isfinite(keys).all():
                raise ValueError("keys that are no rotations or places")
            if not (np.diff(times) > 0).all() or not 0 <= times[0] <= times[-1] <= limits.MAX_MOTION_SECONDS:
                raise ValueError("key times that do not increase, or are out of range")
            yield (target.get("node", -1), target["path"]), (times, keys, kind)

    def _array(self, index: int) -> np.ndarray:
        """Return the numbers of an accessor, (n, width); whole numbers stand for fractions."""
        accessor = self.tree["accessors"][index]
        view = self.tree["bufferViews"][accessor["bufferView"]]
        if "sparse" in accessor or "extensions" in view or "uri" in self.tree["buffers"][view["buffer"]]:
            raise ValueError("an animation that is compressed or in another file; export it as one plain .glb")
        kind, width = np.dtype(_COMPONENTS[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        self.num_values += accessor["count"] * width
        if self.num_values > limits.MAX_BVH_VALUES:
            raise ValueError(f"more than {limits.MAX_BVH_VALUES:,} numbers in its animations; cut the file")
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(self.blob, kind, accessor["count"] * width, start).reshape(-1, width)
        return values.astype(float) if kind.kind == "f" else np.maximum(values / np.iinfo(kind).max, -1)

    def _times(self, keys: list[np.ndarray]) -> tuple[np.ndarray, float]:
        """Return the times (T,) of the frames and their rate: that of the keys, where they are as dense as frames."""
        scenes = self.tree.get("scenes") or [{}]  # a file may have none
        extras = scenes[self.tree.get("scene", 0)].get("extras") or {}
        every = np.unique(np.concatenate(keys))
        steps = np.diff(every)
        steps = steps[steps > _LATE]
        if self.tree["asset"].get("generator") == _OWN and "fps" in extras:
            fps = float(extras["fps"])
        else:
            span, step = every[-1] - every[0], np.median(steps) if len(steps) else 1 / _FPS
            # If all steps are equal, there is a key in each frame; rounding of times is ignored.
            count = len(steps) if len(steps) and np.ptp(steps) < _ROUNDED else max(round(span / step), 1)
            fps = frame_rate(np.linspace(0, span, 1 + count)) if span else _FPS
            fps = fps if _MIN_FPS <= fps <= _MAX_FPS else _FPS
        if not limits.MIN_MOTION_FPS <= fps <= limits.MAX_MOTION_FPS:
            raise ValueError(f"{fps:g} frames per second")
        return np.arange(1 + round(every[-1] * fps)) / fps, fps


def _transform(node: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return translation (3,), rotation (4,) and scale (3,) of a node at rest."""
    if "matrix" not in node:
        parts = (node.get("translation", [0, 0, 0]), node.get("rotation", [0, 0, 0, 1]), node.get("scale", [1, 1, 1]))
        move, turn, scale = (np.array(part, float) for part in parts)
        return move.reshape(3), turn.reshape(4), scale.reshape(3)
    matrix = np.array(node["matrix"], float).reshape(4, 4).T
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    return matrix[:3, 3], rotations.from_matrix(matrix[:3, :3] / np.maximum(scale, 1e-12)), scale


def _values(keys: np.ndarray) -> np.ndarray:
    """Return the values (n, width) of keys without the tangents that CUBICSPLINE has around them."""
    return keys[:, keys.shape[1] // 2]


def _sample(times: np.ndarray, keys: np.ndarray, kind: str, moments: np.ndarray) -> np.ndarray:
    """Return the values (T, width) of a track at moments in seconds; the first and the last key are held."""
    values = _values(keys)
    before = np.maximum(np.searchsorted(times, moments + _LATE, side="right") - 1, 0)
    after = np.minimum(before + 1, len(times) - 1)
    span = (times[after] - times[before])[:, None]
    fraction = np.clip((moments - times[before])[:, None] / np.where(span > 0, span, 1), 0, 1)
    first, second = values[before], values[after]
    is_turn = values.shape[1] == 4
    if is_turn:
        as_rotations(values)
    if kind == "STEP":
        return first
    if kind == "CUBICSPLINE":
        # Hermite's cubic, with the tangents after one key and before the next.
        out, arriving = span * keys[before, 2], span * keys[after, 0]
        bend = fraction * (1 - fraction)
        eased = fraction**2 * (3 - 2 * fraction)
        curve = first + eased * (second - first) + bend * ((1 - fraction) * out - fraction * arriving)
        return rotations.unit(curve) if is_turn else curve
    return rotations.slerp(first, second, fraction[:, 0]) if is_turn else first + fraction * (second - first)

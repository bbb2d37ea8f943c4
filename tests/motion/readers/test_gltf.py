"""Animations of glTF as other programs write them are those of our own files, or are refused in one line."""

import json
import struct

import numpy as np
import pytest
from fixtures.glb_reader import GlbReader, join_glb
from fixtures.motions import swaying
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.motion import formats
from ha2g_jax.motion.readers import read_motion

FRAMES, FPS = 12, 15


class File(GlbReader):
    """A file of ours whose parts are changed."""

    @property
    def clip(self) -> dict:
        return self.tree["animations"][0]

    def add(self, values: np.ndarray, kind: int = 5126) -> int:
        data = values.tobytes()
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)})
        self.blob += data + bytes(-len(data) % 4)
        width = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.reshape(len(values), -1).shape[1]]
        view = len(self.tree["bufferViews"]) - 1
        self.tree["accessors"].append({"bufferView": view, "componentType": kind, "count": len(values), "type": width})
        return len(self.tree["accessors"]) - 1

    def change(self, kind: str, make) -> None:
        """Replace the times and values of every track."""
        for sampler in self.clip["samplers"]:
            times, values = (self.array(sampler[part]) for part in ("input", "output"))
            times, values, *component = make(times[:, 0], values)
            sampler["input"], sampler["output"] = self.add(times.astype("<f4")), self.add(values, *component)
            sampler["interpolation"] = kind


def spline(times, values):
    """Keys at every other frame with the tangents of a curve through all, as an exporter fits them."""
    flat = np.zeros_like(values)
    return times, np.stack([flat, values, flat], axis=1).reshape(-1, values.shape[1]).astype("<f4")


def late(file: File) -> None:
    """Tracks with times of their own, between which nothing happens but on the great circle."""
    number = iter(range(1000))

    def more(times, values):
        middle = times[:-1] + (0.3 if next(number) % 2 else 0.5) / FPS
        both = np.concatenate([times, middle])
        order = np.argsort(both)
        turns = Rotation.from_quat(values)
        weight = (middle - times[:-1])[:, None] * FPS
        between = turns[:-1] * Rotation.from_rotvec(weight * (turns[:-1].inv() * turns[1:]).as_rotvec())
        return both[order], np.concatenate([values, between.as_quat()])[order].astype("<f4")

    file.change("LINEAR", more)


def with_scales(file: File) -> None:
    """Tracks of a size that stays 1, as curves with tangents."""
    times = file.array(file.clip["samplers"][0]["input"])[[0, -1]]
    keys = np.tile(np.array([[0, 0, 0], [1, 1, 1], [0, 0, 0]], "<f4"), (2, 1))
    sampler = {"input": file.add(times), "output": file.add(keys), "interpolation": "CUBICSPLINE"}
    file.clip["samplers"].append(sampler)
    target = {"node": file.clip["channels"][1]["target"]["node"], "path": "scale"}
    file.clip["channels"].append({"sampler": len(file.clip["samplers"]) - 1, "target": target})


def matrices(file: File) -> None:
    animated = {channel["target"]["node"] for channel in file.clip["channels"]}
    for index, node in enumerate(file.tree["nodes"]):
        if index not in animated and "translation" in node:
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_quat(node.pop("rotation")).as_matrix()
            matrix[:3, 3] = node.pop("translation")
            node["matrix"] = matrix.T.ravel().tolist()


def scaled(file: File) -> None:
    """An armature of centimetres under a node of a hundredth, as exporters of FBX leave it."""
    for node in file.tree["nodes"][1:]:
        node["translation"] = [100 * part for part in node.get("translation", [0, 0, 0])]
    file.tree["nodes"][0] |= {"scale": [0.01] * 3, "rotation": [0.5, 0.5, 0.5, 0.5]}


def beside(file: File) -> None:
    """A pose of one key and an animation of another thing beside the motion."""
    first = {"input": file.add(np.zeros(1, "<f4")), "output": file.add(np.array([[0, 0, 0, 1]], "<f4"))}
    channel = {"sampler": 0, "target": {"node": 3, "path": "rotation"}}
    file.tree["nodes"].append({"name": "cube"})
    file.tree["scenes"][0]["nodes"].append(len(file.tree["nodes"]) - 1)
    other = [{"sampler": 0, "target": {"node": len(file.tree["nodes"]) - 1, "path": "rotation"}}]
    file.tree["animations"] += [
        {"name": "T-pose", "samplers": [first], "channels": [channel]},
        {"name": "cube", "samplers": file.clip["samplers"][:1], "channels": other},
    ]


def named(file: File) -> None:
    """Nodes with names of their own, whose bones VRM names."""
    bones = {node["name"]: {"node": index} for index, node in enumerate(file.tree["nodes"]) if index}
    file.tree["extensions"] = {"VRMC_vrm_animation": {"humanoid": {"humanBones": bones}}}
    for index, node in enumerate(file.tree["nodes"]):
        node["name"] = f"J_Bip_{index}"


def numbered(file: File) -> None:
    """Nodes with a number behind their names, as from Sketchfab."""
    for index, node in enumerate(file.tree["nodes"]):
        node["name"] += f"_{index:03}"


VARIANTS = {
    "numbers": numbered,
    "a node named scene": lambda file: file.tree["nodes"][0].update(name="scene"),
    "of another program": lambda file: file.tree["scenes"][0].pop("extras"),
    "no scenes": lambda file: file.tree.pop("scenes") and file.tree.pop("scene", None),
    "no values of extras": lambda file: file.tree["scenes"][0].update(extras=None),
    "steps": lambda file: file.change("STEP", lambda times, values: (times, values)),
    "splines": lambda file: file.change("CUBICSPLINE", spline),
    "shorts": lambda file: file.change("LINEAR", lambda t, v: (t, np.round(v * 32767).astype("<i2"), 5122)),
    "matrices": matrices,
    "scales": with_scales,
    "scaled": scaled,
    "other animations": beside,
    "names of VRM": named,
    "two parts of a skin": lambda file: file.tree["skins"].append(file.tree["skins"][0]),
    "one key": lambda file: [
        sampler.update(input=file.add(np.zeros(1, "<f4")), output=file.add(file.array(sampler["output"])[:1]))
        for sampler in file.clip["samplers"]
    ],
}


@pytest.fixture
def own(tmp_path):
    formats.export(swaying(frames=FRAMES, size=0.2), tmp_path / "own.glb", rig="vrm")
    return tmp_path / "own.glb"


@pytest.mark.parametrize("variant", VARIANTS)
def test_variants_of_other_programs_are_the_same_motion(variant, own, tmp_path):
    file, expected = File(own), read_motion(own)
    file.tree["asset"]["generator"] = "another program"
    VARIANTS[variant](file)
    (tmp_path / "x.glb").write_bytes(join_glb(file.tree, file.blob))
    found = read_motion(tmp_path / "x.glb")
    frames = 1 if variant == "one key" else FRAMES
    assert found.num_frames == frames and (found.fps == FPS or variant == "one key")
    if variant == "scaled":  # turned, so that where it faces is found by the motion
        inner = [np.einsum("tax,tbx->tab", it.directions, it.directions) for it in (found, expected)]
        arms = slice(3, found.skeleton.bone("nose"))
        np.testing.assert_allclose(inner[0][:, arms, arms], inner[1][:, arms, arms], atol=1e-3)
        return
    np.testing.assert_allclose(found.positions, expected.positions[:frames], atol=1e-3)


def test_keys_between_frames_are_sampled_at_the_rate_of_the_keys(own, tmp_path):
    file = File(own)
    late(file)
    (tmp_path / "x.glb").write_bytes(join_glb(file.tree, file.blob))
    np.testing.assert_allclose(read_motion(tmp_path / "x.glb").positions, read_motion(own).positions, atol=1e-3)


@pytest.mark.parametrize("fps", [24, 60])
def test_times_in_milliseconds_are_those_of_frames(fps, tmp_path):
    own = swaying(frames=184, fps=fps)
    formats.export(own, tmp_path / "x.glb", rig="vrm")
    file = File(tmp_path / "x.glb")
    file.tree["asset"]["generator"] = "another program"
    file.change("LINEAR", lambda times, values: (np.round(times, 3), values))
    (tmp_path / "x.glb").write_bytes(join_glb(file.tree, file.blob))
    found = read_motion(tmp_path / "x.glb")
    assert (found.fps, found.num_frames) == (fps, 184)


def compressed(file: File) -> None:
    view = file.tree["accessors"][file.clip["samplers"][0]["output"]]["bufferView"]
    file.tree["bufferViews"][view]["extensions"] = {"EXT_meshopt_compression": {}}


REFUSED = {
    "no animation": (lambda file: file.tree.pop("animations"), r"x\.glb has no animation of joints; export it with"),
    "two animations": (
        lambda file: file.tree["animations"].extend([file.clip, file.clip | {"name": "walk"}]),
        r"x\.glb has 3 animations \(motion, motion, walk\); export the one that you want",
    ),
    "two people": (lambda file: file.tree["nodes"][5].update(name="hips"), "two joints named hips; keep one person"),
    "no times": (lambda file: file.change("LINEAR", lambda t, v: (t * 0, v)), "key times that do not increase"),
    "no turns": (lambda file: file.change("LINEAR", lambda t, v: (t, v * 9)), "values that are no rotations"),
    "squeezed": (lambda file: file.tree["nodes"][1].update(scale=[1, 2, 1]), "the scale of hips is not the same"),
    "compressed": (compressed, "compressed or in another file; export it as one plain .glb"),
    "two people of any name": (
        lambda file: [file.tree["nodes"][index].update(name="hips\n\x1b[31m") for index in (1, 5)],
        "two joints named",
    ),
    "a circle": (lambda file: file.tree["nodes"][9].update(children=[1]), "x.glb"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_motion_is_refused_in_one_line(case, own, tmp_path):
    change, message = REFUSED[case]
    file = File(own)
    change(file)
    (tmp_path / "x.glb").write_bytes(join_glb(file.tree, file.blob))
    with pytest.raises(UserError, match=message) as caught:
        read_motion(tmp_path / "x.glb")
    assert "\n" not in str(caught.value)


def test_gltf_as_text_is_refused(own, tmp_path):
    (tmp_path / "x.gltf").write_text(json.dumps(File(own).tree))
    with pytest.raises(UserError, match=r"x\.gltf is glTF as text \(\.gltf\); export it as \.glb"):
        read_motion(tmp_path / "x.gltf")


@pytest.mark.parametrize("content", [b"glTF", b"glTF" + struct.pack("<2I", 1, 20) + bytes(60), b"no glTF" * 9])
def test_a_file_that_is_none_is_refused(content, tmp_path):
    (tmp_path / "x.vrma").write_bytes(content)
    with pytest.raises(UserError, match=r"x\.vrma is not an animation in glTF 2\.0"):
        read_motion(tmp_path / "x.vrma")

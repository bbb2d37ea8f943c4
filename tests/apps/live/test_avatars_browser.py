"""The recipe examples/agents/avatar.js in a real Chromium: avatars of three-vrm and TalkingHead follow `ha2g live`.

It needs node, chromium and modules of `make test-web` in NODE_PATH, and is skipped without them. Its pictures stay
in the test's temporary folder.
"""

import concurrent.futures
import contextlib
import json
import pathlib
import struct

import pytest
from fixtures.browser import drive

from ha2g_jax.apps.live.clock import StopFlag
from ha2g_jax.apps.live.run import run
from ha2g_jax.apps.live.sinks import open_sinks
from ha2g_jax.apps.live.sources import open_source
from ha2g_jax.errors import UserError
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.motion import Motion

# Blend shapes that an avatar of TalkingHead must have.
SHAPES = [name + side for name in ("eyeBlink", "browDown", "eyeLookIn", "eyeLookOut") for side in ("Left", "Right")]
NEEDS = ("esbuild", "three", "@pixiv/three-vrm", "@met4citizen/talkinghead")


def write_avatar(path, rig, skeleton, change):
    """Write the figure of the package as an avatar; `change` makes one of the JSON of its `.glb`."""
    glb = path.with_name(f"{rig}.glb")
    export(Motion.from_directions(skeleton, skeleton.mean_directions[None], 15), glb, rig=rig)
    data = glb.read_bytes()
    end = 20 + struct.unpack_from("<I", data, 12)[0]
    content = json.loads(data[20:end])
    del content["animations"]
    change(content)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + data[end:]
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


def to_vrm(content):
    bones = {node["name"]: {"node": number} for number, node in enumerate(content["nodes"])}
    del bones["vrm"], bones["body"]
    meta = {"name": "figure", "authors": ["ha2g-jax"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    content["extensionsUsed"] = [*content.get("extensionsUsed", []), "VRMC_vrm"]
    avatar = {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones}}
    content["extensions"] = content.get("extensions", {}) | {"VRMC_vrm": avatar}


def to_talkinghead(content):
    for node in content["nodes"]:
        node["name"] = node["name"].replace("mixamorig:", "").replace("mixamo", "Armature")
    (head,) = (node for node in content["nodes"] if node["name"] == "Head")
    content["nodes"][0]["children"].append(content["scenes"][0]["nodes"].pop())  # the body
    head["children"] += [len(content["nodes"]), len(content["nodes"]) + 1]
    content["nodes"] += [{"name": "LeftEye", "mesh": len(content["meshes"])}, {"name": "RightEye"}]
    points = {"POSITION": len(content["accessors"])}  # in one place; without a face, blend shapes have nothing to do
    content["accessors"].append({"componentType": 5126, "count": 3, "type": "VEC3", "min": [0] * 3, "max": [0] * 3})
    shapes = {"primitives": [{"attributes": points, "targets": [points] * len(SHAPES)}], "weights": [0] * len(SHAPES)}
    content["meshes"].append(shapes | {"extras": {"targetNames": SHAPES}})


@pytest.mark.parametrize(
    ("name", "rig", "change"), [("avatar.vrm", "vrm", to_vrm), ("avatar.glb", "mixamo", to_talkinghead)]
)
def test_an_avatar_does_what_the_agent_is_told(debug_model, tmp_path, free_port, name, rig, change):
    write_avatar(tmp_path / name, rig, debug_model.assets.skeleton, change)
    source, sink = (f"ws://127.0.0.1:{free_port()}" for _ in range(2))
    stop = StopFlag()

    def look():
        try:
            script = pathlib.Path(__file__).with_name("drive_avatars.cjs")
            return drive(script, tmp_path / name, source, sink, needs=NEEDS)
        finally:
            stop.ask()

    with contextlib.ExitStack() as stack, concurrent.futures.ThreadPoolExecutor(1) as thread:
        sinks = open_sinks([sink], stack, rig)
        looking = thread.submit(look)
        with contextlib.suppress(UserError):  # no sound, where the page could not be opened
            run(debug_model, open_source(source), sinks, stop=stop)
        assert looking.result() == []

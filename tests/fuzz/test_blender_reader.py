"""The add-on for Blender reads any file, or says in one line why not, by its own exception."""

import importlib
import json
import pathlib
import struct
import sys
import types
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from fixtures.glb_reader import join_glb, split_glb
from fixtures.motions import swaying
from fuzz.conftest import within_limits
from fuzz.mutation import FUZZ, damaged_file, damaged_tree
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.motion.formats import export

ADDON = pathlib.Path(__file__).parent.parent.parent / "integrations" / "blender"


@pytest.fixture(scope="module")
def addon() -> Iterator[types.SimpleNamespace]:
    """The modules of the add-on that need no Blender."""
    sys.path.insert(0, str(ADDON))
    try:
        names = ("bone_names", "fitting", "motion", "reading")
        yield types.SimpleNamespace(**{name: importlib.import_module(f"ha2g_motion.{name}") for name in names})
    finally:
        sys.path.remove(str(ADDON))


@pytest.fixture(scope="module")
def contents(tmp_path_factory) -> dict[str, bytes]:
    """Files of every format of a short motion, by suffix."""
    folder = tmp_path_factory.mktemp("exported")
    motion = swaying("ted_gesture", 4)
    for suffix in (".glb", ".vrma", ".bvh", ".json"):
        export(motion, folder / f"m{suffix}")
    return {path.suffix: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def answers(addon, contents, tmp_path) -> Callable[[str, bytes], None]:
    """A function that reads content, and if it is a motion, moves the bones of an armature by it."""
    (tmp_path / "good.json").write_bytes(contents[".json"])
    good = addon.reading.read_motion(tmp_path / "good.json")
    rest = np.tile([0.0, 0.0, 0.0, 1.0], (len(good.joints), 1))
    target = addon.fitting.Target(good.joints, good.parents, good.places, rest, (True,) * len(good.joints))

    def answers(suffix: str, content: bytes) -> None:
        path = tmp_path / f"m{suffix}"
        path.write_bytes(content)
        with within_limits():
            try:
                motion = addon.reading.read_motion(path)
                addon.fitting.fit(motion, target, addon.bone_names.match(motion, target.bones))
            except addon.motion.MotionError as error:
                assert str(error).isprintable() and len(str(error)) < 1_000

    return answers


@FUZZ
@given(data=st.data(), suffix=st.sampled_from((".glb", ".vrma", ".bvh", ".json")))
def test_a_damaged_file_is_answered(data, suffix, answers, contents):
    answers(suffix, data.draw(damaged_file(f"m{suffix}", contents[suffix])))


@FUZZ
@given(data=st.data())
def test_a_damaged_table_of_names_is_answered(data, addon, tmp_path):
    names = {"arm.L": "left_shoulder", "arm.R": ["right_shoulder", 0.5], "hand.L": "left_wrist"}
    (tmp_path / "names.json").write_text(json.dumps(data.draw(damaged_tree(names))))
    try:
        addon.bone_names.read_names(tmp_path / "names.json")
    except addon.motion.MotionError as error:
        assert str(error).isprintable() and len(str(error)) < 1_000


def bombs(contents: dict[str, bytes]) -> dict[str, tuple[str, bytes, str]]:
    """Files that once took minutes or all memory, and what is said of them."""
    tree, blob = split_glb(contents[".glb"])
    circle = tree | {"nodes": [node | {"children": [index]} for index, node in enumerate(tree["nodes"])]}
    chain = [{"name": f"n{index}", "children": [index + 1]} for index in range(100_000)]
    no_columns = b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\nMOTION\nFrames: 999999999\nFrame Time: 0.1\n"
    deep = b'{"a":' * 200_000 + b"1" + b"}" * 200_000
    return {
        "a circle of nodes": (".glb", join_glb(circle, blob), "in a circle"),
        "a chain of nodes": (".glb", join_glb(tree | {"nodes": chain}, blob), "100000 nodes"),
        "deep": (".json", deep, "nested too deep"),
        "deep in a glb": (".glb", contents[".glb"][:12] + struct.pack("<2I", len(deep), 0) + deep, "nested too deep"),
        "lists": (".json", b"[" + b"[]," * 9_000_000 + b"[]]", "objects and lists"),
        "frames without numbers": (".bvh", no_columns, "999999999 frames"),
    }


def test_a_file_that_unfolds_is_refused_in_one_line(addon, contents, tmp_path):
    for name, (suffix, content, what) in bombs(contents).items():
        (tmp_path / f"m{suffix}").write_bytes(content)
        with within_limits(), pytest.raises(addon.motion.MotionError) as raised:
            addon.reading.read_motion(tmp_path / f"m{suffix}")
        assert what in str(raised.value), name
        assert str(raised.value).isprintable(), name


def test_any_name_of_a_file_is_answered(addon, contents, tmp_path):
    odd = tmp_path / "\udcff\n.json"
    odd.write_bytes(contents[".json"])
    assert addon.reading.read_motion(odd).num_frames == 4
    for name in ("\udcff\n.glb", "a" * 300 + ".glb", "\udcff.fbx"):
        with pytest.raises(addon.motion.MotionError) as raised:
            addon.reading.read_motion(tmp_path / name)
        assert str(raised.value).isprintable()

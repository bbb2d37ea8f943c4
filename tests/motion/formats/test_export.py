"""One function writes every format; what cannot be written is an error of one line and leaves no file."""

import functools
import json
import pathlib
import re
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.glb_reader import GlbReader
from fixtures.motions import swaying

from ha2g_jax.errors import UserError
from ha2g_jax.motion import formats, rigs
from ha2g_jax.motion.formats import keyframes
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion

DOCS = pathlib.Path(__file__).parents[3] / "docs" / "export.md"


def make(name: str = "ted_expressive") -> Motion:
    return swaying(name, 9, size=0.2, speech="a.wav", duration=0.61)


WRITERS = {
    **dict.fromkeys(formats.SUFFIXES, formats.export),
    **dict.fromkeys([".png", ".svg"], functools.partial(keyframes.write, size=64)),
    ".mp4": functools.partial(write_video, audio=None, size=64, has_progress=False),
}


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format_is_written_with_the_same_bytes_twice(tmp_path, name, suffix):
    for stem in ("a", "b"):
        WRITERS[suffix](path=tmp_path / f"{stem}{suffix}", motion=make(name))
    first = (tmp_path / f"a{suffix}").read_bytes()
    assert len(first) > 1000
    assert first == (tmp_path / f"b{suffix}").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_the_length_of_the_speech_is_noted(tmp_path):
    formats.export(make(), tmp_path / "a.glb")
    first = GlbReader(tmp_path / "a.glb").tree["scenes"][0]["extras"]
    assert (first["audio"], first["audio_seconds"]) == ("a.wav", 0.61)
    assert (first["fps"], first["frames"], first["meta"]["duration"]) == (15.0, 9, 0.61)


@pytest.mark.parametrize(
    ("name", "rig", "message"),
    [
        ("m.obj", "ha2g", r"\.obj; expected one of \.bvh"),
        ("m.bvh", "poser", "no rig poser"),
        ("m.vrma", "mixamo", "takes the rig vrm, not mixamo"),
    ],
)
def test_what_cannot_be_written_is_named(tmp_path, name, rig, message):
    with pytest.raises(UserError, match=message) as error:
        formats.export(make(), tmp_path / name, rig=rig)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def add_rig(tmp_path_factory, monkeypatch):
    """A function that adds the rig of docs/export.md, after a change of its table, as its file would."""
    folder = tmp_path_factory.mktemp("rigs")
    monkeypatch.setattr(rigs, "_TABLES", folder)
    monkeypatch.setattr(rigs, "RIGS", (*rigs.RIGS, "robot"))

    def add(change: Callable[[dict], None] = lambda table: None) -> None:
        (text,) = re.findall(r"```json\n(\{.*?\n\})\n```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
        table = json.loads(text)
        change(table)
        (folder / "robot.json").write_text(json.dumps(table))

    yield add
    rigs.load_rig.cache_clear()


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".json", ".csv"])
def test_the_rig_of_the_docs_is_a_file_and_no_code(tmp_path, add_rig, suffix):
    add_rig()
    formats.export(make(), tmp_path / f"m{suffix}", rig="robot")
    assert b"LeftForearm" in (tmp_path / f"m{suffix}").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda table: table["joints"][1].update(carries="spin"),
            "Chest carries or has the place of spin, which is no joint of ha2g",
        ),
        (lambda table: table["joints"][1].update(parent="Bse"), "Bse"),
        (lambda table: table["joints"][2].pop("offset"), "offset"),
        (lambda table: table.update(name="robot2"), "its name is robot2"),
    ],
)
def test_a_mistake_in_a_rig_is_one_line(tmp_path, add_rig, change, message):
    add_rig(change)
    with pytest.raises(UserError, match=f"the rig robot cannot be read .*{message}"):
        formats.export(swaying(), tmp_path / "m.bvh", rig="robot")


def test_a_rig_without_the_joints_of_a_body_has_no_glb(tmp_path, add_rig):
    def without_hand(table: dict) -> None:
        table["joints"] = [joint for joint in table["joints"] if joint["name"] != "LeftHand"]

    add_rig(without_hand)
    with pytest.raises(UserError, match=r"robot has no joint with place 'left_wrist', carries 'left_wrist'.*\.bvh"):
        formats.export(make(), tmp_path / "m.glb", rig="robot")
    formats.export(make(), tmp_path / "m.bvh", rig="robot")


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_motion_that_is_none_leaves_no_file(tmp_path, suffix):
    motion = make()
    motion.directions[3, 5] = np.nan
    with pytest.raises(UserError):
        WRITERS[suffix](path=tmp_path / f"m{suffix}", motion=motion)
    assert not list(tmp_path.iterdir())

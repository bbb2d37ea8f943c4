"""Key frames show what happens, at the same moments in every row, and as a figure that can be printed."""

import dataclasses
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.motion.formats import keyframes
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

STROKES = (0.9, 3.1, 5.2, 6.8)  # seconds, one in each quarter of the motion
SVG = "{http://www.w3.org/2000/svg}"


def gesturing(fps: float = 15, seconds: float = 8, name: str = "ted_expressive") -> Motion:
    """The right forearm rises and falls at each stroke, half a second each way; else nothing moves."""
    skeleton = load_skeleton(name)
    time = np.arange(round(fps * seconds)) / fps
    lift = sum(np.cos(np.clip((time - stroke) * np.pi, -np.pi / 2, np.pi / 2)) ** 2 for stroke in STROKES)
    directions = np.repeat(skeleton.mean_directions[None], len(time), axis=0)
    directions[:, skeleton.bone("right_wrist"), 1] -= 1.5 * lift
    return Motion.from_directions(skeleton, directions, fps)


@pytest.mark.parametrize("fps", [10, 15, 60])
def test_the_frames_are_those_of_the_farthest_reach(fps):
    chosen = keyframes.choose(gesturing(fps), 4)
    np.testing.assert_allclose(np.array(chosen) / fps, STROKES, atol=0.11)


def test_where_nothing_happens_frames_are_spread_evenly():
    motion = gesturing()
    still = Motion.from_directions(motion.skeleton, np.repeat(motion.directions[:1], 120, axis=0), 15)
    assert keyframes.choose(still, 4) == [15, 45, 75, 105]


@pytest.mark.parametrize("count", [1, 3, 8, 40])
@pytest.mark.parametrize("frames", [1, 2, 7, 41, 120])
def test_as_many_different_frames_as_asked_for_in_order(count, frames):
    motion = gesturing()
    short = dataclasses.replace(motion, directions=motion.directions[:frames], positions=motion.positions[:frames])
    chosen = keyframes.choose(short, count)
    assert len(chosen) == min(count, frames)
    assert chosen == sorted(set(chosen))
    assert 0 <= chosen[0] <= chosen[-1] < frames


def test_an_svg_shows_the_same_with_times_and_words_as_text(tmp_path):
    words = [Word("well", 0.5, 0.8), Word("<now>", 0.85, 1.2), Word("far", 2.2, 2.3), Word("there", 3.0, 3.3)]
    motion = gesturing()
    keyframes.write(tmp_path / "s.svg", {"a & b": motion, "c": motion}, count=4, words=words)
    root = ElementTree.parse(tmp_path / "s.svg").getroot()
    pictures = root.findall(f"{SVG}svg")
    assert len(pictures) == 8
    assert {picture.get("y") for picture in pictures[:4]} == {pictures[0].get("y")}
    assert all(len(picture.findall(f"{SVG}polygon")) > 80 for picture in pictures)
    lines = ["".join(text.itertext()) for text in root.findall(f"{SVG}text")]
    times = [line for line in lines if line.endswith(" s")]
    assert len(times) == 4
    np.testing.assert_allclose([float(line[:-2]) for line in times], STROKES, atol=0.1)
    assert [line for line in lines if line not in times] == ["a & b", "c", "well <now>", "far there"]
    colours = {span.text: span.get("fill") for span in root.iter(f"{SVG}tspan")}
    assert colours["<now>"] == colours["there"] == colours["c"] != colours["well"] == colours["far"]


@pytest.mark.parametrize(("name", "size", "message"), [("s.jpg", 64, "png or .svg"), ("s.png", 9, "9 pixels")])
def test_mistakes_are_named_and_leave_nothing(tmp_path, name, size, message):
    with pytest.raises(UserError, match=message):
        keyframes.write(tmp_path / name, gesturing(), size=size)
    assert list(tmp_path.iterdir()) == []

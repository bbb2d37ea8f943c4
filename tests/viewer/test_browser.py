"""The page in a real Chromium: what is drawn at a time of the sound is the motion at that time, and nothing is loaded.

It needs node, chromium and playwright-core, which node finds in NODE_PATH or node_modules; it is skipped without them.
The pictures that it takes, light.png and dark.png, stay in the test's temporary folder.
"""

import pathlib

import numpy as np
import pytest
from fixtures.browser import drive
from fixtures.motions import swaying

from ha2g_jax.features.text import Word
from ha2g_jax.motion.resample import resample
from ha2g_jax.skeleton import directions_to_positions
from ha2g_jax.viewer import view

CLICK = 1.2  # seconds
TO_PAGE = np.array([1, -1, -1])


@pytest.fixture(scope="module")
def motions():
    return {"first": swaying(frames=30, fps=15.0), "second": swaying(frames=60, fps=30.0, seed=1)}


@pytest.fixture(scope="module")
def seen(motions, tmp_path_factory):
    """What the script saw; `folder` is where its pictures are."""
    folder = tmp_path_factory.mktemp("viewer")
    audio = np.zeros(32000, np.float32)
    audio[int(CLICK * 16000) :][:800] = 0.8 * np.sin(np.arange(800) * 0.4)
    words = [Word("hello", 0.2, 0.7), Word("there", 0.8, 1.3)]
    view(motions, audio, words=words).save(folder / "two.html")
    view(motions["first"]).save(folder / "silent.html")
    frame = view(motions["second"], audio)._repr_html_()
    (folder / "notebook.html").write_text(f'<!doctype html><link rel="icon" href="data:,">{frame}')
    return {**drive(pathlib.Path(__file__).with_name("drive.cjs"), folder), "folder": folder}


def positions(motion, time):
    """(joints, 3) of a motion at a time in the axes of the page, by the interpolation that videos use."""
    place = min(time * motion.fps, motion.num_frames - 1)
    frame = int(place + 1e-4)
    pair = motion.directions[[frame, min(frame + 1, motion.num_frames - 1)]]
    poses = resample(pair, 1.0, 64.0, 65)
    return directions_to_positions(motion.skeleton, poses[round(64 * max(place - frame, 0))]) * TO_PAGE


def check_shown(shown, motions):
    for figure, motion in zip(shown["figures"], motions, strict=True):
        assert figure["frame"] == min(int(shown["time"] * motion.fps + 1e-4), motion.num_frames - 1)
        found = np.array([figure["joints"][name] for name in motion.joint_names])
        np.testing.assert_allclose(found, positions(motion, shown["time"]), atol=0.003)


def test_the_frame_shown_is_that_of_the_time(seen, motions):
    assert [round(shown["time"], 2) for shown in seen["shown"]] == [0, 0.5, 1.01, 1.5, 1.96]
    for shown in seen["shown"]:
        check_shown(shown, motions.values())
    first, last = (np.array(list(shown["figures"][0]["joints"].values())) for shown in seen["shown"][::4])
    assert np.abs(first - last).max() > 0.05  # or else the check above shows nothing


def test_joints_of_a_frame_are_kept_to_a_millimetre(seen, motions):
    shown = seen["shown"][3]  # 1.5 s lies on a frame of both motions but for half a frame of the first
    joints = shown["figures"][1]["joints"]
    exact = motions["second"].positions[45] * TO_PAGE
    assert np.abs(np.array(list(joints.values())) - exact).max() < 0.001


def test_no_hand_is_cut_off_on_a_desktop_or_a_phone(seen):
    assert min(seen["inside"].values()) > 8  # pixels


def test_pictures_go_with_the_sound_to_the_end(seen):
    drawn = np.array(seen["drawn"])
    assert seen["wasPlaying"]
    assert len(drawn) > 2
    assert (np.diff(drawn[:, 0]) >= 0).all()
    sound = np.minimum(drawn[:, 1], 2)  # that of the MP3 ends a moment after the motion
    assert np.abs(drawn[:, 0] - sound).max() < 1 / 30
    assert drawn[-1, 0] == pytest.approx(2, abs=1e-3)


def test_the_sound_is_in_its_place(seen):
    assert seen["click"] == pytest.approx(CLICK, abs=0.003)


def test_nothing_is_loaded_from_anywhere(seen):
    assert seen["errors"] == []
    assert len(seen["requests"]) >= 3
    inside = ("blob:", "data:", f"file://{seen['folder']}/", "about:srcdoc")
    assert [request for request in seen["requests"] if not request.startswith(inside)] == []


def test_keys_and_pointer(seen):
    assert seen["hovered"] == "left_wrist"
    assert seen["pressedBySpace"] == [True, False]
    keys = seen["keys"]  # from half a second, frame 7
    assert keys["."][1] == 8
    assert keys[","][1] == 7
    assert keys["ArrowRight"][0] == pytest.approx(keys[","][0] + 1, abs=1e-3)
    assert keys["End"] == [pytest.approx(2, abs=1e-3), 29]
    assert keys["Home"] == [0, 0]
    assert keys["faster"] == 1.5


def test_a_motion_without_sound_plays_to_its_end(seen, motions):
    assert seen["silentEnd"]["time"] == pytest.approx(2)
    check_shown(seen["silentEnd"], [motions["first"]])
    assert seen["silentLoop"] == [False, pytest.approx(2)]  # paused there
    assert seen["stepsAfterEnd"] == pytest.approx([7 + 1 / 15, 7], abs=1e-3)


def test_it_stands_in_a_notebook(seen, motions):
    check_shown(seen["inNotebook"], [motions["second"]])

"""The live page in a real Chromium: sound and figure stay together for a minute, and refusals are told.

It needs node, chromium and playwright-core, which node finds in NODE_PATH or node_modules; it is skipped without them.
The pictures that it takes, wide.png and phone.png, stay in the test's temporary folder.
"""

import contextlib
import json
import pathlib
import re
import socket
import threading

import numpy as np
import pytest
import soundfile
from fixtures.browser import drive

from ha2g_jax.apps.live.frames import Frame, Rigs
from ha2g_jax.apps.live.sinks import open_sinks
from ha2g_jax.skeleton import directions_to_positions, load_skeleton, normalize

pytest.importorskip("fastapi")
from fixtures.service import TOKEN, running

FPS, RATE = 15, 16000
SECONDS, TONE = 64, 61  # length of the sound, and when a loud tone begins
LOOK_AHEAD, PIECE = 8, 0.04  # frames that the page asks for at first; seconds of sound in its messages
TO_PAGE = np.array([1, -1, -1])


def write_speech(path):
    random = np.random.default_rng(0)
    samples = random.normal(0, 0.05, SECONDS * RATE) * np.sin(np.arange(SECONDS * RATE) / RATE * 4 * np.pi) ** 2
    samples[TONE * RATE :][:3200] = 0.9 * np.sin(np.arange(3200) * 0.4)
    soundfile.write(path, samples, RATE)


def pose(number):
    """The pose (bones, 3) of a frame that `ha2g live` sends."""
    skeleton = load_skeleton("ted_expressive")
    phase = np.random.default_rng(0).uniform(0, 6, (skeleton.num_bones, 3))
    return normalize((skeleton.mean_directions + 0.2 * np.sin(number / FPS + phase)).astype(np.float32))


@contextlib.contextmanager
def sending():
    """Yield the address of a sink of `ha2g live` to which frames are sent."""
    skeleton, done = load_skeleton("ted_expressive"), threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    rigs = Rigs(skeleton, FPS, ["ha2g"])
    with contextlib.ExitStack() as stack:
        (sink,) = open_sinks([f"ws://127.0.0.1:{port}"], stack).senders

        def send():
            number = 0
            while not done.wait(1 / FPS):
                (animations,) = rigs.convert(pose(number)[None])
                sink.send(Frame(number, number / FPS, 0, skeleton, pose(number), animations))
                number += 1

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield f"http://127.0.0.1:{port}"
        finally:
            done.set()
            thread.join()


@pytest.fixture(scope="module")
def seen(debug_model, tmp_path_factory):
    """What the script saw; `folder` is where its pictures are."""
    folder = tmp_path_factory.mktemp("live")
    write_speech(folder / "speech.wav")
    with (
        running(debug_model, sessions=2) as main,
        running(debug_model, token=TOKEN) as token,
        running(debug_model, session_seconds=3) as short,
        sending() as frames,
    ):
        services = {"main": main, "token": token, "short": short}
        addresses = {name: f"http://127.0.0.1:{client.port}" for name, client in services.items()}
        addresses |= {"frames": frames, "secret": TOKEN}
        found = drive(pathlib.Path(__file__).with_name("drive_live.cjs"), folder, json.dumps(addresses))
    return {**found, "folder": folder, "addresses": addresses}


@pytest.mark.parametrize("source", ["file", "microphone"])
def test_after_a_minute_the_frame_shown_is_that_of_the_sound(seen, source):
    """By the clock of the page: the frame in the image against the sound that leaves the loudspeaker."""
    output, delay, shown = np.array(seen[source]["drawn"]).T
    late = output >= TONE - 10
    assert late.sum() > 5
    assert np.median(np.abs(shown[late] / FPS - (output - delay)[late])) < 1 / FPS


def test_the_frame_shown_with_a_tone_is_that_of_the_tone(seen):
    """By the sound that is played: when the tone of the file is in it, the figure shows the time of the tone."""
    output, _, shown = np.array(seen["file"]["drawn"]).T
    assert abs(np.interp(seen["file"]["tone"], output, shown) / FPS - TONE) < 1 / FPS


@pytest.mark.parametrize("source", ["file", "microphone"])
def test_as_much_sound_is_sent_as_the_clock_says(seen, source):
    ends, times = np.array(seen[source]["sent"]).T
    ahead = times - ends
    assert abs(ahead[times > TONE - 25].min() - ahead[times < 25].min()) < 1 / FPS


@pytest.mark.parametrize("source", ["file", "microphone"])
def test_frames_come_with_the_sound_that_they_need(seen, source):
    """By the numbers of the frames and the clock: after half a minute none is too early, and the first are in time."""
    last, times = np.array(seen[source]["arrived"])[:-1].T  # the last frames of a file do not wait for sound
    assert 0 <= (times - last / FPS)[times > TONE - 30].min() - LOOK_AHEAD / FPS < PIECE + 1 / FPS


def test_the_frames_of_a_file_are_all_there(seen):
    assert seen["file"]["arrived"][-1][0] == SECONDS * FPS - 1


def test_the_page_asks_its_own_origin_only(seen):
    assert seen["errors"] == []
    own = [address.removeprefix("http://") for name, address in seen["addresses"].items() if name != "secret"]
    outside = [it for it in seen["requests"] if not re.match(rf"(blob:)?(http|ws)://({'|'.join(own)})/", it)]
    assert [it for it in outside if not it.startswith("data:")] == []
    assert sum(it.startswith("ws:") for it in seen["requests"]) >= 6


def test_refusals_and_ends_are_told(seen):
    assert seen["full"] == "Refused (503): 2 streams are running; try again later."
    assert seen["wrongToken"].startswith("Refused (401): the token is missing or wrong")
    assert seen["denied"] == "The microphone may not be used; allow it for this page in the browser."
    assert seen["noSound"] == "This browser finds no sound in a.txt."
    assert seen["ended"] == "The stream has ended: the stream has lasted 3 s; begin another one."
    assert seen["buttons"] and seen["stopped"] == "Stopped."
    assert seen["listening"] == "Listening: the figure follows what you say."


def test_states_cues_and_an_interruption_are_sent_and_the_stream_goes_on(seen):
    messages = [json.loads(text) for text in seen["texts"]]
    assert {it["channels"] for it in messages if "rate" in it} == {2}
    asked = [it for it in messages if it.keys() & {"state", "cue", "clear"}]
    assert asked == [{"state": "think"}, {"cue": "wave"}, {"clear": True}]
    assert seen["pressed"] == ["Think", "Other's voice"]


def test_names_are_shown_as_text(seen):
    assert seen["named"] == "<img src=x onerror=alert(1)>.wav" and seen["pictures"] == 0


def test_the_page_of_ha2g_live_shows_the_frames_between_their_times(seen):
    skeleton = load_skeleton("ted_expressive")
    for watched in seen["watched"]:
        number, part = int(watched["shown"]), watched["shown"] % 1
        directions = (1 - part) * pose(number) + part * pose(number + 1)
        expected = directions_to_positions(skeleton, normalize(directions)) * TO_PAGE
        found = np.array([watched["joints"][name] for name in skeleton.joints])
        np.testing.assert_allclose(found, expected, atol=1e-3)
    shown = [watched["shown"] for watched in seen["watched"]]
    assert shown[-1] > shown[0] and not seen["watchButtons"]
    assert seen["bonesBefore"] == "false"


def test_it_fits_a_phone(seen):
    for name in ("wide", "phone"):
        width, inside, below = seen[name]
        assert width <= inside and below >= 0

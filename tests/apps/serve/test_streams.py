"""Streams over real sockets: their frames, and the messages that end them."""

import json

import numpy as np
import pytest
from fixtures.service import begin, closing, finish, running, speech

from ha2g_jax.synthesis import Style


def test_a_stream_gives_the_frames_of_the_model(client, debug_model):
    pcm = speech(2.03)
    options = {"look_ahead": 2, "hop": 2, "seed": 5}
    stream = debug_model.stream(**options, style=Style(speaker="ada"))
    expected = np.concatenate([stream.feed(pcm.astype(np.float32) / 32768), stream.flush()])
    with client.stream() as websocket:
        facts = begin(websocket, **options, style={"speaker": "ada"})
        assert facts == {
            "fps": 15,
            "skeleton": "ted_expressive",
            "bones": 42,
            "look_ahead": 2,
            "hop": 2,
            "latency": round(stream.latency, 4),
        }
        for part in np.split(pcm, [3, 9000, 20000]):
            websocket.send(part.tobytes())
        frames, last = finish(websocket)
        assert closing(websocket) == ([], 1000)
    assert last == {"end": True, "count": len(expected)}
    np.testing.assert_allclose(frames, expected, atol=5.1e-5)


def test_another_rate_and_changes_on_the_way(client):
    with client.stream() as websocket:
        begin(websocket, rate=48000, muted=True, controls={"energy": 0.5, "handedness": "left"})
        websocket.send(bytes(24_000))
        websocket.send('{"style": {"mixture": {"ada": 1, "ben": 2}}, "controls": {}, "muted": false}')
        for _ in range(3):
            websocket.send(bytes(24_000))
        frames, last = finish(websocket)
    assert len(frames) == last["count"] == 15


BAD_MESSAGES = {
    "binary first": ([b"\0\0"], "the first message is binary"),
    "deep JSON": (["[" * 10_000], "JSON"),
    "unknown name": (['{"speed": 1}'], "speed: no such name"),
    "look-ahead": (['{"look_ahead": 99}'], "the look-ahead is 99"),
    "file": (['{"style": {"images": ["/etc/passwd"]}}'], "style.images: no such name"),
    "half a sample": (["{}", b"\0"], "whole samples of 16 bits"),
    "change": (["{}", '{"controls": {"energy": 9}}'], "the energy is 9"),
}


@pytest.mark.parametrize("name", BAD_MESSAGES)
def test_a_bad_message_closes_the_stream_with_one_line(client, name):
    messages, text = BAD_MESSAGES[name]
    with client.stream() as websocket:
        for message in messages:
            websocket.send(message)
        received, code = closing(websocket)
    assert code == 1007
    assert text in received[-1]["error"] and "\n" not in received[-1]["error"]


def test_text_that_is_not_utf8_closes_the_stream_without_a_line_in_the_log(client, caplog):
    with client.stream() as websocket:
        begin(websocket)
        websocket.send(b"\xff", text=True)
        assert closing(websocket) == ([], 1007)
    assert not caplog.records


def test_a_message_that_is_too_large_closes_the_stream(client):
    with client.stream() as websocket:
        begin(websocket)
        websocket.send(bytes(40_002))
        assert closing(websocket) == ([], 1009)


@pytest.mark.parametrize(("limit", "text"), [("idle_seconds", "no message for"), ("session_seconds", "has lasted")])
def test_a_stream_that_takes_too_long_is_ended(debug_model, limit, text):
    with running(debug_model, **{limit: 0.3}) as client, client.stream() as websocket:
        websocket.send("{}")
        received, code = closing(websocket)
    assert code == 1008 and text in received[-1]["error"]


def test_clear_begins_the_motion_again_with_the_style_and_controls_of_the_stream(debug_model):
    """The frames after "cleared" are those of a new stream of the sound after it, counted from 0."""
    old, new = speech(1.5)[:20000], speech(2)[8000:]
    with running(debug_model) as client, client.stream() as websocket:
        begin(websocket, seed=3)
        websocket.send(old.tobytes())
        websocket.send('{"style": {"speaker": "ben"}, "controls": {"energy": 0.5}, "clear": true}')
        while "cleared" not in (message := json.loads(websocket.recv(timeout=20))):
            assert "frames" in message
        assert message == {"cleared": True}
        websocket.send(new.tobytes())
        frames, last = finish(websocket)
    with running(debug_model) as client, client.stream() as websocket:
        begin(websocket, seed=3, style={"speaker": "ben"}, controls={"energy": 0.5})
        websocket.send(new.tobytes())
        expected, _ = finish(websocket)
    assert last["count"] == len(frames) == len(expected) == 22
    np.testing.assert_array_equal(frames, expected)

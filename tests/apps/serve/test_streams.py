"""Streams over real sockets: their frames, and the messages that end them."""

import asyncio
import json
import pathlib
import re
from typing import Any

import numpy as np
import pytest
from fixtures.service import begin, closing, finish, running, speech

from ha2g_jax.motion.cues import MOST
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


def test_the_client_of_the_page_gets_all_frames(client):
    page = (pathlib.Path(__file__).parents[3] / "docs" / "serving.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    exec(code, names)
    url = f"ws://127.0.0.1:{client.port}/v1/stream"
    frames = asyncio.run(names["gestures"](speech(2.0).tobytes(), url))
    assert np.shape(frames) == (30, 126)


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
    "no object": (["[]"], 'no object; send one, such as {"muted": true}'),
    "a style that is a text": (['{"style": "ada"}'], "style: expected an object"),
    "unknown name": (['{"speed": 1}'], "speed: no such name"),
    "look-ahead": (['{"look_ahead": 99}'], "the look-ahead is 99"),
    "seed": (['{"seed": -1}'], "seed: "),
    "channels": (['{"channels": 3}'], "channels: expected 1 or 2"),
    "file": (['{"style": {"images": ["/etc/passwd"]}}'], "style.images: no such name"),
    "half a sample": (['{"channels": 2}', b"\0\0"], "whole samples of 16 bits"),
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


TEXTS = {
    "deep JSON": ("[" * 10_000, "JSON"),
    "control": ('{"style": {"speaker": "ben"}, "controls": {"energy": 9}}', "the energy is 9"),
    "state": ('{"state": "sleep"}', "state: expected 'auto', 'idle', 'listen' or 'think'"),
    "cue": ('{"cue": "dance"}', "no cue 'dance'; expected"),
    "clip": ('{"cue": "clip:/etc/passwd"}', "no cue"),
    "word": ('{"cue": "nod", "word": "yes"}', "word: no such name"),
    "clear": ('{"clear": false}', "clear: expected true, or the number of a frame"),
    "later frame": ('{"style": {"speaker": "ben"}, "clear": 900}', "frame 900 is not remembered; clear one of 0 to"),
}


def test_text_that_cannot_be_used_is_answered_and_changes_nothing(client):
    """Two hundred such messages, too."""
    scrambled = np.random.default_rng(0).integers(32, 127, (192, 40), np.uint8)
    texts = [text for text, _ in TEXTS.values()] + [bytes(row).decode() for row in scrambled]
    answers, pcm, found = [], speech(1), []
    for each in ([], texts):
        with client.stream() as websocket:
            begin(websocket)
            websocket.send(pcm[:9000].tobytes())
            for text in each:
                websocket.send(text)
            websocket.send(pcm[9000:].tobytes())
            websocket.send('{"end": true}')
            received, code = closing(websocket)
        assert code == 1000
        answers = [message["error"] for message in received if "error" in message]
        found.append([message for message in received if "error" not in message])
    assert found[0] == found[1] and len(answers) == len(texts) == 200
    assert not any("\n" in answer or len(answer) > 500 for answer in answers)
    for answer, (_, expected) in zip(answers, TEXTS.values(), strict=False):
        assert expected in answer


def test_sound_that_a_resampler_holds_back_stays_when_a_clear_is_refused(client):
    """Its end would give the first frames, which need 0.6 s of sound."""
    with client.stream() as websocket:
        begin(websocket, rate=48000)
        for _ in range(2):
            websocket.send(bytes(28_800))
        websocket.send('{"clear": 900}')
        assert "frame 900 is not remembered" in json.loads(websocket.recv(timeout=20))["error"]


def test_a_cue_too_many_is_answered_and_the_stream_goes_on(client):
    with client.stream() as websocket:
        begin(websocket)
        for text in ['{"cue": "nod", "time": 9}'] * (MOST + 2) + ['{"clear": true, "cue": "nod"}', '{"end": true}']:
            websocket.send(text)
        received, code = closing(websocket)
    answers = [message["error"] for message in received if "error" in message]
    assert len(answers) == 2 and answers[0].startswith("64 cues wait to be made; give nod when one of them has begun")
    assert code == 1000 and {"cleared": True, "first": 0} in received


@pytest.mark.parametrize(("clear", "rate"), [(True, 16000), (12, 16000), (True, 48000), (12, 48000)])
def test_clear_goes_on_as_the_stream_of_the_model_does(client, debug_model, clear, rate):
    """With changes in the same message, and the sound of the other in the second channel."""
    pcm = np.repeat(np.stack([speech(2), speech(2)[::-1]], axis=-1), rate // 16000, axis=0)
    stream = debug_model.stream(seed=3)
    samples = pcm[:: rate // 16000].astype(np.float32).T / 32768
    shown = stream.feed(*samples)
    stream.style, stream.state = Style(speaker="ben"), "listen"
    first = stream.clear(None if clear is True else clear)
    stream.cue("nod")
    expected = np.concatenate([shown[:first], stream.feed(*samples), stream.flush()])
    with client.stream() as websocket:
        begin(websocket, seed=3, rate=rate, channels=2)
        for part in np.array_split(pcm, 12):
            websocket.send(part.tobytes())
        change = {"style": {"speaker": "ben"}, "state": "listen", "clear": clear, "cue": "nod"}
        websocket.send(json.dumps(change))
        for part in np.array_split(pcm, 12):
            websocket.send(part.tobytes())
        websocket.send('{"end": true}')
        received, code = closing(websocket)
    place = received.index({"cleared": True, "first": first})
    frames = [row for message in received[:place] for row in message["frames"]][:first]
    for message in received[place + 1 : -1]:
        assert message["first"] == len(frames)
        frames += message["frames"]
    assert code == 1000 and received[-1] == {"end": True, "count": len(expected)}
    if rate == 16000:
        np.testing.assert_allclose(np.array(frames).reshape(-1, 42, 3), expected, atol=5.1e-5)

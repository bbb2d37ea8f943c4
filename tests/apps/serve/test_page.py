"""The page of the service: it is whole, may reach nothing but its own origin, and learns why a stream is refused."""

import base64
import hashlib
import html.parser
import json
import re

import numpy as np
import pytest
from fixtures.service import TOKEN, begin, finish, running, speech

from ha2g_jax.motion.control.parts import rest_pose
from ha2g_jax.viewer.live_page import live_page


class Elements(html.parser.HTMLParser):
    """The elements of a page: (tag, attributes, text)."""

    def __init__(self, text):
        super().__init__()
        self.elements = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), ""))

    def handle_endtag(self, tag):
        self.elements.append((f"/{tag}", {}, ""))  # what follows is not the text of the element

    def handle_data(self, data):
        if self.elements:
            tag, attributes, text = self.elements[-1]
            self.elements[-1] = (tag, attributes, text + data)


@pytest.fixture(scope="module")
def client(debug_model):
    with running(debug_model, sessions=1) as client:
        yield client


def test_the_page_has_all_it_needs_and_runs_nothing_else(client):
    answer = client.ask("GET", "/")
    assert answer.status == 200 and answer.headers["Content-Type"] == "text/html; charset=utf-8"
    elements = Elements(answer.body.decode()).elements
    links = [attributes.get(name) for _, attributes, _ in elements for name in ("src", "href", "data", "action")]
    assert set(filter(None, links)) == {"data:,"}
    names = {name for _, attributes, _ in elements for name in attributes}
    assert not [name for name in names if name.startswith("on") or name == "style"]
    rules = dict(rule.split(" ", 1) for rule in answer.headers["Content-Security-Policy"].split("; "))
    assert rules["default-src"] == "'none'" and rules["connect-src"] == "'self'" and "unsafe" not in str(rules)
    assert rules["base-uri"] == rules["form-action"] == rules["frame-ancestors"] == "'none'"
    for name, tag in (("script-src", "script"), ("style-src", "style")):
        run = [text for found, attributes, text in elements if found == tag and not attributes]
        hashes = {base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in run}
        assert len(run) >= 1 and set(re.findall(r"'sha256-([^']+)'", rules[name])) == hashes
    assert answer.headers["X-Content-Type-Options"] == "nosniff" and "no-store" in answer.headers["Cache-Control"]


def test_the_page_has_the_skeleton_of_the_model(client, debug_model):
    skeleton = debug_model.assets.skeleton
    content = content_of(client.ask("GET", "/").body)
    assert content["figure"]["joints"] == list(skeleton.joints) and content["figure"]["fps"] == 15
    assert content["speakers"] == ["ada", "ben"] and content["source"] == "sound"
    np.testing.assert_allclose(np.reshape(content["figure"]["rest"], (-1, 3)), rest_pose(skeleton), atol=1e-4)


def content_of(page):
    (text,) = [text for _, attributes, text in Elements(page.decode()).elements if attributes.get("id") == "content"]
    return json.loads(text)


def test_names_of_speakers_cannot_end_the_script(debug_model):
    wicked = "</script><img src=x onerror=alert(1)>"
    page = live_page("sound", debug_model.assets.skeleton, 15, speakers=[wicked])
    assert not [tag for tag, _, _ in Elements(page.content.decode()).elements if tag == "img"]
    assert content_of(page.content)["speakers"] == [wicked]


def test_the_page_alone_needs_no_token_and_names_nobody(debug_model):
    with running(debug_model, token=TOKEN) as client:
        answer = client.ask("GET", "/")
        assert answer.status == 200 and content_of(answer.body)["needsToken"] is True
        assert content_of(answer.body)["speakers"] == [] and TOKEN.encode() not in answer.body
        assert client.ask("GET", "//").status == client.ask("GET", "/v1/stream").status == 401
        assert client.ask("GET", "/v1/stream", None, {"Authorization": f"Bearer {TOKEN}"}).status == 426


def test_pages_of_other_hosts_do_not_get_it(client):
    assert client.ask("GET", "/", None, {"Host": "evil.example"}).status == 403
    assert client.ask("GET", "/", None, {"Origin": "https://evil.example"}).status == 403


def test_a_plain_request_tells_why_a_stream_is_refused(client):
    free = client.ask("GET", "/v1/stream")
    assert free.status == 426 and free.headers["Upgrade"] == "websocket"
    with client.stream() as websocket:
        begin(websocket)
        full = client.ask("GET", "/v1/stream")
    assert full.status == 503 and full.error == "1 streams are running; try again later"
    assert int(full.headers["Retry-After"]) > 0


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

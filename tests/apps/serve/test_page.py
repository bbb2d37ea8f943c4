"""The page of the service: it is whole, may reach nothing but its own origin, and learns why a stream is refused."""

import base64
import hashlib
import json
import re

import numpy as np
from fixtures.pages import Page
from fixtures.service import TOKEN, running

from ha2g_jax.motion.control.parts import rest_pose
from ha2g_jax.viewer.live_page import live_page


def test_the_page_has_all_it_needs_and_runs_nothing_else(client):
    answer = client.ask("GET", "/")
    assert answer.status == 200 and answer.headers["Content-Type"] == "text/html; charset=utf-8"
    page = Page(answer.body.decode())
    links = [attributes.get(name) for _, attributes, _ in page.elements for name in ("src", "href", "data", "action")]
    assert set(filter(None, links)) == {"data:,"}
    assert not [name for name in page.attributes if name.startswith("on") or name == "style"]
    rules = dict(rule.split(" ", 1) for rule in answer.headers["Content-Security-Policy"].split("; "))
    assert rules["default-src"] == "'none'" and rules["connect-src"] == "'self'" and "unsafe" not in str(rules)
    assert rules["base-uri"] == rules["form-action"] == rules["frame-ancestors"] == "'none'"
    for name, tag in (("script-src", "script"), ("style-src", "style")):
        run = [text for found, attributes, text in page.elements if found == tag and not attributes]
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
    return json.loads(Page(page.decode()).of("content"))


def test_names_of_speakers_cannot_end_the_script(debug_model):
    wicked = "</script><img src=x onerror=alert(1)>"
    page = live_page("sound", debug_model.assets.skeleton, 15, speakers=[wicked])
    assert "img" not in Page(page.content.decode()).tags
    assert content_of(page.content)["speakers"] == [wicked]


def test_the_page_alone_needs_no_token_and_names_nobody(debug_model):
    with running(debug_model, token=TOKEN) as client:
        answer = client.ask("GET", "/")
        assert answer.status == 200 and content_of(answer.body)["needsToken"] is True
        assert content_of(answer.body)["speakers"] == [] and TOKEN.encode() not in answer.body
        assert client.ask("GET", "//").status == client.ask("GET", "/v1/stream").status == 401
        assert client.ask("GET", "/v1/stream", None, {"Authorization": f"Bearer {TOKEN}"}).status == 426

"""One page that holds all it needs, whatever it is given."""

import html.parser
import json
import re

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.motion.motion import Motion
from ha2g_jax.viewer import view, write_page
from ha2g_jax.viewer.page import three_library


class Elements(html.parser.HTMLParser):
    """The elements of a page: (tag, attributes), and the text of those that have an id."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.texts, self._id = [], {}, None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self._id = dict(attrs).get("id")

    def handle_data(self, data):
        self.texts[self._id] = self.texts.get(self._id, "") + data


def content(page):
    return json.loads(Elements(page.text).texts["content"])


@pytest.fixture(scope="module")
def speech():
    return np.random.default_rng(0).normal(0, 0.1, 16000).astype(np.float32)


def test_the_page_names_nothing_outside_itself(make_motion, speech):
    elements = Elements(view(make_motion(), speech, words=[Word("hello", 0.1, 0.4)]).text).elements
    assert len(elements) > 30
    links = [attributes.get(name) for _, attributes in elements for name in ("src", "href", "data")]
    assert set(filter(None, links)) == {"data:,"}  # the icon, which browsers else ask for
    (policy,) = [a["content"] for _, a in elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "connect-src" not in policy  # so that default-src holds for it


def test_the_same_input_gives_the_same_page(make_motion, speech, tmp_path):
    pages = [write_page(tmp_path / name, {"a": make_motion()}, speech) for name in ("one.html", "two.html")]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.html", "two.html"]


def test_names_and_words_cannot_end_the_script(make_motion):
    wicked = "</script><img src=x onerror=alert(1)>$title"
    page = view({wicked: make_motion()}, words=[Word(wicked, 0, 1)])
    assert not any(tag == "img" for tag, _ in Elements(page.text).elements)
    assert content(page)["motions"][0]["name"] == wicked
    assert content(page)["words"] == [[wicked, 0, 1]]


def test_the_page_lasts_as_long_as_what_it_shows(make_motion, speech):
    assert content(view(make_motion(frames=45), speech))["duration"] == pytest.approx(3)
    assert content(view(make_motion(frames=6), speech))["duration"] == pytest.approx(1)
    silent = content(view({"a": make_motion(frames=45), "b": make_motion(frames=48, fps=24.0)}))
    assert silent["duration"] == pytest.approx(3)
    assert silent["sound"] is None
    assert [motion["name"] for motion in silent["motions"]] == ["a", "b"]


def test_a_notebook_shows_the_page_in_a_frame(make_motion):
    page = view(make_motion(), height=400)
    ((tag, attributes),) = Elements(page._repr_html_()).elements
    assert tag == "iframe"
    assert attributes["srcdoc"] == page.text
    assert "height: 400px" in attributes["style"]
    assert len(repr(page)) < 100  # which is stored with the output, too


def test_what_cannot_be_shown_is_refused_in_one_line(make_motion, tmp_path):
    motion = make_motion()
    broken = Motion(motion.directions.copy(), motion.positions, 15.0, motion.joint_names, motion.meta)
    broken.directions[3, 5] = np.nan
    many = Motion.from_directions(motion.skeleton, np.repeat(motion.directions, 7_000, axis=0), 240.0)
    for motions in ({}, {str(i): motion for i in range(13)}, broken, {str(i): many for i in range(5)}):
        with pytest.raises(UserError, match=r"^[^\n]+$"):
            view(motions)
    for audio, message in ((np.zeros((2, 16000)), "mix it to mono"), (np.full(16000, np.nan), "not finite")):
        with pytest.raises(UserError, match=message):
            view(motion, audio)
    with pytest.raises(UserError, match=r"not 'talk\.mp4'; give a name that ends in \.html"):
        write_page(tmp_path / "talk.mp4", motion)
    assert not list(tmp_path.iterdir())


def test_three_js_comes_whole():
    text = three_library().decode()
    assert re.search(r"SPDX-License-Identifier: MIT", text)  # travels with every page
    assert "OrbitControls" in text

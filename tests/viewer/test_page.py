"""One page that holds all it needs, whatever it is given, packed to less than the eye sees."""

import base64
import io
import json
import zlib
from typing import Any, cast

import av
import numpy as np
import pytest
import soundfile
from fixtures.motions import swaying
from fixtures.pages import Page

from ha2g_jax import cli
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.motion.armature import figure_armature
from ha2g_jax.motion.formats.body_mesh import body_mesh
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import normalize
from ha2g_jax.viewer import view
from ha2g_jax.viewer.packing import LEVELS, PEAK_RATE, encode_sound, octahedral, pack_body, pack_motion, peaks


def content_of(text):
    return json.loads(Page(text).of("content"))


@pytest.fixture(scope="module")
def speech():
    return np.random.default_rng(0).normal(0, 0.1, 16000).astype(np.float32)


def test_the_page_names_nothing_outside_itself(speech):
    elements = Page(view(swaying(), speech, words=[Word("hello", 0.1, 0.4)]).text).elements
    assert len(elements) > 30
    links = [attributes.get(name) for _, attributes, _ in elements for name in ("src", "href", "data")]
    assert set(filter(None, links)) == {"data:,"}  # the icon, which browsers else ask for
    (policy,) = [a["content"] for _, a, _ in elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "connect-src" not in policy  # so that default-src holds for it


def test_the_same_input_gives_the_same_page(speech, tmp_path):
    pages = [view({"a": swaying()}, speech).save(tmp_path / name) for name in ("one.html", "two.html")]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.html", "two.html"]


def test_names_and_words_cannot_end_the_script():
    wicked = "</script><img src=x onerror=alert(1)>$title"
    page = view({wicked: swaying()}, words=[Word(wicked, 0, 1)])
    assert "img" not in Page(page.text).tags
    assert content_of(page.text)["motions"][0]["name"] == wicked
    assert content_of(page.text)["words"] == [[wicked, 0, 1]]


def test_the_page_lasts_as_long_as_what_it_shows(speech):
    assert content_of(view(swaying(frames=45), speech).text)["duration"] == pytest.approx(3)
    assert content_of(view(swaying(frames=6), speech).text)["duration"] == pytest.approx(1)
    silent = content_of(view({"a": swaying(frames=45), "b": swaying(frames=48, fps=24.0)}).text)
    assert silent["duration"] == pytest.approx(3)
    assert silent["sound"] is None
    assert [motion["name"] for motion in silent["motions"]] == ["a", "b"]


def test_sound_is_as_loud_in_integers_and_its_rate_may_be_a_float(speech):
    steps, rate = np.rint(32767 * speech).astype(np.int16), cast(Any, 16000.0)
    assert view(swaying(), steps, rate).text == view(swaying(), (steps / 32768).astype(np.float32)).text


def test_a_notebook_shows_the_page_in_a_frame():
    page = view(swaying(), height=400)
    (tag, attributes, _), *rest = Page(page._repr_html_()).elements
    assert (tag, rest) == ("iframe", [("/iframe", {}, "")])
    assert attributes["srcdoc"] == page.text
    assert "height: 400px" in attributes["style"]
    assert len(repr(page)) < 100  # which is stored with the output, too


def test_what_cannot_be_shown_is_refused_in_one_line(tmp_path, monkeypatch):
    motion = swaying()
    broken = Motion(motion.directions.copy(), motion.positions, 15.0, motion.joint_names, motion.meta)
    broken.directions[3, 5] = np.nan
    for motions in ({}, {str(i): motion for i in range(13)}, broken):
        with pytest.raises(UserError, match=r"^[^\n]+$"):
            view(motions)
    with monkeypatch.context() as patch:
        patch.setattr("ha2g_jax.viewer.page.MAX_MOTION_FRAMES", 149)
        with pytest.raises(UserError, match=r"^150 frames for one page; expected at most 149, [^\n]+$"):
            view({str(i): motion for i in range(5)})
    for audio, rate, message in (
        (np.zeros((2, 16000)), 16000, "mix it to mono"),
        (np.full(16000, np.nan), 16000, "not finite"),
        (np.zeros(16000), 0, "0 samples per second"),
        (np.zeros(16000), -5, "-5 samples per second"),
    ):
        with pytest.raises(UserError, match=message):
            view(motion, audio, rate)
    with pytest.raises(UserError, match="no camera 'far'; expected one of body, close"):
        view(motion, camera="far")
    with pytest.raises(UserError, match=r"not 'talk\.mp4'; give a name that ends in \.html"):
        view(motion).save(tmp_path / "talk.mp4")
    assert not list(tmp_path.iterdir())


def test_one_page_of_several_files(tmp_path, capsys):
    """For mistakes see tests/cli/test_export."""
    names = ("other", "a/talk", "b/talk")
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        swaying(frames=20).save(tmp_path / f"{name}.npz")
    soundfile.write(tmp_path / "talk.wav", np.random.default_rng(0).normal(0, 0.1, 24000), 16000)
    (tmp_path / "words.srt").write_text("1\n00:00:00,200 --> 00:00:00,900\nhello there\n")
    out = tmp_path / "new" / "view.html"
    options = ["--audio", tmp_path / "talk.wav", "--words", tmp_path / "words.srt", "-o", out]
    assert cli.main([str(word) for word in ("view", *(tmp_path / f"{name}.npz" for name in names), *options)]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    content = content_of(out.read_text())
    assert [motion["name"] for motion in content["motions"]] == list(names)
    assert content["duration"] == 1.5
    assert [word[0] for word in content["words"]] == ["hello", "there"]
    assert content["sound"]


# From the axes of each skeleton's data to y up, facing +z, the person's left at +x.
AXES = {"ted_expressive": [1, -1, -1], "ted_gesture": [-1, -1, 1]}


def unfold(codes):
    """The inverse of `octahedral`, by the paper's formula."""
    square = codes / (LEVELS / 2) - 1
    depth = 1 - np.abs(square).sum(axis=-1)
    folded = (1 - np.abs(square[..., ::-1])) * np.where(square < 0, -1, 1)
    front = np.where(depth[..., None] < 0, folded, square)
    return normalize(np.concatenate([front, depth[..., None]], axis=-1))


def degrees_between(a, b):
    return np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def test_a_direction_is_kept_to_less_than_a_tenth_of_a_degree():
    random = np.random.default_rng(0).normal(size=(20_000, 3))
    corners = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
    directions = normalize(np.concatenate([random, corners, corners + 1e-9]))
    codes = octahedral(directions)
    assert codes.min() >= 0
    assert codes.max() <= LEVELS
    assert degrees_between(unfold(codes), directions).max() < 0.07


@pytest.mark.parametrize("name", AXES)
def test_a_motion_is_unpacked_in_the_axes_of_the_page(name):
    motion = swaying(name, frames=40)
    packed = pack_motion(motion)
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["directions"])), np.uint8).reshape(2, -1)
    zigzag = planes[0] + 256 * planes[1].astype(int)
    steps = np.where(zigzag % 2, -(zigzag + 1) // 2, zigzag // 2).reshape(-1, 40)
    codes = np.cumsum(steps, axis=1).T.reshape(40, -1, 2)
    assert degrees_between(unfold(codes), motion.directions * AXES[name]).max() < 0.07
    assert packed["joints"] == list(motion.joint_names)
    assert packed["lengths"] == pytest.approx(motion.skeleton.lengths, abs=1e-5)


def test_a_body_is_unpacked_to_a_tenth_of_a_millimetre():
    skeleton = swaying().skeleton
    packed = pack_body(skeleton)
    kinds = {"points": np.int16, "bindings": np.uint8, "faces": np.int16}
    points, bindings, faces = (np.frombuffer(zlib.decompress(base64.b64decode(packed[n])), k) for n, k in kinds.items())
    surfaces = list(body_mesh(figure_armature(skeleton)).values())
    assert [tuple(part[2:]) for part in packed["parts"]] == [(len(part.points), len(part.faces)) for part in surfaces]
    exact = np.concatenate([part.points for part in surfaces])
    assert np.abs(np.cumsum(points.reshape(3, -1), axis=1).T / 1e4 - exact).max() < 1e-4
    assert np.cumsum(faces.astype(int)).tolist() == np.concatenate([part.faces.ravel() for part in surfaces]).tolist()
    joints, weights = bindings.reshape(2, -1, 4).astype(int)
    influence = np.zeros((len(exact), len(packed["joints"])))
    np.add.at(influence, (np.arange(len(exact))[:, None], joints), weights / 255)
    influence[:, 0] += influence[:, -1]  # the hips take a part of what moves with the spine
    assert np.abs(influence[:, :-1] - np.concatenate([part.influence for part in surfaces])).max() < 0.01
    assert packed["joints"][-1][0] == "hips"


def test_peaks_lie_where_the_sound_is():
    audio = np.zeros(16_000 * 2 + 5, np.float32)
    audio[16_000:16_010] = -0.25  # at one second
    heights = np.frombuffer(zlib.decompress(base64.b64decode(peaks(audio, 16_000))), np.uint8)
    assert len(heights) == 2 * PEAK_RATE + 1
    assert np.flatnonzero(heights).tolist() == [PEAK_RATE]
    assert heights.max() == 255


def decode(content):
    with av.open(io.BytesIO(content), "r") as container:
        frames = [frame.to_ndarray()[0] for frame in container.decode(audio=0)]
        return np.concatenate(frames), container.streams.audio[0].codec_context.sample_rate


@pytest.mark.parametrize(("rate", "new_rate"), [(16000, 16000), (44100, 44100), (8000, 16000)])
def test_nothing_is_added_before_the_sound(rate, new_rate):
    time = np.arange(int(1.7 * rate)) / rate
    audio = (0.5 * np.sin(2 * np.pi * 300 * time) * (np.abs(time - 1) < 0.1)).astype(np.float32)
    decoded, decoded_rate = decode(encode_sound(audio, rate))
    assert decoded_rate == new_rate
    assert len(decoded) / new_rate == pytest.approx(1.7, abs=0.05)
    loud = np.flatnonzero(np.abs(decoded) > 0.15) / new_rate
    assert loud[0] == pytest.approx(0.9, abs=0.004)
    assert loud[-1] == pytest.approx(1.1, abs=0.004)

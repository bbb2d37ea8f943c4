"""A study is made from folders of motion atomically, and its site tells nothing that the key keeps."""

import collections
import hashlib
import importlib.resources
import json
import pathlib
import re
import shutil

import av
import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.apps.user_study import make
from ha2g_jax.apps.user_study.design import read_key
from ha2g_jax.apps.user_study.make import make_study, name_systems, read_sources
from ha2g_jax.apps.user_study.pages import SCRIPTS, read_wording
from ha2g_jax.errors import UserError

from .conftest import CLIPS, SECONDS, SYSTEMS

ASSETS = importlib.resources.files("ha2g_jax") / "assets" / "study"
JSPSYCH_8_3_0 = "b58c69e607f2ddbd282f2daec43d882cac18d9e3efdad816215b818d1406d6ce"


@pytest.fixture(scope="module")
def key(study):
    return read_key(study / "key.json")


def items_of(study):
    return json.loads((study / "site" / "items.json").read_text())


def seconds_of(path):
    with av.open(str(path)) as container:
        assert {stream.codec_context.name for stream in container.streams} == {"h264", "aac"}
        return sum(1 for _ in container.decode(video=0)) / 30


def test_a_study_has_every_stimulus_as_a_video(study, key):
    assert sorted(path.name for path in study.iterdir()) == ["key.json", "site"]
    media = {path.stem: path for path in (study / "site" / "media").iterdir()}
    assert media.keys() == key.stimuli.keys()
    counts = collections.Counter(item.kind for item in key.items)
    assert counts == {"rating": 4, "preference": 2, "mismatch": 4, "attention": 1} == key.per_participant
    for name, path in media.items():
        assert hashlib.sha256(path.read_bytes()).hexdigest() == key.stimuli[name].sha256
        length = seconds_of(path)
        assert 3 < length < 6 if key.stimuli[name].sound_of is None else length == pytest.approx(SECONDS)
    assert (key.systems, key.clips) == (SYSTEMS, CLIPS)


def test_the_site_says_nothing_of_what_the_key_keeps(study, key):
    content = items_of(study)
    assert content["study"] == key.study
    assert [item["id"] for item in content["items"]] == [item.id for item in key.items]
    for item in content["items"]:
        assert item.keys() in ({"id", "kind", "stimulus"}, {"id", "kind", "pair"})
    assert "stimuli" not in content and "seed" not in content
    for path in (path for path in (study / "site").rglob("*") if path.is_file()):
        for word in (*SYSTEMS, *CLIPS, str(study.parent)):
            assert word.encode() not in path.read_bytes()


def test_the_page_loads_nothing_from_elsewhere(study):
    page = (study / "site" / "index.html").read_text()
    assert "Gestures &amp; &lt;speech&gt;</title>" in page
    [policy] = re.findall(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
    assert "unsafe" not in policy and "http" not in policy
    assert re.findall(r'(?:src|href)="((?!data:,)[^"]+)"', page) == ["study.css", "jspsych.min.js", "study.js"]
    assert "sourceMappingURL" not in (study / "site" / "jspsych.min.js").read_text()
    assert {path.name for path in (study / "site").iterdir()} == {*SCRIPTS, "index.html", "items.json", "media"}


def test_videos_of_a_clip_have_one_camera_and_one_build(tmp_path, write_motions, monkeypatch):
    """The second system is the first with another build, so that nothing in its pictures may differ."""
    folders = write_motions(tmp_path, systems=("first",))
    (tmp_path / "second").mkdir()
    for clip in CLIPS:
        with np.load(tmp_path / "first" / f"{clip}.npz") as arrays:
            np.savez(tmp_path / "second" / f"{clip}.npz", **{**arrays, "positions": 1.2 * arrays["positions"]})
    views = []

    def write(path, motion, sound, *, view, **_):
        views.append((view, len(sound), motion[""].positions.tobytes()))
        path.write_bytes(b"video")

    monkeypatch.setattr(make, "write_video", write)
    make_study([*folders, str(tmp_path / "second")], tmp_path / "study", speech=tmp_path / "speech", attention=0)
    assert len(views) == 4
    assert len(set(views)) == 2  # one for each clip


def test_sound_and_motion_are_cut_to_the_shortest(tmp_path, write_motions):
    folders = write_motions(tmp_path, seconds=2.0)
    shorter = write_motions(tmp_path / "short", systems=("Short",), seconds=1.8)
    systems = name_systems([*folders, *shorter])
    whole = read_sources(systems, speech=tmp_path / "speech")
    assert set(whole.durations.values()) == {1.8}
    cut = read_sources(systems, speech=tmp_path / "speech", clip_seconds=1.5, clips=1)
    assert list(cut.durations.values()) == [1.5]
    [sound] = cut.sounds.values()
    assert abs(sound[-1]) < 1e-6
    assert {motion.num_frames for motions in cut.motions.values() for motion in motions.values()} <= {22, 23}


def test_a_second_sound_of_a_clip_is_named(tmp_path, write_motions, caplog):
    systems = name_systems(write_motions(tmp_path))
    first = min((tmp_path / "speech").iterdir())
    shutil.copy(first, first.with_suffix(".flac"))
    read_sources(systems, speech=tmp_path / "speech")
    assert f"not read, as another is of the same clip: 1, {first.stem}.flac beside {first.name}" in caplog.text


def test_studies_with_other_lists_are_not_the_same(tmp_path, write_motions, monkeypatch):
    monkeypatch.setattr(make, "write_video", lambda path, *_, **__: path.write_bytes(b"video"))
    folders = write_motions(tmp_path, clips=("a", "b", "c", "d"))
    found = {
        read_key(make_study(folders, out, speech=tmp_path / "speech", seed=3, per_participant=count) / "key.json").study
        for count, out in ((3, tmp_path / "few"), (6, tmp_path / "many"))
    }
    assert len(found) == 2


def test_names_are_taken_as_they_are(tmp_path, write_motions, monkeypatch):
    monkeypatch.setattr(make, "write_video", lambda path, *_, **__: path.write_bytes(b"video"))
    clips = ("</script><b>", "a 'b' \"c\"", "x\ny", "a..%2f", "-o", "\udcff")  # the last is no UTF-8
    systems = ("<img src=x>", "=", "$post")
    folders = write_motions(tmp_path, systems=systems, clips=clips)
    options = {"protocol": ("mismatch",), "title": "$title <b>"}
    out = make_study(folders, tmp_path / "study", speech=tmp_path / "speech", **options)
    key = read_key(out / "key.json")
    assert set(key.clips) == set(clips)
    assert set(key.systems) == set(systems)
    assert "<title>$title &lt;b&gt;</title>" in (out / "site" / "index.html").read_text()
    assert {len(path.name) for path in (out / "site" / "media").iterdir()} == {20}


def test_a_list_of_names_and_folders_is_read(tmp_path):
    (tmp_path / "a=b").mkdir()
    found = name_systems(["x", f"HA2G={tmp_path}/x", f"{tmp_path}/a=b"])
    assert list(found) == ["x", "HA2G", "a=b"]
    for wrong, message in ((["x", "y/x"], "two systems have the name x"), (["=x"], "no system"), (["x="], "no system")):
        with pytest.raises(UserError, match=message):
            name_systems(wrong)


def make_with(root, *arguments):
    folders = [str(root / system) for system in SYSTEMS]
    return cli.main(["study", "make", *folders, "--speech", str(root / "speech"), "-o", str(root / "out"), *arguments])


def shorten(path):
    with np.load(path) as arrays:
        np.savez(path, **{name: value[:5] if value.ndim == 3 else value for name, value in arrays.items()})


SPOILT = {
    "Secret Beta has no motion of clip-two, which": lambda root: (root / SYSTEMS[1] / "clip-two.npz").unlink(),
    "no sound of clip-two": lambda root: (root / "speech" / "clip-two.wav").unlink(),
    "0.3 s of motion for 1.2 s of sound": lambda root: shorten(root / SYSTEMS[0] / "clip-one.npz"),
}
WRONG_OPTIONS = {"3 clips of 2": ("--clips", "3"), "even sides": ("--size", "63")}


@pytest.mark.parametrize("message", SPOILT | WRONG_OPTIONS)
def test_bad_input_ends_with_one_line_and_writes_nothing(message, tmp_path, write_motions, capsys):
    write_motions(tmp_path)
    SPOILT.get(message, pathlib.Path)(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert make_with(tmp_path, *(text.format(root=tmp_path) for text in WRONG_OPTIONS.get(message, ()))) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("ha2g: ") and message in line
    assert sorted(tmp_path.iterdir()) == before


def test_addresses_that_answers_may_be_sent_to():
    for address in ("https://x.org/a?b=c", "http://localhost:8000/answers", "http://[::1]:9/"):
        assert read_wording(post=address).post == address
    wrong = ("", "x", "ftp://x.org", "https://", "https://a:b@x.org", "https://x.org/#a", "https://x.org; script-src *")
    for address in (*wrong, "https://x.org:99999999", "https://x.org'", "javascript:alert(1)", "https://ü.org"):
        with pytest.raises(UserError, match="answers cannot be sent to"):
            read_wording(post=address)


def test_texts_of_the_owner_are_paragraphs(tmp_path):
    path = tmp_path / "consent.txt"
    path.write_bytes("\ufeffFirst\r\nline. \r\n\r\n \r\nSecond <b>.\r\n".encode())
    assert read_wording(consent=path).consent == ("First line.", "Second <b>.")
    path.write_bytes(b"\xff")
    with pytest.raises(UserError, match="text in UTF-8"):
        read_wording(consent=path)


def test_jspsych_is_that_of_its_npm_package_and_the_licences_of_all_its_parts_are_there():
    """dist/index.browser.min.js of jspsych 8.3.0."""
    assert hashlib.sha256((ASSETS / "jspsych.min.js").read_bytes()).hexdigest() == JSPSYCH_8_3_0
    text = (ASSETS / "LICENSES.txt").read_text("utf-8")
    for part in ("jsPsych 8.3.0", "auto-bind 4.0.0", "random-words 1.3.0", "seedrandom 3.0.5"):
        assert part in text
    assert text.count("Permission is hereby granted") == 4

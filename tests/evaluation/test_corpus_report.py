"""The page is whole in itself, shows what it promises, and takes no markup from a file."""

import base64
import collections
import dataclasses
import html.parser
import io
import json
import re

import av
import numpy as np
import pytest
from fixtures.corpora import make_clip, write_corpus

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.recording import SplitReport
from ha2g_jax.data.records import encode_clip
from ha2g_jax.evaluation import corpus_report as report
from ha2g_jax.features.text import Word
from ha2g_jax.motion.formats import export
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

EVIL = "<script>alert('&')</script>"
_SKELETON = load_skeleton("ted_expressive")
VOID = {"meta", "br", "img"}


class Page(html.parser.HTMLParser):
    """Elements and text of a page whose tags must be closed in order."""

    def __init__(self, text: str):
        super().__init__()
        self.elements: list[tuple[str, dict]] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(text)
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        self.text += data

    def of(self, tag: str) -> list[dict]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def corpus(tiny_talk, tmp_path_factory):
    """Clips of a second, of three speakers, every name of which is markup."""
    path = tmp_path_factory.mktemp("report") / "corpus"
    clips = Corpus.open(tiny_talk).clips("train")
    report = {EVIL: {"videos": 3, "clips": 4, "windows": 10, "kept": 6, "filtered": {EVIL: 3, "motion": 1},
                     "rejected": {"too short": 1}}}  # fmt: skip
    metadata = {"name": EVIL, "source": EVIL, "licence": EVIL, "import": report, "failed": [{"video": EVIL}]}
    with CorpusWriter(path, splits=("train", "val"), skeleton="ted_expressive", fps=15, metadata=metadata) as writer:
        for number in range(4):
            clip = dataclasses.replace(
                clips[number % len(clips)],
                id=f"{EVIL}{number}",
                speaker=f"{EVIL}{number // 2}",
                words=(Word(EVIL, 0.1, 0.4),),
                positions=clips[number].positions[:45],
                audio=clips[number].audio[:48000],
                window_starts=(0, 10),
            )
            writer.add("train", encode_clip(clip))
    dataset = json.loads((path / "dataset.json").read_text())
    dataset["splits"][EVIL] = dataset["splits"].pop("val")  # as no writer names a split
    (path / "dataset.json").write_text(json.dumps(dataset))
    return path


@pytest.mark.parametrize("speakers", ["AAAB", "AAABBB", "ABCD"])
def test_as_many_clips_as_there_are_are_shown(speakers, tmp_path):
    clips = [make_clip(f"{number}", speaker=speaker) for number, speaker in enumerate(speakers)]
    chosen = report._choose(Corpus.open(write_corpus(tmp_path / "corpus", {"train": clips})), 4)
    assert len({index for _, index in chosen}) == 4


def test_recordings_and_shots_that_were_left_out_are_no_clips():
    rejected = collections.Counter({"too short": 1, "still": 3, "unusable recording": 5})
    text = "".join(report._losses(SplitReport(clips=4, rejected=rejected)))
    assert "kept</th><td>3</td><td>75.0%" in text and "still: 3, unusable recording: 5" in text


@pytest.fixture(autouse=True)
def _small_videos(monkeypatch):
    monkeypatch.setattr(report, "_SAMPLE_SIZE", 64)


def test_a_page_of_its_own(corpus, tmp_path):
    path = report.write_report(corpus, tmp_path / "new" / "report.html", num_samples=2)
    assert path == tmp_path / "new" / "report.html"
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert "<script" not in text
    assert EVIL in page.text
    for tag, attributes in page.elements:
        assert tag not in ("script", "link", "iframe", "object")
        for name in ("src", "href", "poster"):
            assert attributes.get(name, "data:").startswith("data:")
    assert not re.search(r"url\((?!#)|@import|https?://", text)
    for heading in ("Clips", "Splits", "Import", "Speech and clips", "Motion", "Causes"):
        assert f"<h2>{heading}</h2>" in text
    for svg in page.of("svg"):
        assert svg["role"] == "img"
        assert svg["aria-label"]
    # four angles each with two curves, words per minute, length, all angles, speed
    assert len(page.of("svg")) == 8
    assert text.count("Table 10 of the paper") == 4
    assert "60.0%" in page.text  # windows kept
    assert "both wrists almost still" in page.text
    assert "<video" not in report.write_report(corpus, tmp_path / "a.html", num_samples=0).read_text()


def test_clips_to_watch(corpus, tmp_path):
    """Of different speakers, with the sound, as long as the clip."""
    first, second = (
        report.write_report(corpus, tmp_path / name, num_samples=2).read_text() for name in ("a.html", "b.html")
    )
    assert first == second
    videos = Page(first).of("video")
    speakers = {video["aria-label"].split("speaker ")[1] for video in videos}
    assert speakers == {f"{EVIL}0", f"{EVIL}1"}
    for video in videos:
        kind, data = video["src"].split(",")
        assert kind == "data:video/mp4;base64"
        with av.open(io.BytesIO(base64.b64decode(data))) as container:
            assert container.streams.video[0].frames == 90
            assert len(container.streams.audio) == 1


def test_wrists_of_a_known_swing():
    times = np.arange(600) / 15
    motion = np.tile(_SKELETON.mean_pose.astype(np.float64), (600, 1, 1))
    wrists = [_SKELETON.joint("left_wrist"), _SKELETON.joint("right_wrist")]
    motion[:, wrists, 1] += 0.1 * np.sin(2 * np.pi * 0.5 * times)[:, None]  # peak speed 0.314 m/s, 60 peaks a minute
    found = report.wrist_motion(_SKELETON, [motion], 15)
    assert found["speed, m/s, mean"] == pytest.approx(0.2, rel=0.02)
    assert found["strokes per minute and hand"] == pytest.approx(60, abs=3)
    assert found["fraction of time still"] == pytest.approx(2 * np.arcsin(1 / np.pi) / np.pi, abs=0.05)


@pytest.mark.parametrize("suffix", [".npz", ".bvh"])
def test_a_recording_of_another_rate_is_as_fast_as_it_was(tiny_talk, suffix, tmp_path):
    times = np.arange(600)[:, None] / 60
    directions = np.repeat(_SKELETON.mean_directions[None], 600, axis=0)
    directions[:, _SKELETON.bone("left_wrist")] += np.sin(2 * np.pi * 0.5 * times) * [0.0, 0.5, 0.0]
    export(Motion.from_directions(_SKELETON, directions, 60), tmp_path / f"m{suffix}")
    places = report._read_recording(tmp_path / f"m{suffix}", Corpus.open(tiny_talk), {})
    assert report.wrist_motion(_SKELETON, [places], 15)["strokes per minute and hand"] == pytest.approx(30, abs=4)


def test_talk_has_its_causes_and_a_recording_stands_beside_it(tiny_talk, private_data, tmp_path):
    recording = next((private_data / "zeroeggs_067").glob("*.bvh"))
    page = report.write_report(tiny_talk, tmp_path / "a.html", num_samples=0, recording=recording).read_text()
    assert "<h2>Causes</h2>" in page and page.count("data:image/png;base64,") == 1
    assert '<th scope="col">recording</th>' in page and ">recording</text>" in page  # in the table and in the chart

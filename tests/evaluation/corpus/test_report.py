"""The page is whole in itself, shows what it promises, and takes no markup from a file."""

import base64
import dataclasses
import html.parser
import io
import json
import re

import av
import numpy as np
import pytest

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.corpus import report
from ha2g_jax.evaluation.corpus.charts import histogram
from ha2g_jax.features.text import Word

EVIL = "<script>alert('&')</script>"
VOID = {"meta", "br", "rect", "line", "circle", "polyline"}


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
    assert not re.search(r"url\(|@import|https?://", text)
    for heading in ("Clips", "Splits", "Import", "Speech and clips", "Motion"):
        assert f"<h2>{heading}</h2>" in text
    for svg in page.of("svg"):
        assert svg["role"] == "img"
        assert svg["aria-label"]
    # four angles each with two curves, words per minute, length, all angles, speed
    assert len(page.of("svg")) == 8
    assert len(page.of("polyline")) == 8
    assert "60.0%" in page.text  # windows kept
    assert "both wrists almost still" in page.text


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


def test_without_samples(corpus, tmp_path):
    assert "<video" not in report.write_report(corpus, tmp_path / "a.html", num_samples=0).read_text()


def test_refusals(corpus, tmp_path):
    with pytest.raises(UserError, match=r"name it report\.html"):
        report.write_report(corpus, tmp_path / "report")
    with pytest.raises(UserError, match="no corpus in"):
        report.write_report(tmp_path, tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


def test_bars_and_curves_have_one_scale():
    """Bars that count a normal distribution end where the curve of that distribution runs."""
    edges = np.linspace(0, 180, 91)
    counts = 1000 * np.exp(-0.5 * ((edges[:-1] + 1 - 80) / 15) ** 2)
    chart = histogram(
        counts.round().astype(int).tolist(), edges, unit="°", label="x", ticks=(0, 180), curves={"paper": (80, 15)}
    )
    bars = [float(y) for y in re.findall(r'<rect class="bar" x="[\d.]+" y="([\d.]+)"', chart)]
    curve = [float(y) for y in re.findall(r",([\d.]+)", chart.split('points="')[1].split('"')[0])]
    assert len(bars) > 40
    assert len(curve) == 241
    assert min(bars) == pytest.approx(min(curve), abs=2)

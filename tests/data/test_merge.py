"""Corpora become one without a byte of speech or motion lost, and what does not fit is refused with the reason."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from ha2g_jax.data import regroup, validation
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import directions_to_positions, load_skeleton


def make_clip(name: str, speaker: str, word: str, skeleton: str = "ted_gesture") -> Clip:
    bones = load_skeleton(skeleton)
    rng = np.random.default_rng(len(name) + len(word))
    return Clip(
        id=name,
        speaker=speaker,
        audio=(rng.normal(size=48000) / 10).astype(np.float32),
        words=(Word(word, 0.1, 0.4),),
        positions=np.tile(directions_to_positions(bones, bones.mean_directions), (45, 1, 1)),
        reference_images=rng.integers(0, 255, (1, 32, 32, 3), np.uint8),
        recording_start=0.0,
        window_starts=(0, 10),
        recording=f"{name}-file",
    )


def write(path, splits: dict[str, list[Clip]], *, skeleton: str = "ted_gesture", fps: float = 15, metadata=None):
    with CorpusWriter(path, splits=list(splits), skeleton=skeleton, fps=fps, metadata=metadata or {}) as writer:
        for split, clips in splits.items():
            for clip in clips:
                writer.add(split, encode_clip(clip))
    return path


@pytest.fixture
def corpora(tmp_path):
    """Two corpora with the same name of a clip, of its recording and of a speaker."""
    one = {"train": [make_clip("a", "bo", "hello"), make_clip("b", "al", "you")], "val": []}
    two = {"train": [make_clip("a", "bo", "goodbye")], "test": [make_clip("c", "cy", "now")]}
    counts = {"videos": 1, "clips": 2, "windows": 5, "kept": 3, "filtered": {"motion": 2}}
    more = {"videos": 2, "clips": 2, "windows": 2, "kept": 1, "filtered": {"pose": 1}, "rejected": {"too short": 1}}
    first = {"source": "first", "licence": "free", "settings": 3, "import": {"train": counts}}
    second = {"source": "second", "licence": "free", "import": {"train": more, "test": counts}}
    return (
        write(tmp_path / "one", one, metadata=first),
        write(tmp_path / "two", two, metadata=second),
    )


def test_all_clips_are_there_as_they_were(corpora, tmp_path):
    regroup.merge(corpora, tmp_path / "all")
    corpus = Corpus.open(tmp_path / "all")
    assert corpus.splits == ("train", "val", "test")
    names = {
        split: [(clip.id, clip.recording, clip.speaker) for clip in corpus.clips(split)] for split in corpus.splits
    }
    assert names == {
        "train": [
            ("one-a", "one-a-file", "one-bo"),
            ("b", "b-file", "al"),
            ("two-a", "two-a-file", "two-bo"),
        ],
        "val": [],
        "test": [("c", "c-file", "cy")],
    }
    old, new = Corpus.open(corpora[1]).clips("train")[0], corpus.clips("train")[2]
    for field in dataclasses.fields(Clip):
        if field.name not in ("id", "recording", "speaker"):
            np.testing.assert_equal(getattr(new, field.name), getattr(old, field.name))
    assert corpus.clips("test").record(0) == Corpus.open(corpora[1]).clips("test").record(0)
    assert validation.examine(tmp_path / "all") == ([], [])


def test_description(corpora, tmp_path):
    """Sources and licences once each, reports added up, the vocabulary of the new training split."""
    regroup.merge(corpora, tmp_path / "all")
    corpus = Corpus.open(tmp_path / "all")
    assert corpus.metadata["name"] == "all"
    assert corpus.metadata["source"] == "first | second"
    assert corpus.metadata["licence"] == "free"
    assert corpus.metadata["import"]["train"] == {
        "videos": 3,
        "clips": 4,
        "windows": 7,
        "kept": 4,
        "filtered": {"motion": 2, "pose": 1},
        "rejected": {"too short": 1},
    }
    assert corpus.metadata["import"]["test"]["kept"] == 3
    assert corpus.metadata["merged"] == [
        {"folder": "one", "source": "first", "licence": "free", "settings": 3},
        {"folder": "two", "source": "second", "licence": "free"},
    ]
    assert set(corpus.vocabulary().words) == {"hello", "you", "goodbye"}


def test_licences_are_stated_one_by_one(corpora, tmp_path):
    """A licence that nobody has stated stays not stated; the other corpus' licence does not cover it."""
    clip = make_clip("x", "di", "so")
    private = write(tmp_path / "private", {"train": [clip]}, metadata={"licence": "", "source": "a studio"})
    regroup.merge([corpora[0], private], tmp_path / "all")
    metadata = Corpus.open(tmp_path / "all").metadata
    assert metadata["licence"] == "one: free | private: not stated"
    assert [(part["source"], part["licence"]) for part in metadata["merged"]] == [
        ("first", "free"),
        ("a studio", "not stated"),
    ]


def test_speakers_of_one_name_may_be_one_person(corpora, tmp_path):
    regroup.merge(corpora, tmp_path / "all", same_speakers=True)
    assert Corpus.open(tmp_path / "all").speakers == ("bo", "al", "cy")


def test_folders_of_one_name(corpora, tmp_path):
    (tmp_path / "other").mkdir()
    shutil.copytree(corpora[0], tmp_path / "other" / "one")
    regroup.merge([corpora[0], tmp_path / "other" / "one"], tmp_path / "all")
    assert [clip.id for clip in Corpus.open(tmp_path / "all").clips("train")] == [
        "one-a",
        "one-b",
        "one-2-a",
        "one-2-b",
    ]


def test_what_does_not_fit_is_refused(corpora, tmp_path):
    expressive = write(
        tmp_path / "expressive", {"train": [make_clip("x", "di", "so", "ted_expressive")]}, skeleton="ted_expressive"
    )
    slow = write(tmp_path / "slow", {"train": [make_clip("x", "di", "so")]}, fps=25)
    clash = write(tmp_path / "clash", {"train": [make_clip("two-a", "di", "so")]})
    cases = {
        r"one has skeleton ted_gesture \(10 joints\), .*expressive ted_expressive \(43\); merge corpora of one": [
            corpora[0],
            expressive,
        ],
        "one has 15 frames a second, .*slow 25": [corpora[0], slow],
        "is given twice": [corpora[0], corpora[1], tmp_path / "one" / ".." / "one"],
        "1 corpus to merge; give at least two": corpora[:1],
        "give the folder two another name": [*corpora, clash],
        "no corpus in": [corpora[0], tmp_path / "nowhere"],
    }
    for message, given in cases.items():
        with pytest.raises(UserError, match=message):
            regroup.merge(given, tmp_path / "all")
    with pytest.raises(UserError, match="exists already"):
        regroup.merge(corpora, corpora[0])
    assert not (tmp_path / "all").exists()


def test_a_damaged_import_report(corpora, tmp_path):
    dataset = json.loads((corpora[0] / "dataset.json").read_text())
    (corpora[0] / "dataset.json").write_text(json.dumps({**dataset, "import": {"train": {"kilos": 3}}}))
    with pytest.raises(UserError, match="damaged import report"):
        regroup.merge(corpora, tmp_path / "all")

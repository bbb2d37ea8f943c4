"""Corpora become one without a byte lost, and are divided into splits that share no recording, always alike."""

import collections
import dataclasses
import hashlib
import shutil

import numpy as np
import pytest
from fixtures.corpora import make_clip, write_corpus
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.data import regroup, validation
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import directions_to_positions, load_skeleton


def saying(name: str, speaker: str, word: str, skeleton: str = "ted_gesture") -> Clip:
    sound = make_clip(name + word).audio
    words = (Word(word, 0.1, 0.4),)
    return make_clip(name, skeleton=skeleton, speaker=speaker, audio=sound, words=words, recording=f"{name}-file")


@pytest.fixture
def corpora(tmp_path):
    """Two corpora with the same name of a clip, of its recording and of a speaker."""
    one = {"train": [saying("a", "bo", "hello"), saying("b", "al", "you")], "val": []}
    two = {"train": [saying("a", "bo", "goodbye")], "test": [saying("c", "cy", "now")]}
    counts = {"videos": 1, "clips": 2, "windows": 5, "kept": 3, "filtered": {"motion": 2}}
    more = {"videos": 2, "clips": 2, "windows": 2, "kept": 1, "filtered": {"pose": 1}, "rejected": {"too short": 1}}
    first = {"source": "first", "licence": "free", "settings": 3, "import": {"train": counts}}
    second = {"source": "second", "licence": "free", "import": {"train": more, "test": counts}}
    return (
        write_corpus(tmp_path / "one", one, metadata=first),
        write_corpus(tmp_path / "two", two, metadata=second),
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
    one, two = (hashlib.sha256((path / "dataset.json").read_bytes()).hexdigest() for path in corpora)
    assert corpus.metadata["merged"] == [
        {"folder": "one", "source": "first", "licence": "free", "settings": 3, "sha256": one},
        {"folder": "two", "source": "second", "licence": "free", "sha256": two},
    ]
    assert set(corpus.vocabulary().words) == {"hello", "you", "goodbye"}


def test_licences_are_stated_one_by_one(corpora, tmp_path):
    """A licence that nobody has stated stays not stated; the other corpus' licence does not cover it."""
    clip = saying("x", "di", "so")
    private = write_corpus(tmp_path / "private", {"train": [clip]}, metadata={"licence": "", "source": "a studio"})
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


def test_a_recording_in_two_corpora_of_the_same_speakers_stays_one(corpora, tmp_path):
    regroup.merge(corpora, tmp_path / "all", same_speakers=True)
    names = [(clip.id, clip.recording) for clip in Corpus.open(tmp_path / "all").clips("train")]
    assert names == [("one-a", "a-file"), ("b", "b-file"), ("two-a", "a-file")]


def test_folders_of_one_name(corpora, tmp_path):
    (tmp_path / "other").mkdir()
    shutil.copytree(corpora[1], tmp_path / "other" / "one")
    regroup.merge([corpora[0], tmp_path / "other" / "one"], tmp_path / "all")
    assert [clip.id for clip in Corpus.open(tmp_path / "all").clips("train")] == [
        "one-a",
        "b",
        "one-2-a",
    ]


def test_clips_that_are_in_a_part_already_are_refused(corpora, tmp_path):
    """A later division would put equal clips into training and test."""
    regroup.merge(corpora, tmp_path / "both")
    regroup.divide(tmp_path / "both", tmp_path / "divided", fractions={"train": 0.5, "test": 0.5})
    shutil.copytree(corpora[0], tmp_path / "copy")
    for others in ([corpora[0]], [tmp_path / "copy"], [tmp_path / "divided"]):
        with pytest.raises(UserError, match="have the same clips"):
            regroup.merge([tmp_path / "both", *others], tmp_path / "all")
    assert not (tmp_path / "all").exists()


def test_a_clip_of_two_corpora_is_refused_whatever_its_names(corpora, tmp_path):
    """Or what a model is tested with would be in its training."""
    renamed = dataclasses.replace(saying("a", "bo", "hello"), id="z", speaker="zoe", recording="z-file")
    other = write_corpus(tmp_path / "other", {"train": [saying("x", "di", "so")], "test": [renamed]})
    with pytest.raises(UserError, match=r"clip 'z' of test in .*other has .* of clip 'a' of train in .*one, "):
        regroup.merge([corpora[0], other], tmp_path / "all")
    assert not (tmp_path / "all").exists()


def test_what_does_not_fit_is_refused(corpora, tmp_path):
    expressive = write_corpus(
        tmp_path / "expressive", {"train": [saying("x", "di", "so", "ted_expressive")]}, skeleton="ted_expressive"
    )
    clash = write_corpus(tmp_path / "clash", {"train": [saying("two-a", "di", "so")]})
    cases = {
        r"one has skeleton ted_gesture \(10 joints\), .*expressive ted_expressive \(43\); merge corpora of one": [
            corpora[0],
            expressive,
        ],
        "is given twice": [corpora[0], corpora[1], tmp_path / "one" / ".." / "one"],
        "give the folder two another name": [*corpora, clash],
    }
    for message, entry in cases.items():
        with pytest.raises(UserError, match=message):
            regroup.merge(entry, tmp_path / "all")
    with pytest.raises(UserError, match="exists already"):
        regroup.merge(corpora, corpora[0])
    assert not (tmp_path / "all").exists()


SKELETON = load_skeleton("ted_gesture")


def make_recorded(number: int, frames: int) -> Clip:
    """Two clips per recording, four recordings per speaker."""
    return make_clip(
        f"clip-{number}",
        speaker=f"speaker-{number // 8}",
        audio=np.zeros(frames * 16000 // 15, np.float32),
        positions=np.tile(directions_to_positions(SKELETON, SKELETON.mean_directions), (frames, 1, 1)),
        recording_start=(number % 2) * 100.0,
        window_starts=(0,),
        recording=f"recording-{number // 2}",
    )


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """40 clips of 20 recordings of 5 speakers, of 3 to 6 seconds; every recording is in both splits."""
    path = tmp_path_factory.mktemp("division") / "original"
    lengths = np.random.default_rng(0).integers(45, 90, 40)
    report = {"train": {"videos": 20, "clips": 40, "windows": 40, "kept": 40, "filtered": {}}}
    metadata = {"name": "original", "import": report}
    clips = [make_recorded(number, int(length)) for number, length in enumerate(lengths)]
    return write_corpus(path, {"train": clips[::2], "dev": clips[1::2]}, metadata=metadata)


def owners(corpus: Corpus, field: str) -> dict[str, set[str]]:
    """The splits in which each recording or speaker occurs."""
    found = collections.defaultdict(set)
    for split in corpus.splits:
        for clip in corpus.clips(split):
            found[getattr(clip, field)].add(split)
    return found


@pytest.mark.parametrize("by", ["recording", "speaker"])
def test_nothing_is_divided_and_nothing_lost(original, tmp_path, by):
    regroup.divide(original, tmp_path / "out", by=by, fractions={"train": 0.6, "val": 0.2, "test": 0.2})
    corpus = Corpus.open(tmp_path / "out")
    assert corpus.splits == ("train", "val", "test")
    for field in ("recording", by):
        assert all(len(splits) == 1 for splits in owners(corpus, field).values())
    assert sorted(clip.id for split in corpus.splits for clip in corpus.clips(split)) == sorted(
        f"clip-{number}" for number in range(40)
    )
    assert corpus.metadata["name"] == "original"
    assert corpus.metadata["import"]["train"]["kept"] == 40
    assert corpus.metadata["division"]["by"] == {"recording": "talk", "speaker": "speaker"}[by]
    assert validation.examine(tmp_path / "out") == ([], [])


def test_fractions_are_met(original, tmp_path):
    """20 recordings of about 9 seconds each: the error of a split is far less than a recording."""
    regroup.divide(original, tmp_path / "out", seed=3)
    splits = Corpus.open(tmp_path / "out").metadata["splits"]
    seconds = {split: entry["seconds"] for split, entry in splits.items()}
    for split, fraction in regroup.FRACTIONS.items():
        assert seconds[split] / sum(seconds.values()) == pytest.approx(fraction, abs=0.015)


def test_the_seed_decides(original, tmp_path):
    for name, seed in {"first": 0, "again": 0, "other": 1}.items():
        regroup.divide(original, tmp_path / name, seed=seed)
    for file in (tmp_path / "first").iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()
    first, other = (owners(Corpus.open(tmp_path / name), "recording") for name in ("first", "other"))
    assert first != other


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.lists(st.floats(0.5, 5000), min_size=3, max_size=40),
    st.lists(st.floats(0.01, 1), min_size=1, max_size=3),
    st.integers(0, 5),
)
def test_every_split_has_something(lengths, parts, seed):
    """Each recording is in one split, no split is empty, and moving one recording does not improve the fractions."""
    seconds = {f"recording-{number}": length for number, length in enumerate(lengths)}
    fractions = {f"split-{number}": part / sum(parts) for number, part in enumerate(parts)}
    assigned = regroup.assign(seconds, fractions, seed)
    assert set(assigned) == set(seconds)
    assert set(assigned.values()) == set(fractions)
    whole = sum(lengths)

    def error(splits: dict[str, str]) -> float:
        filled = dict.fromkeys(fractions, 0.0)
        for name, split in splits.items():
            filled[split] += seconds[name]
        return sum((filled[split] - fraction * whole) ** 2 for split, fraction in fractions.items())

    members = collections.Counter(assigned.values())
    reached = error(assigned)
    for name, split in assigned.items():
        for other in fractions:
            if members[split] > 1 and other != split and reached > 3 * (0.005 * whole) ** 2:
                assert error(assigned | {name: other}) >= reached * (1 - 1e-6) - 1e-6


def test_a_split_without_a_fraction_is_left_out(original, tmp_path):
    regroup.divide(original, tmp_path / "out", fractions={"train": 3, "test": 1, "val": 0})
    assert Corpus.open(tmp_path / "out").splits == ("train", "test")

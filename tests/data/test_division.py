"""Recordings and speakers stay whole, fractions are met, and the same seed gives the same bytes."""

import collections

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.data import regroup, validation
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import directions_to_positions, load_skeleton

SKELETON = load_skeleton("ted_gesture")


def make_clip(number: int, frames: int) -> Clip:
    """Two clips per recording, four recordings per speaker."""
    return Clip(
        id=f"clip-{number}",
        speaker=f"speaker-{number // 8}",
        audio=np.zeros(frames * 16000 // 15, np.float32),
        words=(),
        positions=np.tile(directions_to_positions(SKELETON, SKELETON.mean_directions), (frames, 1, 1)),
        reference_images=None,
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
    with CorpusWriter(path, splits=("train", "dev"), skeleton=SKELETON.name, fps=15, metadata=metadata) as writer:
        for split in (0, 1):
            for number in range(split, 40, 2):
                writer.add(("train", "dev")[split], encode_clip(make_clip(number, int(lengths[number]))))
    return path


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


def test_refusals(original, tmp_path):
    cases = {
        "has 5 speakers, too few for 6 splits": {"by": "speaker", "fractions": {str(part): 1 for part in range(6)}},
        "cannot be divided by 'clip'; expected one of recording, speaker": {"by": "clip"},
        "expected numbers of at least 0": {"fractions": {"train": -1, "val": 2}},
        "not all of them 0": {"fractions": {"train": 0}},
    }
    for message, arguments in cases.items():
        with pytest.raises(UserError, match=message):
            regroup.divide(original, tmp_path / "out", **arguments)
    with pytest.raises(UserError, match="exists already"):
        regroup.divide(original, original)
    assert list(tmp_path.iterdir()) == []


def test_a_split_without_a_fraction_is_left_out(original, tmp_path):
    regroup.divide(original, tmp_path / "out", fractions={"train": 3, "test": 1, "val": 0})
    assert Corpus.open(tmp_path / "out").splits == ("train", "test")

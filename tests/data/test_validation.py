"""A sound corpus has no findings, and every kind of damage has one that names the clip."""

import re
from collections.abc import Sequence

import numpy as np
import pytest
from fixtures.corpora import append_records, make_clip

from ha2g_jax.data import validation
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_gesture")
FRAMES = 45


def plausible(name: str, recording: str = "", time: float = 0.0, **changes) -> Clip:
    """A clip with all that is examined, confidence included."""
    confidence = np.full((FRAMES, SKELETON.num_joints), 0.5, np.float32)
    found = {"recording": recording or name, "recording_start": time, "confidence": confidence} | changes
    return make_clip(name, **found)


def write(path, **splits: Sequence[Clip]):
    """Write a corpus; clips that the writer refuses come to the end of their split."""
    refused: dict[str, list[bytes]] = {}
    with CorpusWriter(path, splits=list(splits), skeleton=SKELETON.name, fps=15, metadata={}) as writer:
        for split, clips in splits.items():
            for record in map(encode_clip, clips):
                try:
                    writer.add(split, record)
                except UserError:
                    refused.setdefault(split, []).append(record)
    for split, records_of_split in refused.items():
        append_records(path, split, records_of_split)
    return path


def test_talk_is_well(tiny_talk):
    assert validation.examine(tiny_talk) == ([], [])


CLIP = plausible("bad")
BENT = CLIP.positions.copy()
BENT[7, 3, 1] = np.nan
CONFIDENT = np.full((FRAMES, SKELETON.num_joints), 1.5, np.float32)


@pytest.mark.parametrize(
    ("record", "finding"),
    [
        (plausible("bad", positions=BENT), "NaN or infinite, first in frame 7"),
        (plausible("bad", positions=CLIP.positions * 100), r"9 of 9 bones of implausible length, .* of \d+ m"),
        (plausible("bad", words=CLIP.words[::-1]), "words out of order: 'one' at 0.10 s after 'two'"),
        (
            plausible("bad", words=(Word("one", 2.9, 3.2),)),
            "word 'one' at 2.90 to 3.20 s lies outside the clip of 3.00",
        ),
        (plausible("bad", words=(Word("one", 0.5, 0.2),)), "word 'one' from 0.50 to 0.20 s is empty"),
        (plausible("bad", audio=np.zeros(40000, np.float32)), "2.50 s of audio for 3.00 s of motion"),
        (plausible("bad", window_starts=(0, 45)), "1 windows outside its 45 frames, one at frame 45"),
        (plausible("bad", window_starts=(3, 3)), "the same window twice"),
        (plausible("bad", confidence=CONFIDENT), "confidence outside 0 to 1"),
        (plausible("bad", confidence=CONFIDENT[1:]), "confidence of shape"),
        (plausible("good"), "its id occurs more than once"),
    ],
)
def test_a_bad_clip_is_found_and_named(tmp_path, record, finding):
    """A clip that is bad in one way has one finding, with the clip and its record in it; the other clips have none."""
    with np.errstate(invalid="ignore"):
        path = write(tmp_path / "corpus", val=[plausible("good"), record])
    found = validation.examine(path).findings
    assert len(found) == 1
    assert "record 1 of" in found[0]
    assert "clip 'bad'" in found[0] or "clip 'good'" in found[0]
    assert "\n" not in found[0]
    assert re.search(finding, found[0])


def test_damaged_speech_and_images_are_found(tmp_path):
    records = [encode_clip(plausible(name)) for name in ("speech", "image")]
    damaged = [records[0].replace(b"fLaC", b"nope"), records[1].replace(b"\xff\xd8\xff", b"nojpeg"[:3])]
    path = write(tmp_path / "corpus", val=[plausible("good")])
    append_records(path, "val", damaged)
    found = validation.examine(path).findings
    assert len(found) == 2 and all(f"clip {name}" in line for name, line in zip(("speech", "image"), found))


def test_a_damaged_shard_does_not_hide_the_others(tmp_path, monkeypatch):
    monkeypatch.setattr("ha2g_jax.data.corpus_writer._CLIPS_PER_SHARD", 1)
    path = write(tmp_path / "corpus", train=[plausible("a"), plausible("b")])
    shard = path / "train-00000.array_record"
    shard.write_bytes(bytes(shard.stat().st_size))
    found = validation.examine(path).findings
    assert any("train-00000" in text and "SHA-256" in text for text in found)
    assert any("train-00000" in text and "cannot be read" in text for text in found)
    assert len(found) == 2


def test_a_flipped_bit_anywhere_in_a_shard_is_found(tmp_path):
    """ArrayRecord's own checksums do not cover padding, so the digest in dataset.json must be compared."""
    path = write(tmp_path / "corpus", train=[plausible("a"), plausible("b")])
    shard = path / "train-00000.array_record"
    data = shard.read_bytes()
    # Block and chunk headers are at the start of each 64 KiB, records behind the first, the index at the end.
    starts = range(0, len(data), 1 << 16)
    places = {0, 8, 24, 63, 64, 70, 100, 400, len(data) // 2, len(data) - 40, len(data) - 1}
    places |= {start + shift for start in starts for shift in (0, 5, 16, 24, 40, 200)}
    for place in sorted(places):
        shard.write_bytes(data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :])
        found = validation.examine(path).findings
        assert any("train-00000" in text and "SHA-256" in text for text in found), place
        assert all("\n" not in text for text in found)


def test_recordings_in_two_splits(tmp_path):
    """Other stretches of one recording are a note, as TED's splits have them; the same stretch is a finding."""
    train = [plausible("a", "recording", 0), plausible("b", "recording", 30)]
    apart = write(tmp_path / "apart", train=train, test=[plausible("c", "recording", 10)])
    findings, notes = validation.examine(apart)
    assert findings == []
    assert len(notes) == 1
    assert "1 of 1 recordings" in notes[0]
    shared = write(tmp_path / "shared", train=train, test=[plausible("c", "recording", 31)])
    findings, _ = validation.examine(shared)
    assert len(findings) == 1
    assert "clips 'b' and 'c'" in findings[0]


def test_bones_that_change_are_noted_unless_they_were_estimated(tmp_path):
    breathing = CLIP.positions * np.linspace(0.8, 1.2, FRAMES)[:, None, None]
    captured = plausible("captured", positions=breathing, confidence=None)
    estimated = plausible("estimated", positions=breathing)
    findings, notes = validation.examine(write(tmp_path / "corpus", train=[captured, estimated]))
    assert findings == []
    assert len(notes) == 1
    assert "in 1 of 2 clips" in notes[0]
    assert "'captured'" in notes[0]

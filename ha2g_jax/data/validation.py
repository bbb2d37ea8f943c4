"""Validation of a corpus: the checksums of its files, every record, and the counts of `dataset.json`.

A finding is an error that makes training or its scores wrong. A note is a property of the data that is worth knowing
but common: the splits of TED, for example, have clips of the same videos.
"""

import collections
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import clip_checks, schema
from ha2g_jax.data.corpus import FILE, TRAIN, Clips, Corpus
from ha2g_jax.data.corpus_writer import MotionStatistics
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, reading, shown

_CONSTANT = 0.05  # maximum standard deviation of a bone's length over its median, within a clip
_OVERLAP = 0.5  # seconds of one recording that two splits may have in common, because cuts are rounded to frames
_ROUNDING = 0.01  # tolerance of the duration of a split in seconds, which is stored rounded
_STATISTICS_RTOL, _STATISTICS_ATOL = 1e-3, 1e-4  # tolerance of the statistics, which other machines round otherwise
_MAX_SHOWN = 60  # characters of a name in a message


class _Stretch(NamedTuple):
    """The stretch of a recording that a clip covers, in seconds."""

    start: float
    end: float
    split: str
    clip: str


class Tally:
    """Counts, ids, recordings, statistics and bone lengths over the whole corpus.

    Attributes:
        unread: splits with records that could not be read, whose counts are therefore not compared.
    """

    def __init__(self, corpus: Corpus):
        self._corpus, self.skeleton = corpus, corpus.skeleton
        self._statistics = MotionStatistics(self.skeleton, corpus.fps)
        self.unread: set[str] = set()
        self._ids: set[str] = set()
        self._counts: dict[str, dict[str, float]] = {
            split: {"clips": 0, "windows": 0, "seconds": 0.0} for split in corpus.splits
        }
        self._speakers: dict[str, set[str]] = {split: set() for split in corpus.splits}
        self._words: collections.Counter[str] = collections.Counter()
        self._recordings: dict[str, list[_Stretch]] = collections.defaultdict(list)
        self._uneven, self._most_uneven = 0, (0.0, "")

    def add(self, split: str, fields: dict[str, Any]) -> Iterator[str]:
        """Count a clip and yield the findings that depend on the clips before it."""
        seconds = len(fields["positions"]) / self._corpus.fps
        for what, count in {"clips": 1, "windows": len(fields["window_starts"]), "seconds": seconds}.items():
            self._counts[split][what] += count
        self._speakers[split].add(fields["speaker"])
        if split == TRAIN:
            self._words.update(word.text.lower() for word in fields["words"])
            self._statistics.update(fields["positions"], fields["window_starts"])
        if fields["recording"]:
            start = fields["recording_start"]
            self._recordings[fields["recording"]].append(_Stretch(start, start + seconds, split, fields["id"]))
        if fields["id"] in self._ids:
            yield "its id occurs more than once"
        self._ids.add(fields["id"])
        if fields["speaker"] not in self._corpus.speakers:
            yield f"speaker {fields['speaker'][:_MAX_SHOWN]!r} is not among those of dataset.json"

    def add_bones(self, place: str, fields: dict[str, Any]) -> None:
        """Record the variation of the bone lengths of a clip, unless its positions were estimated."""
        if fields["confidence"] is not None:
            return
        lengths = clip_checks.bone_lengths(fields["positions"], self.skeleton)
        spread = lengths.std(axis=0) / np.median(lengths, axis=0)
        worst = int(spread.argmax())
        self._uneven += bool(spread[worst] > _CONSTANT)
        text = f"{clip_checks.bone_name(self.skeleton, worst)} by {spread[worst]:.0%} in {place}"
        self._most_uneven = max(self._most_uneven, (float(spread[worst]), text))

    def findings(self) -> Iterator[str]:
        name, is_odd = shown(self._corpus.path / FILE), False
        for split, counts in self._counts.items():
            if split in self.unread:
                continue
            entry = self._corpus.metadata["splits"][split]
            for what, tolerance in {"clips": 0, "windows": 0, "seconds": _ROUNDING}.items():
                found, listed = counts[what], entry[what]
                if abs(found - listed) > tolerance:
                    yield f"{name} counts {listed} {what} in {split!r}, but its records have {round(found, 3)}"
            if set(entry["speakers"]) != self._speakers[split]:
                is_odd = True
                yield f"{name} lists other speakers of {split!r} than its records have"
        if TRAIN not in self.unread and dict(self._words) != self._corpus.metadata["words"]:
            yield f"{name} lists other words than the records of {TRAIN!r} have"
        is_known = not self.unread and not is_odd
        if is_known and set().union(*self._speakers.values()) != set(self._corpus.speakers):
            yield f"{name} lists other speakers than the records have"
        if TRAIN not in self.unread and (other := self._other_statistics()):
            yield f"{name} has other {', '.join(other)} than the records of {TRAIN!r}"
        for recording, stretches in self._recordings.items():
            shared = _shared_stretch(stretches)
            if shared is not None:
                first, second = shared
                yield (
                    f"{self._corpus.path}: {first.split!r} and {second.split!r} have the same stretch of recording "
                    f"{recording!r} (clips {first.clip!r} and {second.clip!r}); divide the corpus with ha2g data split"
                )

    def _other_statistics(self) -> list[str]:
        """Return the names of the statistics that differ from those of the records."""
        found, listed = self._statistics.result(), schema.statistics(self._corpus.metadata)
        if not listed.keys() <= found.keys():
            return sorted(listed.keys() - found.keys())
        return [
            name
            for name, values in listed.items()
            if not np.allclose(values, np.array(found[name]), rtol=_STATISTICS_RTOL, atol=_STATISTICS_ATOL)
        ]

    def notes(self) -> list[str]:
        splits = {name: {stretch.split for stretch in stretches} for name, stretches in self._recordings.items()}
        divided = [name for name, names in splits.items() if len(names) > 1]
        notes = []
        if divided:
            notes.append(
                f"{len(divided)} of {len(splits)} recordings have clips in several splits, such as {divided[0]!r}, so "
                "their speakers are known from training; ha2g data split --by recording keeps recordings together"
            )
        if self._uneven:
            notes.append(
                f"bones change their length by more than {_CONSTANT:.0%} in {self._uneven} of {len(self._ids)} clips, "
                f"most {self._most_uneven[1]}; in motion capture they should be constant"
            )
        return notes


def _shared_stretch(stretches: list[_Stretch]) -> tuple[_Stretch, _Stretch] | None:
    """Return two overlapping stretches of a recording in different splits, None if there are none."""
    farthest: dict[str, _Stretch] = {}  # the stretch so far that ends last, by split
    for stretch in sorted(stretches):
        for split, other in farthest.items():
            if split != stretch.split and min(other.end, stretch.end) - stretch.start > _OVERLAP:
                return other, stretch
        if stretch.split not in farthest or stretch.end > farthest[stretch.split].end:
            farthest[stretch.split] = stretch
    return None


class Verdict(NamedTuple):
    """Result of a validation, one line for each finding or note."""

    findings: list[str]
    notes: list[str]


def validate(path: str | os.PathLike) -> list[str]:
    """Return the findings of `examine`, which are empty for a valid corpus."""
    return examine(path).findings


def examine(path: str | os.PathLike) -> Verdict:
    """Examine all shards and records of a corpus.

    Findings: the bytes of a shard differ from its SHA-256; a record cannot be read, or has fields of wrong types;
    positions are not finite, have a wrong shape, or have bones of implausible length (median over the clip, more than
    a factor of 4 from the skeleton's published length); words are out of order or outside the clip; audio is not
    finite or not as long as the motion; windows lie outside the clip; confidence has a wrong shape or lies outside
    [0, 1]; images cannot be read; a clip id occurs twice; a speaker is not listed; the same stretch of a recording
    occurs in two splits; counts, words, speakers or statistics differ from `dataset.json`.

    Notes: different stretches of a recording occur in several splits; bones change their length
    although the positions were not estimated (bones have constant lengths in motion capture, but not in estimates).

    Raises:
        UserError: there is no corpus, or its `dataset.json` cannot be used.
    """
    corpus = Corpus.open(path)
    findings, tally = [*_damaged_shards(corpus)], Tally(corpus)
    total = sum(entry["clips"] for entry in corpus.metadata["splits"].values())
    with tqdm(desc="Checking clips", total=total, unit="clip", leave=False, disable=None) as progress:
        for split in corpus.splits:
            for shard in corpus.metadata["splits"][split]["shards"]:
                try:  # one shard at a time, so that the others are checked if one is damaged
                    clips = Clips([corpus.path / shard["name"]], tally.skeleton, corpus.fps)
                except UserError as error:
                    findings.append(str(error))
                    tally.unread.add(split)
                    continue
                for index in range(len(clips)):
                    findings += _check_record(clips, index, split, tally)
                    progress.update()
    return Verdict([*findings, *tally.findings()], tally.notes())


def _damaged_shards(corpus: Corpus) -> Iterator[str]:
    shards = [shard for entry in corpus.metadata["splits"].values() for shard in entry["shards"]]
    for shard in tqdm(shards, desc="Checking shards", unit="shard", leave=False, disable=None):
        path = corpus.path / shard["name"]
        with reading(path, "a shard of a corpus"):
            digest = file_sha256(path)
        if digest != shard["sha256"]:
            yield f"{shown(path)} has SHA-256 {digest[:12]}..., dataset.json says {shard['sha256'][:12]}..."


def _check_record(clips: Clips, index: int, split: str, tally: Tally) -> list[str]:
    """Return the findings of one record, each with the name of the clip and of the record."""
    try:
        fields = clips.fields(index)
    except UserError as error:
        tally.unread.add(split)
        return [str(error)]
    place = clips.title(fields, index)
    found = [*clip_checks.check_positions(fields["positions"], tally.skeleton)]
    if not found:
        tally.add_bones(place, fields)
    found += tally.add(split, fields)
    found += clip_checks.check_fields(fields, len(fields["positions"]) / clips.fps, clips.fps)
    return [f"{place}: {finding}" for finding in found]

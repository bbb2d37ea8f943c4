"""Validation of a corpus: findings are errors that harm training or its scores, notes are common properties."""

import collections
import itertools
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.data import records
from ha2g_jax.data.corpus import Clips, Corpus
from ha2g_jax.data.corpus_writer import unusable_positions
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import file_sha256, reading, shown
from ha2g_jax.progress import progress_bar, track
from ha2g_jax.skeleton import Skeleton, bone_lengths, load_skeleton

# Allowed factor between the length of a bone and its published mean; a wrong unit is a factor of 10 or more.
_LENGTH_FACTOR = 4
_CONSTANT = 0.05  # maximum standard deviation of a bone's length over its median, within a clip
_WORD_SLACK = 0.1  # seconds by which a word may lie outside the clip, because aligners and video frames round
_AUDIO_SLACK = 0.25  # seconds allowed between the ends of motion and audio
_OVERLAP = 0.5  # seconds of one recording that two splits may have in common, because cuts are rounded to frames


class Verdict(NamedTuple):
    """Result of a validation, one line for each finding or note."""

    findings: list[str]
    notes: list[str]


def examine(path: str | os.PathLike) -> Verdict:
    """Check all shards and records of a corpus.

    Findings: the bytes of a shard differ from its SHA-256; a record cannot be read; positions are not finite, have a
    wrong shape, or have bones of implausible length (median over the clip, more than a factor of 4 from the skeleton's
    published length); words are out of order or outside the clip; audio is not as long as the motion; windows lie
    outside the clip; confidence has a wrong shape or lies outside [0, 1]; images cannot be read; a clip id occurs
    twice; the same stretch of a recording occurs in two splits.

    Notes: different stretches of a recording occur in several splits; bones change their length although the positions
    were not estimated (bones have constant lengths in motion capture, but not in estimates).

    Raises:
        UserError: there is no corpus, or its `dataset.json` cannot be used.
    """
    corpus = Corpus.open(path)
    findings, tally = [*_damaged_shards(corpus)], _Tally(corpus)
    with progress_bar("checking clips", corpus.num_clips, "clip") as bar:
        for split in corpus.splits:
            for shard in corpus.metadata["splits"][split]["shards"]:
                try:  # one shard at a time, so that the others are checked if one is damaged
                    clips = Clips([corpus.path / shard["name"]], corpus.fps)
                except UserError as error:
                    findings.append(str(error))
                    continue
                for index in range(len(clips)):
                    findings += _check_record(clips, index, split, tally)
                    bar.update()
    return Verdict([*findings, *tally.findings()], tally.notes())


def _damaged_shards(corpus: Corpus) -> Iterator[str]:
    shards = [shard for entry in corpus.metadata["splits"].values() for shard in entry["shards"]]
    for shard in track(shards, "checking shards", "shard"):
        path = corpus.path / shard["name"]
        with reading(path, "a shard of a corpus"):
            digest = file_sha256(path)
        if digest != shard["sha256"]:
            yield f"{shown(path)} has SHA-256 {digest[:12]}..., dataset.json says {shard['sha256'][:12]}..."


def _check_record(clips: Clips, index: int, split: str, tally: "_Tally") -> list[str]:
    try:
        fields = clips.fields(index)
    except UserError as error:
        return [str(error)]
    place, positions = clips.title(fields, index), fields["positions"]
    if found := unusable_positions(positions, tally.skeleton):
        return [f"{place} has {found}"]
    seconds = len(positions) / clips.fps
    lengths = bone_lengths(tally.skeleton, positions.astype(np.float64))
    findings = [
        *_check_lengths(lengths, tally.skeleton),
        *tally.add(split, place, fields, lengths),
        *_check_words(fields, seconds, max(_WORD_SLACK, 0.5 / clips.fps)),
        *_check_windows(fields),
        *_check_confidence(fields),
    ]
    try:
        num_samples = len(records.decode_audio(fields, clips.place(index)))
        if abs(num_samples / SAMPLE_RATE - seconds) > max(_AUDIO_SLACK, 0.5 / clips.fps + 0.01):
            findings.append(f"{num_samples / SAMPLE_RATE:.2f} s of audio for {seconds:.2f} s of motion")
        records.decode_images(fields, clips.place(index))
    except UserError as error:
        return [*(f"{place}: {finding}" for finding in findings), str(error)]
    return [f"{place}: {finding}" for finding in findings]


def _check_lengths(lengths: np.ndarray, skeleton: Skeleton) -> Iterator[str]:
    median = np.median(lengths, axis=0)
    expected = load_skeleton(skeleton.name).lengths.astype(np.float64)
    factor = np.maximum(median, 1e-12) / expected
    is_odd = (factor < 1 / _LENGTH_FACTOR) | (factor > _LENGTH_FACTOR)
    if is_odd.any():
        worst = int(np.abs(np.log(factor)).argmax())
        yield (
            f"{is_odd.sum()} of {len(is_odd)} bones of implausible length, {_bone_name(skeleton, worst)} of "
            f"{median[worst]:.4g} m (expected {expected[worst] / _LENGTH_FACTOR:.2g} to "
            f"{expected[worst] * _LENGTH_FACTOR:.2g} m)"
        )


def _check_words(fields: dict[str, Any], seconds: float, slack: float) -> Iterator[str]:
    words = fields["words"]
    for before, word in itertools.pairwise(words):
        if word.start < before.start:
            yield f"words out of order: {word.text!r} at {word.start:.2f} s after {before.text!r}"
            break
    for word in words:
        if not word.text.strip() or word.end < word.start:
            yield f"word {word.text!r} from {word.start:.2f} to {word.end:.2f} s is empty"
            break
    for word in words:
        if word.start < -slack or word.end > seconds + slack:
            yield f"word {word.text!r} at {word.start:.2f} to {word.end:.2f} s lies outside the clip of {seconds:.2f} s"
            break


def _check_windows(fields: dict[str, Any]) -> Iterator[str]:
    starts, frames = fields["window_starts"], len(fields["positions"])
    outside = [start for start in starts if not 0 <= start < frames]
    if outside:
        yield f"{len(outside)} windows outside its {frames} frames, one at frame {outside[0]}"
    if len(set(starts)) < len(starts):
        yield "the same window twice"


def _check_confidence(fields: dict[str, Any]) -> Iterator[str]:
    confidence, expected = fields["confidence"], fields["positions"].shape[:2]
    if confidence is None:
        return
    if confidence.shape != expected:
        yield f"confidence of shape {confidence.shape}, expected {expected}"
    elif not ((confidence >= 0) & (confidence <= 1)).all():  # NaN is in neither
        yield "confidence outside 0 to 1"


def _bone_name(skeleton: Skeleton, bone: int) -> str:
    return " - ".join(skeleton.joints[joint] for joint in skeleton.bones[bone])


class _Stretch(NamedTuple):
    """The stretch of a recording that a clip covers, in seconds."""

    start: float
    end: float
    split: str
    clip: str


class _Tally:
    def __init__(self, corpus: Corpus):
        self._corpus, self.skeleton = corpus, corpus.skeleton
        self._ids: set[str] = set()
        self._recordings: dict[str, list[_Stretch]] = collections.defaultdict(list)
        self._uneven, self._most_uneven = 0, (0.0, "")

    def add(self, split: str, place: str, fields: dict[str, Any], lengths: np.ndarray) -> Iterator[str]:
        """Count a clip with bones of lengths (T, bones), and yield the findings that depend on the clips before it."""
        if fields["recording"]:
            start = fields["recording_start"]
            end = start + len(lengths) / self._corpus.fps
            self._recordings[fields["recording"]].append(_Stretch(start, end, split, fields["id"]))
        if fields["confidence"] is None:  # estimated bones change their length
            spread = lengths.std(axis=0) / np.maximum(np.median(lengths, axis=0), 1e-12)
            worst = int(spread.argmax())
            self._uneven += bool(spread[worst] > _CONSTANT)
            text = f"{_bone_name(self.skeleton, worst)} by {spread[worst]:.0%} in {place}"
            self._most_uneven = max(self._most_uneven, (float(spread[worst]), text))
        if fields["id"] in self._ids:
            yield "its id occurs more than once"
        self._ids.add(fields["id"])

    def findings(self) -> Iterator[str]:
        for recording, stretches in self._recordings.items():
            if shared := _shared_stretch(stretches):
                first, second = shared
                yield (
                    f"{self._corpus.path}: {first.split!r} and {second.split!r} have the same stretch of recording "
                    f"{recording!r} (clips {first.clip!r} and {second.clip!r}); divide the corpus with ha2g data split"
                )

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

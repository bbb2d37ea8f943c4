"""Validation of a corpus: the checksums of its files, every record, and the counts of `dataset.json`.

A finding is an error that makes training or its scores wrong. A note is a property of the data that is worth knowing
but common: the splits of TED, for example, have clips of the same videos.
"""

import hashlib
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

from tqdm import tqdm

from ha2g_jax.data import clip_checks
from ha2g_jax.data.corpus import Clips, Corpus
from ha2g_jax.data.tally import Tally
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reading, shown


class Verdict(NamedTuple):
    """Result of a validation, one line for each finding or note.

    Attributes:
        findings: errors; empty for a valid corpus.
        notes: properties that are worth knowing.
    """

    findings: list[str]
    notes: list[str]


def validate(path: str | os.PathLike) -> list[str]:
    """Return the findings of `examine`, which are empty for a valid corpus.

    Args:
        path: folder of the corpus.

    Raises:
        UserError: there is no corpus, or its `dataset.json` cannot be used.
    """
    return examine(path).findings


def examine(path: str | os.PathLike) -> Verdict:
    """Examine all shards and records of a corpus.

    Findings: the bytes of a shard differ from its SHA-256; a record cannot be read, or has fields of wrong types;
    positions are not finite, have a wrong shape, or have bones of implausible length (median over the clip, more than
    a factor of 4 from the skeleton's published length); words are out of order or outside the clip; audio is not
    finite or not as long as the motion; windows lie outside the clip; confidence has a wrong shape or lies outside
    [0, 1]; images cannot be read; a clip id occurs twice; a speaker is not listed; the same stretch of a recording
    occurs in two splits; counts, words, speakers or statistics differ from `dataset.json`.

    Notes: shards have no SHA-256; different stretches of a recording occur in several splits; bones change their length
    although the positions were not estimated (bones have constant lengths in motion capture, but not in estimates).

    Args:
        path: folder of the corpus.

    Returns:
        The findings and the notes.

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
    return Verdict([*findings, *tally.findings()], [*_unchecked_shards(corpus), *tally.notes()])


def _shards(corpus: Corpus) -> list[dict[str, Any]]:
    return [shard for entry in corpus.metadata["splits"].values() for shard in entry["shards"]]


def _damaged_shards(corpus: Corpus) -> Iterator[str]:
    for shard in tqdm(_shards(corpus), desc="Checking shards", unit="shard", leave=False, disable=None):
        path = corpus.path / shard["name"]
        with reading(path, "a shard of a corpus"), path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if (stated := shard.get("sha256")) is not None and digest != stated:
            yield f"{shown(path)} has SHA-256 {digest[:12]}..., dataset.json says {stated[:12]}..."


def _unchecked_shards(corpus: Corpus) -> Iterator[str]:
    unstated = [shard["name"] for shard in _shards(corpus) if shard.get("sha256") is None]
    if unstated:
        yield (
            f"dataset.json has no SHA-256 of {len(unstated)} shards, such as {unstated[0]}, so only the checksums in "
            "these shards were checked, which do not cover all of their bytes"
        )


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

"""The clips of a corpus in other splits, so that what is tested was never trained on."""

import collections
import hashlib
import os
import types
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import merge
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.errors import UserError

BY = ("talk", "speaker")
SHARES: Mapping[str, float] = types.MappingProxyType({"train": 0.8, "val": 0.1, "test": 0.1})

_NEAR = 0.005  # of the whole duration: nearer to its share no split is brought


class _Member(NamedTuple):
    """Where a clip is, and what it must stay with."""

    split: str
    number: int
    unit: str
    seconds: float


def divide(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    *,
    by: str = "talk",
    shares: Mapping[str, float] = SHARES,
    seed: int = 0,
) -> None:
    """Writes all clips of a corpus, whatever their split was, into new splits.

    A talk is never divided; with `by="speaker"` nobody is in two splits. The shares are met by duration as nearly as
    whole talks or speakers allow, in an order that depends on the seed and on their names alone.

    Args:
        src: folder of the corpus.
        dst: folder to make; nothing is left of it if the work is interrupted.
        by: "talk" or "speaker".
        shares: split -> its part of the whole; they need not sum to 1. A split without a share is left out.
        seed: of the order.

    Raises:
        UserError: `dst` exists, `src` cannot be read, there are fewer talks or speakers than splits, or the shares
            are no shares.
    """
    if by not in BY:
        raise UserError(f"a corpus is divided by talk or speaker, not by {by!r}")
    if not shares or any(not np.isfinite(share) or share < 0 for share in shares.values()) or not any(shares.values()):
        raise UserError(f"shares are {dict(shares)}, expected numbers from 0 on that are not all 0")
    shares = {split: share / sum(shares.values()) for split, share in shares.items() if share > 0}
    corpus = Corpus.open(src)
    members = _members(corpus, by)
    seconds: dict[str, float] = collections.defaultdict(float)
    for member in members:
        seconds[member.unit] += member.seconds
    if len(seconds) < len(shares):
        raise UserError(
            f"{corpus.path} has {len(seconds)} {by}{'s' * (len(seconds) != 1)}, too few for {len(shares)} splits "
            f"({', '.join(shares)}); name fewer splits{' or divide by talk' if by == 'speaker' else ''}"
        )
    split_of = assign(seconds, shares, seed)
    metadata = {**merge.description(corpus), "division": {"by": by, "shares": shares, "seed": seed}}
    clips = {split: corpus.clips(split) for split in corpus.splits}
    with (
        CorpusWriter(
            dst, splits=tuple(shares), skeleton=corpus.skeleton.name, fps=corpus.fps, metadata=metadata
        ) as writer,
        tqdm(desc="Dividing", total=len(members), unit="clip", leave=False, disable=None) as progress,
    ):
        for split in shares:
            for member in members:
                if split_of[member.unit] == split:
                    writer.add(split, clips[member.split].record(member.number))
                    progress.update()


def _members(corpus: Corpus, by: str) -> list[_Member]:
    """All clips in the order in which they are stored."""
    members: list[_Member] = []
    speakers: dict[str, str] = {}
    total = sum(entry["clips"] for entry in corpus.metadata["splits"].values())
    with tqdm(desc="Reading", total=total, unit="clip", leave=False, disable=None) as progress:
        for split in corpus.splits:
            clips = corpus.clips(split)
            for index in range(len(clips)):
                fields = clips.fields(index)
                talk, speaker = fields["talk"], fields["speaker"]
                if by == "speaker" and talk and speakers.setdefault(talk, speaker) != speaker:
                    raise UserError(
                        f"talk {talk!r} of {corpus.path} has the speakers {speakers[talk]!r} and {speaker!r}, and a "
                        "talk is never divided; divide by talk"
                    )
                # A clip of which no talk is known stays alone.
                unit = speaker if by == "speaker" else talk or f"clip {fields['id']}"
                members.append(_Member(split, index, unit, len(fields["positions"]) / corpus.fps))
                progress.update()
    return members


def assign(seconds: Mapping[str, float], shares: Mapping[str, float], seed: int) -> dict[str, str]:
    """The split of each talk or speaker.

    One after the other goes where most is missing, and to an empty split once no more are left than needed there;
    then pairs change places, or one moves, as long as that brings the durations nearer to the shares (as the sum of
    squares of what is missing) and some split is farther from its share than half a percent of the whole.

    Args:
        seconds: duration of each talk or speaker by name; at least as many as splits.
        shares: split -> its part; they sum to 1.
        seed: of the order.
    """
    whole = sum(seconds.values())
    missing = {split: share * whole for split, share in shares.items()}
    groups: dict[str, list[str]] = {split: [] for split in shares}
    order = sorted(seconds, key=lambda name: hashlib.sha256(f"{seed}/{name}".encode()).digest())
    for number, name in enumerate(order):
        empty = [split for split in groups if not groups[split]]
        choice = empty if len(order) - number <= len(empty) else list(groups)
        split = max(choice, key=lambda split: missing[split])
        groups[split].append(name)
        missing[split] -= seconds[name]
    while max(abs(part) for part in missing.values()) > _NEAR * whole:
        exchange = _best_exchange(groups, missing, seconds)
        if exchange is None:
            break
        for source, target, name in exchange:
            groups[source].remove(name)
            groups[target].append(name)
            missing[source] += seconds[name]
            missing[target] -= seconds[name]
    return {name: split for split, names in groups.items() for name in names}


def _best_exchange(
    groups: dict[str, list[str]], missing: dict[str, float], seconds: Mapping[str, float]
) -> list[tuple[str, str, str]] | None:
    """The moves (from, to, name) that lower the sum of squares of what is missing most; None where none does."""
    best_gain, best = 1e-9 * sum(seconds.values()) ** 2, None
    splits = list(groups)
    for source in splits:
        for target in splits:
            if missing[source] >= missing[target]:
                continue
            gap = missing[target] - missing[source]
            # Moving d seconds lowers the sum by 2 d (gap - d); the best d is half the gap. "" is nothing in return.
            back = [*([""] if len(groups[source]) > 1 else []), *sorted(groups[target], key=lambda name: seconds[name])]
            lengths = np.array([seconds[name] if name else 0.0 for name in back])
            for name in groups[source]:
                place = int(lengths.searchsorted(seconds[name] - gap / 2))
                for partner in back[max(place - 1, 0) : place + 1]:
                    moved = seconds[name] - (seconds[partner] if partner else 0.0)
                    gain = 2 * moved * (gap - moved)
                    if gain > best_gain:
                        best_gain = gain
                        best = [(source, target, name), *([(target, source, partner)] if partner else [])]
    return best

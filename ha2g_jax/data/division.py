"""Division of a corpus into new splits, so that test data and training data have no recording in common."""

import collections
import hashlib
import os
import types
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import merge, records
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.errors import UserError

BY = ("recording", "speaker")
FRACTIONS: Mapping[str, float] = types.MappingProxyType({"train": 0.8, "val": 0.1, "test": 0.1})

_NEAR = 0.005  # tolerance of the duration of a split, as a fraction of the whole duration


class _Member(NamedTuple):
    """A clip of the corpus: its split and number, and the unit (recording or speaker) that is never divided."""

    split: str
    number: int
    unit: str
    seconds: float


def divide(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    *,
    by: str = "recording",
    fractions: Mapping[str, float] = FRACTIONS,
    seed: int = 0,
) -> None:
    """Write the clips of all splits of a corpus into new splits.

    A recording is never divided; with `by="speaker"` no speaker is in two splits. Durations match the fractions as
    closely as whole recordings or speakers allow. The result depends only on the seed, the durations and the names.

    Args:
        src: folder of the corpus.
        dst: folder to make; nothing is left of it if the work is interrupted.
        by: unit that is never divided, "recording" or "speaker".
        fractions: fraction of the whole duration by name of the split, in any unit; a split with 0 is left out.
        seed: seed of the order in which units are assigned.

    Raises:
        UserError: `dst` exists, `src` cannot be read, there are fewer recordings or speakers than splits, or the
            fractions are not finite, negative or all 0.
    """
    if by not in BY:
        raise UserError(f"a corpus cannot be divided by {by!r}; expected one of {', '.join(BY)}")
    total = sum(fractions.values())
    if not np.isfinite(total) or total <= 0 or min(fractions.values()) < 0:
        raise UserError(f"fractions are {dict(fractions)}, expected numbers of at least 0, not all of them 0")
    fractions = {split: fraction / total for split, fraction in fractions.items() if fraction > 0}
    corpus = Corpus.open(src)
    members = _members(corpus, by)
    seconds: dict[str, float] = collections.defaultdict(float)
    for member in members:
        seconds[member.unit] += member.seconds
    if len(seconds) < len(fractions):
        raise UserError(
            f"{corpus.path} has {len(seconds)} {by}{'s' * (len(seconds) != 1)}, too few for {len(fractions)} splits "
            f"({', '.join(fractions)}); name fewer splits{' or divide by recording' if by == 'speaker' else ''}"
        )
    split_of = assign(seconds, fractions, seed)
    # On disk, a unit has the name of the field of a record.
    made = {"by": records.STORED_NAMES.get(by, by), "shares": fractions, "seed": seed}
    metadata = {**merge.description(corpus), "division": made}
    clips = {split: corpus.clips(split) for split in corpus.splits}
    with (
        CorpusWriter(
            dst, splits=tuple(fractions), skeleton=corpus.skeleton.name, fps=corpus.fps, metadata=metadata
        ) as writer,
        tqdm(desc="Dividing", total=len(members), unit="clip", leave=False, disable=None) as progress,
    ):
        for split in fractions:
            for member in members:
                if split_of[member.unit] == split:
                    writer.add(split, clips[member.split].record(member.number))
                    progress.update()


def _members(corpus: Corpus, by: str) -> list[_Member]:
    """Return all clips in the order in which they are stored."""
    members: list[_Member] = []
    speakers: dict[str, str] = {}
    total = sum(entry["clips"] for entry in corpus.metadata["splits"].values())
    with tqdm(desc="Reading", total=total, unit="clip", leave=False, disable=None) as progress:
        for split in corpus.splits:
            clips = corpus.clips(split)
            for index in range(len(clips)):
                fields = clips.fields(index)
                recording, speaker = fields["recording"], fields["speaker"]
                if by == "speaker" and recording and speakers.setdefault(recording, speaker) != speaker:
                    raise UserError(
                        f"recording {recording!r} of {corpus.path} has the speakers {speakers[recording]!r} and "
                        f"{speaker!r}, and a recording is never divided; divide by recording"
                    )
                # A clip without a known recording is a unit of its own.
                unit = speaker if by == "speaker" else recording or f"clip {fields['id']}"
                members.append(_Member(split, index, unit, len(fields["positions"]) / corpus.fps))
                progress.update()
    return members


def assign(seconds: Mapping[str, float], fractions: Mapping[str, float], seed: int) -> dict[str, str]:
    """Assign each recording or speaker to a split.

    Each one in turn is assigned to the split with the longest missing duration, or to an empty split if no more are
    left than there are empty splits. Then pairs are exchanged, or one is moved, as long as that lowers the sum of
    squares of the missing durations and some split is wrong by more than half a percent of the whole duration.

    Args:
        seconds: duration of each recording or speaker by name, in seconds; at least as many as splits.
        fractions: fraction of the whole duration by name of the split; their sum is 1.
        seed: seed of the order.

    Returns:
        The split of each recording or speaker by name.
    """
    whole = sum(seconds.values())
    missing = {split: fraction * whole for split, fraction in fractions.items()}
    groups: dict[str, list[str]] = {split: [] for split in fractions}
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
        for origin, target, name in exchange:
            groups[origin].remove(name)
            groups[target].append(name)
            missing[origin] += seconds[name]
            missing[target] -= seconds[name]
    return {name: split for split, names in groups.items() for name in names}


def _best_exchange(
    groups: dict[str, list[str]], missing: dict[str, float], seconds: Mapping[str, float]
) -> list[tuple[str, str, str]] | None:
    """Return the moves (from, to, name) that lower the sum of squares of the missing durations most, None if none
    does."""
    best_gain, best = 1e-9 * sum(seconds.values()) ** 2, None
    splits = list(groups)
    for origin in splits:
        for target in splits:
            if missing[origin] >= missing[target]:
                continue
            gap = missing[target] - missing[origin]
            # Moving d seconds lowers the sum by 2 d (gap - d); the best d is half the gap. "" is a move without return.
            back = [*([""] if len(groups[origin]) > 1 else []), *sorted(groups[target], key=lambda name: seconds[name])]
            lengths = np.array([seconds[name] if name else 0.0 for name in back])
            for name in groups[origin]:
                place = int(lengths.searchsorted(seconds[name] - gap / 2))
                for partner in back[max(place - 1, 0) : place + 1]:
                    moved = seconds[name] - (seconds[partner] if partner else 0.0)
                    gain = 2 * moved * (gap - moved)
                    if gain > best_gain:
                        best_gain = gain
                        best = [(origin, target, name), *([(target, origin, partner)] if partner else [])]
    return best

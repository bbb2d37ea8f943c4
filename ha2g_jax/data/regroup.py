"""Merging of several corpora into one, and division of a corpus into splits that share no recording."""

import collections
import functools
import hashlib
import operator
import os
import pathlib
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import msgpack
import numpy as np

from ha2g_jax.data.corpus import FILE, Clips, Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.recording import Report, SplitReport, report_as_json, report_from_json
from ha2g_jax.data.records import STORED_NAMES
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, resolved, shown
from ha2g_jax.progress import counted, progress_bar, track

# Entries that `CorpusWriter` adds to the description of a corpus.
_WRITTEN = ("schema_version", "skeleton", "fps", "speakers", "splits", "statistics", "words")
_STATED = ("source", "licence")
_NOT_STATED = "not stated"
_SEPARATOR = " | "  # between the origins, and between the licences, in the description
_NAMED = ("id", "recording", "speaker")

BY = ("recording", "speaker")
FRACTIONS: Mapping[str, float] = types.MappingProxyType({"train": 0.8, "val": 0.1, "test": 0.1})

_NEAR = 0.005  # tolerance of the duration of a split, as a fraction of the whole duration


def merge(paths: Sequence[str | os.PathLike], dst: str | os.PathLike, *, same_speakers: bool = False) -> None:
    """Write the clips of at least two corpora into one, split by split, in the order of the paths.

    Names of clips, recordings and speakers that occur in more than one corpus are prefixed with the name of the corpus'
    folder, because the same name usually means two people. With `same_speakers`, those of speakers and recordings stay.

    The description joins the distinct sources, states the licence of each corpus, adds up the import reports, and keeps
    the other entries of each corpus under "merged". Nothing is left of `dst` if the work is interrupted.

    Raises:
        UserError: `dst` exists, there are fewer than two corpora, one is damaged or occurs twice, alone or as a part
            of another, two have a clip with the same sound and motion, or skeletons or frame rates differ.
    """
    corpora = [Corpus.open(path) for path in paths]
    _check_that_they_fit(corpora)
    names = _names(corpora, _NAMED[:1] if same_speakers else _NAMED)
    splits = tuple(dict.fromkeys(split for corpus in corpora for split in corpus.splits))
    skeleton, fps = corpora[0].skeleton.name, corpora[0].fps
    with (
        CorpusWriter(dst, splits=splits, skeleton=skeleton, fps=fps, metadata=_metadata(corpora, dst)) as writer,
        progress_bar("merging", sum(corpus.num_clips for corpus in corpora), "clip") as bar,
    ):
        for split in splits:
            for corpus, new_names in zip(corpora, names, strict=True):
                for clips, index in _records(corpus, split):
                    writer.add(split, _renamed(clips, index, new_names))
                    bar.update()


def description(corpus: Corpus) -> dict[str, Any]:
    """Return the metadata of a corpus that are not computed from its clips: name, source, licence, import report."""
    return {key: value for key, value in corpus.metadata.items() if key not in _WRITTEN}


def _check_that_they_fit(corpora: list[Corpus]) -> None:
    if len(corpora) < 2:
        raise UserError(f"{len(corpora)} corpus to merge; give at least two")
    first, found = corpora[0], dict[str, Corpus]()
    for number, corpus in enumerate(corpora):
        if any(resolved(corpus.path) == resolved(other.path) for other in corpora[:number]):
            raise UserError(f"{corpus.path} is given twice; name each corpus once")
        for part in (_sha256(corpus), *_parts(corpus.metadata.get("merged", ()))):
            if part in found:
                raise UserError(f"{found[part].path} and {corpus.path} have the same clips; merge each corpus once")
            found[part] = corpus
        if corpus.skeleton.name != first.skeleton.name:
            raise UserError(
                f"{first.path} has skeleton {first.skeleton.name} ({first.skeleton.num_joints} joints), {corpus.path} "
                f"{corpus.skeleton.name} ({corpus.skeleton.num_joints}); merge corpora of one skeleton"
            )
        if corpus.fps != first.fps:
            raise UserError(
                f"{first.path} has {first.fps:g} frames a second, {corpus.path} {corpus.fps:g}; "
                "import both at one frame rate"
            )


def _names(corpora: list[Corpus], kinds: Iterable[str]) -> list[dict[str, dict[str, str]]]:
    """Return for each corpus the new names of clips, recordings and speakers that occur in several: kind -> old name ->
    new name; a clip whose sound and motion are in two corpora is a `UserError`."""
    used = []
    owners: dict[bytes, tuple[Corpus, str]] = {}  # of each clip, by the hash of its sound and motion
    for corpus in track(corpora, "reading names", "corpus"):
        names: dict[str, dict[str, None]] = {kind: {} for kind in kinds}
        for split in corpus.splits:
            for clips, index in _records(corpus, split):
                fields = clips.fields(index)
                name = f"clip {fields['id']!r} of {split} in {shown(corpus.path)}"
                content = hashlib.sha256(fields["audio"])
                content.update(fields["positions"])
                owner, first = owners.setdefault(content.digest(), (corpus, name))
                if owner is not corpus:
                    raise UserError(
                        f"{name} has the sound and the motion of {first}, and could be in training and in test; merge "
                        "only one of the two corpora"
                    )
                for kind, known in names.items():
                    if fields[kind]:
                        known[fields[kind]] = None
        used.append(names)
    labels = _labels(corpora)
    renamed: list[dict[str, dict[str, str]]] = [{} for _ in corpora]
    for kind in kinds:
        counts = collections.Counter(name for names in used for name in names[kind])
        taken = {name for name, count in counts.items() if count == 1}
        for label, names, new_names in zip(labels, used, renamed, strict=True):
            new_names[kind] = {name: f"{label}-{name}" for name in names[kind] if counts[name] > 1}
            for name, new_name in new_names[kind].items():
                if new_name in taken:
                    raise UserError(
                        f"{kind} {name!r} occurs in several corpora, and its new name {new_name!r} occurs too; "
                        f"give the folder {label} another name"
                    )
                taken.add(new_name)
    return renamed


def _labels(corpora: list[Corpus]) -> list[str]:
    """Return the name of each folder; a second folder of the same name, and any later one, gets a number."""
    labels: list[str] = []
    for corpus in corpora:
        name, number = resolved(corpus.path).name, 2
        label = name
        while label in labels:
            label, number = f"{name}-{number}", number + 1
        labels.append(label)
    return labels


def _renamed(clips: Clips, index: int, new_names: dict[str, dict[str, str]]) -> bytes:
    """Return a record with its new names; its other bytes stay the same, so no audio or image is compressed again."""
    record, fields = clips.record(index), clips.fields(index)
    changed = {
        STORED_NAMES.get(kind, kind): names[fields[kind]] for kind, names in new_names.items() if fields[kind] in names
    }
    return cast(bytes, msgpack.packb({**msgpack.unpackb(record), **changed})) if changed else record


def _metadata(corpora: list[Corpus], dst: str | os.PathLike) -> dict[str, Any]:
    described = [description(corpus) for corpus in corpora]
    reports = [report_from_json(corpus.metadata.get("import", {})) for corpus in corpora]
    splits = dict.fromkeys(split for report in reports for split in report)
    added: Report = {
        split: functools.reduce(operator.add, (report[split] for report in reports if split in report), SplitReport())
        for split in splits
    }
    merged = [
        {"folder": label, "source": _NOT_STATED, "licence": _NOT_STATED, **_stated(text), "sha256": _sha256(corpus)}
        for label, text, corpus in zip(_labels(corpora), described, corpora, strict=True)
    ]
    return {
        "name": pathlib.Path(dst).name,
        "source": _joined(text.get("source") for text in described),
        "licence": _licence({part["folder"]: str(part["licence"]) for part in merged}),
        "import": report_as_json(added),
        "merged": merged,
    }


def _sha256(corpus: Corpus) -> str:
    """Return the hash of the description, which has those of all shards."""
    return file_sha256(corpus.path / FILE)


def _parts(parts: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the hashes of corpora that are in a merged one, at any depth."""
    for part in parts:
        yield part["sha256"]
        yield from _parts(part.get("merged", ()))


def _stated(text: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in text.items() if key not in ("import", *(() if value else _STATED))}


def _licence(by_folder: Mapping[str, str]) -> str:
    if len(set(by_folder.values())) == 1:
        return next(iter(by_folder.values()))
    return _SEPARATOR.join(f"{folder}: {licence}" for folder, licence in by_folder.items())


def _joined(texts: Iterable[Any]) -> str:
    """Join distinct texts; a text that was joined before is split first, so that each part occurs once."""
    parts = (part for text in texts if text for part in str(text).split(_SEPARATOR))
    return _SEPARATOR.join(dict.fromkeys(parts))


def _records(corpus: Corpus, split: str) -> Iterator[tuple[Clips, int]]:
    if split in corpus.splits:
        clips = corpus.clips(split)
        for index in range(len(clips)):
            yield clips, index


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

    A recording is never divided; with `by="speaker"` no speaker is in two splits. Durations match the fractions, in any
    unit, as closely as whole recordings or speakers allow; a split with 0 is left out. The result depends only on the
    seed, the durations and the names. Nothing is left of `dst` if the work is interrupted.

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
            f"{corpus.path} has {counted(len(seconds), by)}, too few for {len(fractions)} splits "
            f"({', '.join(fractions)}); give 0 for a split{' or divide by recording' if by == 'speaker' else ''}"
        )
    split_of = assign(seconds, fractions, seed)
    # On disk, a unit has the name of the field of a record.
    made = {"by": STORED_NAMES.get(by, by), "shares": fractions, "seed": seed}
    metadata = {**description(corpus), "division": made}
    clips = {split: corpus.clips(split) for split in corpus.splits}
    with (
        CorpusWriter(
            dst, splits=tuple(fractions), skeleton=corpus.skeleton.name, fps=corpus.fps, metadata=metadata
        ) as writer,
        progress_bar("dividing", len(members), "clip") as bar,
    ):
        for split in fractions:
            for member in members:
                if split_of[member.unit] == split:
                    writer.add(split, clips[member.split].record(member.number))
                    bar.update()


def _members(corpus: Corpus, by: str) -> list[_Member]:
    members: list[_Member] = []
    speakers: dict[str, str] = {}
    with progress_bar("reading the corpus", corpus.num_clips, "clip") as bar:
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
                bar.update()
    return members


def assign(seconds: Mapping[str, float], fractions: Mapping[str, float], seed: int) -> dict[str, str]:
    """Assign each recording or speaker to a split, by their names and durations; the fractions add up to 1.

    Each one in turn is assigned to the split with the longest missing duration, or to an empty split if as many are
    left as there are empty splits. Then pairs are exchanged, or one is moved, as long as that lowers the sum of squares
    of the missing durations and some split is off by more than half a percent of the whole duration.
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

"""Merging of several corpora into one."""

import collections
import functools
import operator
import os
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import msgpack
from tqdm import tqdm

from ha2g_jax.data import import_report
from ha2g_jax.data.corpus import Clips, Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.import_report import Report, SplitReport
from ha2g_jax.data.records import STORED_NAMES
from ha2g_jax.errors import UserError

# Entries that `CorpusWriter` adds to the description of a corpus.
_WRITTEN = ("schema_version", "skeleton", "fps", "speakers", "splits", "statistics", "words")
_STATED = ("source", "licence")
_NOT_STATED = "not stated"
_SEPARATOR = " | "  # between the origins, and between the licences, in the description
_NAMED = ("id", "recording", "speaker")


def merge(paths: Sequence[str | os.PathLike], dst: str | os.PathLike, *, same_speakers: bool = False) -> None:
    """Write the clips of several corpora into one, split by split, in the order of the paths.

    Names of clips and recordings that occur in more than one corpus are prefixed with the name of the corpus' folder.
    So are names of speakers, because the same name in two corpora most often means two people. Two people mistaken for
    one would get a mixed style, while one person mistaken for two only has less data for each.

    The description joins the distinct sources, states the licence of each corpus, adds up the import reports, and keeps
    the other entries of each corpus under "merged". Statistics and vocabulary are those of the new training split.

    Args:
        paths: folders of at least two corpora.
        dst: folder to make; nothing is left of it if the work is interrupted.
        same_speakers: whether speakers of the same name are one person.

    Raises:
        UserError: `dst` exists, there are fewer than two corpora or one is given twice, a corpus cannot be read, or
            skeletons or frame rates differ.
    """
    corpora = [Corpus.open(path) for path in paths]
    _check_that_they_fit(corpora)
    names = _names(corpora, _NAMED[:2] if same_speakers else _NAMED)
    splits = tuple(dict.fromkeys(split for corpus in corpora for split in corpus.splits))
    skeleton, fps = corpora[0].skeleton.name, corpora[0].fps
    with (
        CorpusWriter(dst, splits=splits, skeleton=skeleton, fps=fps, metadata=_metadata(corpora, dst)) as writer,
        tqdm(desc="Merging", total=sum(map(_count, corpora)), unit="clip", leave=False, disable=None) as progress,
    ):
        for split in splits:
            for corpus, new_names in zip(corpora, names, strict=True):
                for clips, index in _records(corpus, split):
                    writer.add(split, _renamed(clips, index, new_names))
                    progress.update()


def description(corpus: Corpus) -> dict[str, Any]:
    """Return the metadata of a corpus that are not computed from its clips: name, source, licence, import report."""
    return {key: value for key, value in corpus.metadata.items() if key not in _WRITTEN}


def _check_that_they_fit(corpora: list[Corpus]) -> None:
    if len(corpora) < 2:
        raise UserError(f"{len(corpora)} corpus to merge; give at least two")
    first = corpora[0]
    for number, corpus in enumerate(corpora):
        if any(corpus.path.samefile(other.path) for other in corpora[:number]):
            raise UserError(f"{corpus.path} is given twice; name each corpus once")
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
    """Return the new names of clips, recordings and speakers that several corpora have, for each corpus: kind -> old
    name -> new name."""
    used = []
    for corpus in tqdm(corpora, desc="Reading names", unit="corpus", leave=False, disable=None):
        names: dict[str, dict[str, None]] = {kind: {} for kind in kinds}
        for split in corpus.splits:
            for clips, index in _records(corpus, split):
                fields = clips.fields(index)
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
    """Return the name of each folder, with a number from the second folder of the same name on."""
    labels: list[str] = []
    for corpus in corpora:
        name, number = corpus.path.resolve().name, 2
        label = name
        while label in labels:
            label, number = f"{name}-{number}", number + 1
        labels.append(label)
    return labels


def _renamed(clips: Clips, index: int, new_names: dict[str, dict[str, str]]) -> bytes:
    """Return the record with its new names; its other bytes stay, so no audio or image is compressed again."""
    record, fields = clips.record(index), clips.fields(index)
    changed = {
        STORED_NAMES.get(kind, kind): names[fields[kind]] for kind, names in new_names.items() if fields[kind] in names
    }
    return cast(bytes, msgpack.packb({**msgpack.unpackb(record), **changed})) if changed else record


def _metadata(corpora: list[Corpus], dst: str | os.PathLike) -> dict[str, Any]:
    described = [description(corpus) for corpus in corpora]
    reports = [_report(corpus) for corpus in corpora]
    splits = dict.fromkeys(split for report in reports for split in report)
    added: Report = {
        split: functools.reduce(operator.add, (report[split] for report in reports if split in report), SplitReport())
        for split in splits
    }
    merged = [
        {"folder": label, "source": _NOT_STATED, "licence": _NOT_STATED, **_stated(text)}
        for label, text in zip(_labels(corpora), described, strict=True)
    ]
    return {
        "name": pathlib.Path(dst).name,
        "source": _joined(text.get("source") for text in described),
        "licence": _licence({part["folder"]: str(part["licence"]) for part in merged}),
        "import": import_report.as_json(added),
        "merged": merged,
    }


def _stated(text: dict[str, Any]) -> dict[str, Any]:
    """Return the description of a corpus without its import report, source or licence if they are empty."""
    return {key: value for key, value in text.items() if key not in ("import", *(() if value else _STATED))}


def _licence(by_folder: Mapping[str, str]) -> str:
    """Return the licence of all corpora if it is the same, else each with the name of its folder."""
    if len(set(by_folder.values())) == 1:
        return next(iter(by_folder.values()))
    return _SEPARATOR.join(f"{folder}: {licence}" for folder, licence in by_folder.items())


def _report(corpus: Corpus) -> Report:
    return {split: SplitReport.from_json(counts) for split, counts in corpus.metadata.get("import", {}).items()}


def _joined(texts: Iterable[Any]) -> str:
    """Join distinct texts; a text that is joined already is split first, so that each part occurs once."""
    parts = (part for text in texts if text for part in str(text).split(_SEPARATOR))
    return _SEPARATOR.join(dict.fromkeys(parts))


def _records(corpus: Corpus, split: str) -> Iterable[tuple[Clips, int]]:
    if split in corpus.splits:
        clips = corpus.clips(split)
        yield from ((clips, index) for index in range(len(clips)))


def _count(corpus: Corpus) -> int:
    return sum(entry["clips"] for entry in corpus.metadata["splits"].values())

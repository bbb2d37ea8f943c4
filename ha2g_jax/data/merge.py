"""Several corpora as one."""

import collections
import functools
import operator
import os
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any, cast

import msgpack
from tqdm import tqdm

from ha2g_jax.data import import_report
from ha2g_jax.data.corpus import Clips, Corpus
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.import_report import Report, SplitReport
from ha2g_jax.errors import UserError

# What `CorpusWriter` adds to the description that it is given.
_WRITTEN = ("schema_version", "skeleton", "fps", "speakers", "splits", "statistics", "words")
_SEPARATOR = " | "  # between sources and licences
_NAMED = ("id", "talk", "speaker")


def merge(sources: Sequence[str | os.PathLike], dst: str | os.PathLike, *, same_speakers: bool = False) -> None:
    """Writes the clips of several corpora into one; split by split, in the order of the sources.

    Ids and talks that occur in more than one source get the name of the source's folder before them, and so do
    speakers: one name in two collections is most often two people, and two people taken for one get a style that is
    neither's, while one person taken for two only has less data for each.

    The description joins the distinct sources and licences, adds up the import reports, and keeps what else each
    source says of itself under "merged". Statistics and vocabulary are those of the new training split.

    Args:
        sources: folders of at least two corpora.
        dst: folder to make; nothing is left of it if the work is interrupted.
        same_speakers: speakers of one name are one person.

    Raises:
        UserError: `dst` exists, there are fewer than two sources or one of them twice, a source cannot be read, or
            skeleton or frame rate differ.
    """
    corpora = [Corpus.open(source) for source in sources]
    _check_that_they_fit(corpora)
    names = _names(corpora, ("id", "talk") if same_speakers else _NAMED)
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
    """What a corpus says of itself, without what is computed from its clips: name, source, licence, import report..."""
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
                f"{corpus.skeleton.name} ({corpus.skeleton.num_joints}): joints cannot be mixed in one corpus; "
                "merge corpora of one skeleton"
            )
        if corpus.fps != first.fps:
            raise UserError(
                f"{first.path} has {first.fps:g} frames a second, {corpus.path} {corpus.fps:g}; "
                "import both at one frame rate"
            )


def _names(corpora: list[Corpus], kinds: Iterable[str]) -> list[dict[str, dict[str, str]]]:
    """New names of those ids, talks and speakers of each source that another source has too: kind -> old -> new."""
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
        sources = collections.Counter(name for names in used for name in names[kind])
        taken = {name for name, count in sources.items() if count == 1}
        for label, names, new_names in zip(labels, used, renamed, strict=True):
            new_names[kind] = {name: f"{label}-{name}" for name in names[kind] if sources[name] > 1}
            for name, new_name in new_names[kind].items():
                if new_name in taken:
                    raise UserError(
                        f"{kind} {name!r} occurs in several sources, and so would {new_name!r}, its name with that of "
                        f"its folder; give the folder {label} another name"
                    )
                taken.add(new_name)
    return renamed


def _labels(corpora: list[Corpus]) -> list[str]:
    """The name of each folder; the second of a name, and those after it, with a number."""
    labels: list[str] = []
    for corpus in corpora:
        name, number = corpus.path.resolve().name, 2
        label = name
        while label in labels:
            label, number = f"{name}-{number}", number + 1
        labels.append(label)
    return labels


def _renamed(clips: Clips, index: int, new_names: dict[str, dict[str, str]]) -> bytes:
    """The record with its new names and, in all else, its very bytes: no audio and no image is compressed again."""
    record, fields = clips.record(index), clips.fields(index)
    changed = {kind: names[fields[kind]] for kind, names in new_names.items() if fields[kind] in names}
    return cast(bytes, msgpack.packb({**msgpack.unpackb(record), **changed})) if changed else record


def _metadata(corpora: list[Corpus], dst: str | os.PathLike) -> dict[str, Any]:
    described = [description(corpus) for corpus in corpora]
    reports = [_report(corpus) for corpus in corpora]
    splits = dict.fromkeys(split for report in reports for split in report)
    added: Report = {
        split: functools.reduce(operator.add, (report[split] for report in reports if split in report), SplitReport())
        for split in splits
    }
    return {
        "name": pathlib.Path(dst).name,
        **{key: _joined([text.get(key) for text in described]) for key in ("source", "licence")},
        "import": import_report.as_json(added),
        "merged": [
            {"folder": corpus.path.resolve().name, **{key: value for key, value in text.items() if key != "import"}}
            for corpus, text in zip(corpora, described, strict=True)
        ],
    }


def _report(corpus: Corpus) -> Report:
    try:
        return {split: SplitReport.from_json(counts) for split, counts in corpus.metadata.get("import", {}).items()}
    except (TypeError, AttributeError, ValueError) as error:
        raise UserError(
            f"{corpus.path / 'dataset.json'} has a damaged import report ({error}); import the corpus again"
        ) from error


def _joined(texts: Iterable[Any]) -> str:
    """Distinct texts, each once even where some of them are joined already."""
    parts = (part for text in texts if text for part in str(text).split(_SEPARATOR))
    return _SEPARATOR.join(dict.fromkeys(parts))


def _records(corpus: Corpus, split: str) -> Iterable[tuple[Clips, int]]:
    if split in corpus.splits:
        clips = corpus.clips(split)
        yield from ((clips, index) for index in range(len(clips)))


def _count(corpus: Corpus) -> int:
    return sum(entry["clips"] for entry in corpus.metadata["splits"].values())

"""Keep all finished runs of a study in one table, `scores.jsonl`: what its reports need, small enough to publish.

The first line has the corpus, the auto-encoder and the scores that all runs share, such as those of the teacher; each
further line is a run. Only the auto-encoder keeps its weights, as a model folder beside the table, because the scores
of further runs need them.
"""

import collections
import json
import pathlib
import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.data.corpus import TALK_VERSION
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.files.writing import write_text
from tables.workdirs import Record, Run, is_finished, record_of, without_path

FILE = "scores.jsonl"

_START = ("time", "step", "python", "versions", "commit", "hardware")  # what the table says of each start
_WRITING = threading.Lock()
_DIFFERENT = object()


class Kept(NamedTuple):
    """The content of a table of kept runs.

    Attributes:
        data: {"sha256", "metadata"} of the `dataset.json` of the corpus, see `corpus_data`, None without a table.
        kind: what the scores depend on besides the models, values of JSON.
        autoencoder: record of the auto-encoder, None without one.
        records: records of all other runs, with scores.
    """

    data: Mapping[str, Any] | None = None
    kind: Sequence[Any] = ()
    autoencoder: Record | None = None
    records: tuple[Record, ...] = ()

    def is_of(self, data: Mapping[str, Any]) -> bool:
        """Return whether the runs are of a corpus, given by its `corpus_data`.

        It has the same bytes, or `ha2g data make-talk` made it with the same arguments: processors differ in the last
        bit of a sample now and then, and a study may go on elsewhere.
        """
        if self.data is None:
            return False
        is_made = data["metadata"]["name"] == TALK_VERSION
        return self.data["sha256"] == data["sha256"] or (is_made and self.data["metadata"] == data["metadata"])

    def find(self, run: Run) -> Record | None:
        """Return the record of a run, whatever its name, or None.

        A kept run is that of a config if both agree in the settings that both have: settings come and go. It has to
        have those that the row or the user has changed.
        """
        every = self.records if self.autoencoder is None else (*self.records, self.autoencoder)
        found = [
            record
            for record in every
            if record.seed == run.seed
            and all(_has(record.config, name) for name in run.changed)
            and _agree(without_path(record.config), without_path(json.loads(run.config.to_json())))
        ]
        return found[0] if len(found) == 1 else None


def corpus_data(metadata: Mapping[str, Any], sha256: str) -> dict[str, Any]:
    """Return what a table says of its corpus, from the `dataset.json` and its hash: {"sha256", "metadata"}."""
    facts = {name: metadata[name] for name in ("name", "source", "skeleton", "fps", "division") if name in metadata}
    splits = {name: {"clips": split["clips"]} for name, split in metadata["splits"].items()}
    return {"sha256": sha256, "metadata": facts | {"splits": splits}}


def read_kept(folder: pathlib.Path) -> Kept:
    """Read the table of kept runs in a folder; one without runs where there is none.

    Raises:
        UserError: the table is damaged, or has a run twice.
    """
    path = folder / FILE
    if not path.is_file():
        return Kept()
    try:
        head, *lines = map(json.loads, path.read_text().splitlines())
        records = [Record(**_merged(line, head["alike"])) for line in lines]
        autoencoder = head["autoencoder"] and Record(**head["autoencoder"])
        kept = Kept(head["data"], head["kind"], autoencoder, tuple(records))
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            f"{shown(path)} is damaged ({reason(error)[:80]}); restore the one of the repository"
        ) from error
    counts = collections.Counter(record.name for record in records)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise UserError(f"{shown(path)} has {twice[0]} twice; remove one of its lines")
    return kept


def keep_run(
    run: Run, scores: Mapping[str, Any] | None, folder: pathlib.Path, data: Mapping[str, Any], kind: Sequence[Any]
) -> None:
    """Add a finished run to the table in a folder.

    Args:
        run: finished run, of a model with scores, or of the auto-encoder.
        scores: scores of the model, None for the auto-encoder, which comes first.
        folder: folder of the table, which is made.
        data: `corpus_data` of the corpus.
        kind: what the scores depend on beside the models, values of JSON.

    Raises:
        UserError: the table cannot be written, or is of another corpus, auto-encoder, kind of scores or training.
    """
    with _WRITING:
        kept = read_kept(folder)
        if kept.data is not None and not (kept.is_of(data) and list(kept.kind) == list(kind)):
            raise UserError(f"{shown(folder / FILE)} has scores of another corpus or kind; use another folder")
        if not is_finished(run):  # a run that is scored as it is, or one that is in the table of the workdir
            return
        record = _for_all(record_of(run, scores), data["metadata"]["name"])
        before = kept.find(run)
        if before is not None and _trained(before) != _trained(record):
            raise UserError(
                f"{shown(folder / FILE)} has another training of {run.name}; remove {shown(run.workdir)} to go on with "
                "that of the table"
            )
        if scores is None:
            _keep_weights(run, folder)
            kept = kept._replace(autoencoder=record)
        elif kept.autoencoder is None:
            raise UserError(f"{shown(folder)} has no auto-encoder; copy that of the runs and their {FILE} there")
        else:
            others = [each for each in kept.records if each != before]
            kept = kept._replace(records=(*others, record))
        _write(kept._replace(data=kept.data or data, kind=kind), folder / FILE)


def _for_all(record: Record, corpus: str) -> Record:
    """Return a record as it is published, without what is specific to a machine."""
    config = {**record.config, "data": {**record.config["data"], "path": corpus}}
    starts = [{key: start[key] for key in _START if key in start} for start in record.starts]
    return record._replace(config=config, starts=starts)


def _trained(record: Record) -> list[Any]:
    """Return what differs between two trainings of the same run."""
    return [record.starts, record.validation, (record.scores or {}).get("model")]


def _keep_weights(run: Run, folder: pathlib.Path) -> None:
    from ha2g_jax.checkpoint.publishing import export  # JAX takes a while to import

    if not (folder / run.name).exists():
        export(run.workdir, folder / run.name)


def _write(kept: Kept, path: pathlib.Path) -> None:
    records = [record._asdict() for record in sorted(kept.records, key=lambda record: record.name)]
    alike = _alike([{"scores": record["scores"]} for record in records]) if records else {}
    autoencoder = kept.autoencoder and kept.autoencoder._asdict()
    head = {"data": kept.data, "kind": kept.kind, "autoencoder": autoencoder, "alike": alike}
    lines = [head, *(_own(record, alike) for record in records)]
    write_text(path, "".join(json.dumps(line, allow_nan=False) + "\n" for line in lines))


def _alike(trees: Sequence[Any]) -> Any:
    """Return what all trees have in common, a value or the entries of a dict, or `_DIFFERENT`."""
    first, *others = trees
    if not all(isinstance(tree, dict) for tree in trees):
        return first if all(tree == first for tree in others) else _DIFFERENT
    common = [name for name in first if all(name in tree for tree in others)]
    found = {name: _alike([tree[name] for tree in trees]) for name in common}
    return {name: tree for name, tree in found.items() if tree is not _DIFFERENT}


def _own(tree: Mapping[str, Any], alike: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a tree that the trees do not have in common."""
    found = {}
    for name, value in tree.items():
        if name not in alike:
            found[name] = value
        elif isinstance(value, dict) and (rest := _own(value, alike[name])):
            found[name] = rest
    return found


def _merged(own: Mapping[str, Any], alike: Mapping[str, Any]) -> dict[str, Any]:
    """Return the whole tree, with the entries in the common order."""
    found = dict(alike)
    for name, value in own.items():
        found[name] = _merged(value, alike[name]) if isinstance(value, dict) and name in alike else value
    return found


def _agree(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return all(_agree(one[name], other[name]) for name in one.keys() & other.keys())
    return one == other


def _has(config: Mapping[str, Any], dotted: str) -> bool:
    part, _, rest = dotted.partition(".")
    return part in config and (not rest or _has(config[part], rest))

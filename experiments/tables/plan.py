"""Plan of a table of the paper: the runs that it needs, their folders, and the scores that exist already."""

import hashlib
import json
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from tables import paper_tables
from tables.paper_tables import Table
from tables.request import Request

EVALUATION_VERSION = 5  # of what `run_scores` measures; a higher number makes all scores anew
DRAWS = {"debug": 100}  # of the bootstrap over clips; other sizes have 1000
SPLITS = {"talk": ("test", "test_unseen_speakers")}  # others have "test"

_HASH_DIGITS = 10
_NO_WHISPER = "it needs the weights of Whisper: --changes model.audio.weights=FOLDER"


class Run(NamedTuple):
    """One training, of a row with one seed or of the auto-encoder.

    Attributes:
        name: name of the run and of its folder.
        seed: seed of the training.
        config: config of the training.
        workdir: folder of the training.
    """

    name: str
    seed: int
    config: Config
    workdir: pathlib.Path


class Plan(NamedTuple):
    """All runs of a table.

    Attributes:
        table: table of the paper.
        corpus: folder of the corpus.
        splits: splits to score.
        autoencoder: run of the auto-encoder whose latents are the features of the Frechet distance and of diversity.
        rows: name of a row -> its runs in the order of the seeds.
        left_out: name of a row that lacks an input -> reason.
        draws: number of draws of the bootstrap over clips.
    """

    table: Table
    corpus: pathlib.Path
    splits: tuple[str, ...]
    autoencoder: Run
    rows: dict[str, tuple[Run, ...]]
    left_out: dict[str, str]
    draws: int

    @property
    def runs(self) -> tuple[Run, ...]:
        """Runs of all rows, seed by seed, so that there is an early result of every row."""
        return tuple(run for same_seed in zip(*self.rows.values(), strict=True) for run in same_seed)


def make_plan(request: Request, corpus: pathlib.Path) -> Plan:
    """Plan the runs that a request needs; nothing is written.

    Args:
        request: request of the user.
        corpus: folder of the corpus.

    Returns:
        The plan.

    Raises:
        UserError: there is no such table, data, size, setting or corpus, or the table does not fit the data.
    """
    table = paper_tables.table(request.table, request.data)
    rows = {row.name: plan_row(request, corpus, row.method, row.changes, row.name) for row in table.rows}
    left_out = {name: _NO_WHISPER for name, runs in rows.items() if _lacks_whisper(runs[0].config)}
    rows = {name: runs for name, runs in rows.items() if name not in left_out}
    rate = {name: value for name, value in request.changes.items() if name == "data.fps"}  # that of the corpus
    autoencoder = _run(request._replace(changes=rate), corpus, "autoencoder", {}, "", 0)
    splits, draws = SPLITS.get(request.data, ("test",)), DRAWS.get(request.size, 1000)
    return Plan(table, corpus, splits, autoencoder, rows, left_out, draws)


def plan_row(
    request: Request, corpus: pathlib.Path, method: str, changes: Mapping[str, Any], row: str
) -> tuple[Run, ...]:
    """Plan the runs of one row, one for each seed; nothing is written.

    Args:
        request: request of the user.
        corpus: folder of the corpus.
        method: one of `presets.METHODS`.
        changes: dotted name of a setting -> value, where the row differs from the method.
        row: name of the row, for the names of runs with changes.

    Raises:
        UserError: there is no such setting or corpus.
    """
    if not (corpus / "dataset.json").is_file():
        raise UserError(f"no corpus in {corpus}: dataset.json is missing; see docs/data.md for how to bring in data")
    return tuple(_run(request, corpus, method, changes, row, seed) for seed in request.seeds)


def _lacks_whisper(config: Config) -> bool:
    return config.model.audio.kind == "whisper" and not config.model.audio.weights


def is_finished(run: Run) -> bool:
    """Return whether the workdir has the checkpoint of the last step of exactly this config."""
    if not (run.workdir / "latest" / str(run.config.train.steps)).is_dir():
        return False
    try:
        stored = json.loads((run.workdir / "config.json").read_text())
        return _causes(stored) == _causes(json.loads(run.config.to_json()))
    except (OSError, ValueError, KeyError, TypeError):
        return False  # training itself says what is wrong


def checkpoint_folder(run: Run) -> pathlib.Path | None:
    """Return the folder of the checkpoint to score, the best on the validation split or else the latest, or None."""
    for folder in (run.workdir / "best", run.workdir / "latest"):
        steps = [path for path in folder.glob("*") if path.name.isdecimal() and (path / "SHA256SUMS").is_file()]
        if steps:
            return max(steps, key=lambda path: int(path.name))
    return None


def is_copy(run: Run) -> bool:
    """Return whether the checkpoint to score has no weights, only their hashes, as `kept_runs` leaves it."""
    folder = checkpoint_folder(run)
    return folder is not None and [path.name for path in folder.iterdir()] == ["SHA256SUMS"]


def checkpoint_step(run: Run) -> int | None:
    """Return the step of the checkpoint to score, or None without one."""
    folder = checkpoint_folder(run)
    return int(folder.name) if folder else None


def scores_path(run: Run, plan: Plan, has_legacy: bool) -> pathlib.Path | None:
    """Return the path of the scores of a run, whose name has a hash of all that they depend on.

    Checkpoints and corpora store the hashes of their contents, so that no weights are read.

    Args:
        run: run that is scored.
        plan: plan of the table.
        has_legacy: whether the scores of the public release are added.

    Returns:
        The path, or None without a checkpoint.
    """
    autoencoder = checkpoint_folder(plan.autoencoder)
    if autoencoder is None:
        return None
    causes = [EVALUATION_VERSION, list(plan.splits), has_legacy, plan.draws]
    return hashed_path(run, "scores", causes, (autoencoder / "SHA256SUMS", plan.corpus / "dataset.json"))


def hashed_path(run: Run, kind: str, causes: Sequence[Any], files: Sequence[pathlib.Path]) -> pathlib.Path | None:
    """Return the path of scores of the checkpoint of a run, whose name has a hash of all that they depend on.

    Args:
        run: run that is scored.
        kind: beginning of the name of the file.
        causes: values of JSON that the scores depend on.
        files: files whose contents the scores depend on, beside the checkpoint.

    Returns:
        The path, or None without a checkpoint.
    """
    checkpoint = checkpoint_folder(run)
    if checkpoint is None:
        return None
    hashes = map(_file_hash, (checkpoint / "SHA256SUMS", *files))
    return run.workdir / f"{kind}-{_digest([*causes, *hashes])}.json"


def retrieval_path(plan: Plan) -> pathlib.Path:
    """Return the path of the training windows that sound most like the clips of the splits, the same for all runs."""
    causes = [EVALUATION_VERSION, list(plan.splits), _file_hash(plan.corpus / "dataset.json")]
    return plan.autoencoder.workdir.with_name(f"retrieval-{_digest(causes)}.json")


def read_stored(path: pathlib.Path | None) -> dict[str, Any] | None:
    """Read scores, or the windows of retrieval, that an earlier run of the command has stored.

    Args:
        path: file to read, or None.

    Returns:
        The content, or None where the file is missing or damaged.
    """
    if path is None:
        return None
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


def _run(request: Request, corpus: pathlib.Path, method: str, changes: Mapping[str, Any], row: str, seed: int) -> Run:
    """Return a run whose name has that of the row, or only that of the method for the method's own settings."""
    more = {"data.path": str(corpus), "seed": seed}
    asked = dict(request.changes)
    if changes.get("model.audio.kind") != "whisper":
        asked.pop("model.audio.weights", None)  # a setting of one row; the runs of the others do not change
    try:
        config = presets.make(request.data, request.size, method, {**asked, **changes, **more}).lock()
        plain = presets.make(request.data, request.size, method, {**asked, **more})
    except (KeyError, TypeError, ValueError) as error:  # ml_collections' for a key or a type that is not there
        raise UserError(f"--changes do not fit: {' '.join(str(error).split())}; see ha2g_jax/config.py") from error
    values = json.loads(config.to_json())
    is_plain = values == json.loads(plain.to_json())
    label = method if is_plain else f"{method}-{re.sub('[^a-z0-9]+', '-', row.lower()).strip('-')}"
    causes = [_causes(values | {"seed": None}), _file_hash(corpus / "dataset.json")]
    end = f"-{_digest(causes)}-seed{seed}"
    folder = request.workdir.resolve()
    # Two tables may have different names for the same settings: an existing run is used, whatever its name.
    there = sorted(path.name for path in folder.glob(f"*{end}") if path.is_dir())
    name = there[0] if there else f"{request.data}-{request.size}-{label}{end}"
    return Run(name, seed, config, folder / name)


def _causes(values: dict[str, Any]) -> dict[str, Any]:
    """Return a config without the path of the corpus, which may change; the content has a hash of its own."""
    return values | {"data": values["data"] | {"path": ""}}


def _file_hash(path: pathlib.Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:_HASH_DIGITS]

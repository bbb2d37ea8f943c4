"""Plan the runs of a table of the paper, of the study of look-aheads or of a grid of settings: rows times seeds."""

import ast
import dataclasses
import itertools
import json
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.config import presets, settings
from ha2g_jax.data.corpus import FILE, Corpus
from ha2g_jax.data.talk import build
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256, reading, shown
from ha2g_jax.files.writing import check_file
from ha2g_jax.launch import load_config
from ha2g_jax.metrics.legacy import check_rate
from tables import factorial, paper_tables
from tables.kept_runs import FILE as KEPT
from tables.kept_runs import Kept, corpus_data, read_kept
from tables.paper_tables import Table
from tables.workdirs import (
    Record,
    Run,
    checkpoint_step,
    digest,
    is_finished,
    read_stored,
    record_of,
    scores_file,
    weights_digest,
    without_path,
)

WORKDIR = pathlib.Path("runs/reproduce")

EVALUATION_VERSION = 5  # version of what `scores` measures; a higher number makes it compute all scores again

_DRAWS = {"debug": 100}  # draws of the bootstrap over clips; other sizes have 1000
_SPLITS = {"talk": ("test", "test_unseen_speakers")}  # others have "test"
# Table, or "" for any other, and whether the size is debug -> name, speakers and minutes of its own Talk corpus.
_CORPORA = {
    ("", True): ("talk-debug-corpus", 6, 10),
    (factorial.TABLE, True): ("talk-debug-corpus", 12, 12),
    (factorial.TABLE, False): ("talk-corpus", factorial.SPEAKERS, factorial.MINUTES),
}
_OPTIONS = {"seed": "--seeds", "data.path": "--data NAME:DIR"}  # settings that are options of their own
_MOST_SEEDS = 1000
_LONGEST_NAME = 200  # bytes of the name of a run; file systems allow 255
_WHISPER = "model.audio.weights"
_NO_WHISPER = f"it needs the weights of Whisper: --changes {_WHISPER}=FOLDER"


class Request(NamedTuple):
    """Request of the user for a table or for the study of look-aheads.

    Attributes:
        table: one of `paper_tables.TABLES`, "factorial", or "latency".
        data: one of `presets.DATA`.
        size: one of `presets.SIZES`.
        path: folder of the corpus; "" for the Talk corpus, which is made on first use.
        changes: dotted name of a setting -> value, for every row but not for the auto-encoder.
        has_training: whether to train missing runs; False only evaluates existing ones.
        has_legacy: whether to add the scores of the public release.
        split: split that the study of look-aheads scores.
    """

    table: str
    data: str
    size: str
    path: str
    seeds: tuple[int, ...]
    workdir: pathlib.Path
    changes: Mapping[str, Any] = {}
    jobs: int = 1
    has_training: bool = True
    has_legacy: bool = False
    split: str = "test"


@dataclasses.dataclass(frozen=True)
class Plan:
    """All runs of a request.

    Attributes:
        digest: SHA-256 of the description of the corpus.
        kept: runs that are kept in the workdir without their weights.
        rows: name of a row -> its runs in the order of the seeds.
    """

    corpus: Corpus
    digest: str
    kept: Kept
    rows: dict[str, tuple[Run, ...]]

    @property
    def runs(self) -> tuple[Run, ...]:
        """Runs of all rows, seed by seed, so that there is an early result of every row; none twice."""
        by_seed = itertools.zip_longest(*self.rows.values())
        return tuple({run.name: run for same_seed in by_seed for run in same_seed if run is not None}.values())


@dataclasses.dataclass(frozen=True)
class TablePlan(Plan):
    """All runs of a table of the paper.

    Attributes:
        table: table of the paper without the rows that are left out.
        autoencoder: run of the auto-encoder whose latents are the features of the Frechet distance and of diversity.
        left_out: name of a row that lacks an input -> reason.
        draws: number of draws of the bootstrap over clips.
    """

    table: Table
    autoencoder: Run
    splits: tuple[str, ...]
    left_out: Mapping[str, str]
    draws: int


def plan_table(request: Request) -> TablePlan:
    """Plan the runs of a table of the paper.

    Raises:
        UserError: there is no such table, setting or corpus, or the table does not fit the data.
    """
    is_factorial = request.table == factorial.TABLE
    if is_factorial:  # all blocks, of which the request trains those of its seeds
        table, request = factorial.table(request.size), request._replace(seeds=tuple(range(factorial.SEEDS)))
    else:
        table = paper_tables.table(request.table, request.data, request.size)
    plan = plan_rows(request, {row.name: (row.method, row.changes) for row in table.rows})
    if is_factorial:
        plan.rows[factorial.ORACLE] = plan.rows[factorial.ORACLE][:1]  # the gate is that of the first block
    if request.has_legacy:
        check_rate(plan.corpus.fps)
    left_out = {name: _NO_WHISPER for name, (run, *_) in plan.rows.items() if _lacks_whisper(run)}
    rate = {name: value for name, value in request.changes.items() if name == "data.fps"}  # that of the corpus
    autoencoder = _run(request._replace(changes=rate), plan, "autoencoder", {}, "", 0)
    splits = factorial.SPLITS if is_factorial else _SPLITS.get(request.data, ("test",))
    for split in splits:
        if not plan.corpus.has_clips(split):
            raise UserError(
                f"{plan.corpus.path} has no clips in the split {split}, which is scored; `ha2g data split` makes one"
            )
    return TablePlan(
        plan.corpus,
        plan.digest,
        plan.kept,
        {name: runs for name, runs in plan.rows.items() if name not in left_out},
        table._replace(rows=tuple(row for row in table.rows if row.name not in left_out)),
        autoencoder,
        splits,
        left_out,
        _DRAWS.get(request.size, 1000),
    )


def plan_rows(request: Request, rows: Mapping[str, tuple[str, Mapping[str, Any]]]) -> Plan:
    """Plan the runs of rows, one for each seed; the workdir is made, nothing else is written.

    Args:
        rows: name of a row -> its method, and the settings in which it differs from the method.

    Raises:
        UserError: there is no such setting or corpus.
    """
    path, kept = corpus_path(request), read_kept(request.workdir)
    if kept.data is not None and not request.has_training and not (path / FILE).is_file():
        plan = Plan(Corpus(path, dict(kept.data["metadata"])), kept.data["sha256"], kept, {})
    else:
        corpus, sha256 = Corpus.open(path), file_sha256(path / FILE)
        if kept.data is not None and kept.is_of(corpus_data(corpus.metadata, sha256)):
            plan = Plan(corpus, kept.data["sha256"], kept, {})  # so that runs have the same names on every machine
        else:
            plan = Plan(corpus, sha256, Kept(), {})
    for name, (method, changes) in rows.items():
        plan.rows[name] = tuple(_run(request, plan, method, changes, name, seed) for seed in request.seeds)
    with reading(request.workdir, "a folder of runs, which --workdir names"):
        request.workdir.mkdir(parents=True, exist_ok=True)
    return plan


def plan_grid(spec: str, workdir: pathlib.Path, grids: Sequence[str], overrides: Sequence[str] = ()) -> list[Run]:
    """Plan the runs of the product of several grids.

    Args:
        spec: FILE[:SIZE] of the config.
        grids: texts of the form KEY=VALUE,VALUE...; the last one changes fastest.
        overrides: further arguments of every run, --config.KEY=VALUE.

    Raises:
        UserError: a grid or a setting of any run is not valid.
    """
    values = {}
    for grid in grids:
        key, _, text = grid.partition("=")
        if not key or not text or key in values:
            raise UserError(
                f"--grid {grid} is not KEY=VALUE,VALUE..., or another grid has its key; give each a key of its own, "
                "such as --grid seed=0,1,2"
            )
        values[key] = _split(text)
    short = {key: key.rpartition(".")[2] for key in values}
    labels = {key: name if list(short.values()).count(name) == 1 else key for key, name in short.items()}
    runs = []
    for point in itertools.product(*values.values()):
        chosen = dict(zip(values, point, strict=True))
        name = ",".join(f"{labels[key]}={value}" for key, value in chosen.items())
        name = re.sub(r"[^\w.,=+-]+", "_", re.sub(r"[][(){}\s]", "", name))
        config = load_config(spec, [*overrides, *(f"--config.{key}={value}" for key, value in chosen.items())])
        if chosen in [run.changed for run in runs]:
            raise UserError(f"two runs of the grid {' '.join(grids)} are the same; give every value once")
        if len(name.encode()) > _LONGEST_NAME or name in {run.name for run in runs}:
            name = f"{name[: _LONGEST_NAME // 4]}-{digest(chosen)}"
        runs.append(Run(name, config.seed, config, workdir / name, chosen))
    return runs


def scores_kind(plan: TablePlan, request: Request) -> list[Any]:
    """Return what the scores of a table depend on besides the models and the corpus."""
    return [EVALUATION_VERSION, list(plan.splits), request.has_legacy, plan.draws]


def scores_path(run: Run, plan: TablePlan, request: Request) -> pathlib.Path | None:
    """Return the path of the scores of a run for a table, or None if its weights or the auto-encoder's are missing."""
    weights = weights_digest(plan.autoencoder)
    return None if weights is None else scores_file(run, "scores", [*scores_kind(plan, request), weights, plan.digest])


def read_record(run: Run, plan: TablePlan, request: Request) -> Record:
    """Read the record of a run with its scores, from the table of kept runs or from its workdir.

    The scores are None where they are missing, or where the run does not count (`is_counted`).
    """
    kept = plan.kept.find(run)
    if kept is not None and (run == plan.autoencoder or list(plan.kept.kind) == scores_kind(plan, request)):
        return kept
    is_scored = run != plan.autoencoder and is_counted(run, request)
    return record_of(run, read_stored(scores_path(run, plan, request)) if is_scored else None)


def is_counted(run: Run, request: Request) -> bool:
    """Return whether a run in its workdir counts: a finished one, and without training also one that has begun.

    In the factorial study, whose claims rest on complete runs, only finished ones count.
    """
    has_parts = not request.has_training and request.table != factorial.TABLE
    return is_finished(run) or (has_parts and checkpoint_step(run) is not None)


def check_report(out: pathlib.Path) -> None:
    """Check the path of a report before hours of work.

    Raises:
        UserError: the path is that of a folder, or of a file that is written beside the report.
    """
    check_file(out)
    if out.suffix.lower() in (".svg", ".csv"):
        raise UserError(f"{shown(out)} would be a file beside the report; give the name of the report, such as out.md")


def parse_seeds(text: str) -> tuple[int, ...]:
    """Parse a number of seeds, such as "3" for 0, 1 and 2, or a list such as "0,5,7".

    Raises:
        UserError: the text has another form, or gives no seed or one twice.
    """
    parts = text.split(",")
    if not all(part.strip().isdecimal() for part in parts if part.strip()) or not text.strip(", "):
        raise UserError(f"--seeds {text} is neither a number of seeds nor a list such as 0,5,7")
    numbers = tuple(int(part) for part in parts if part.strip())
    if "," not in text and numbers[0] > _MOST_SEEDS:
        raise UserError(f"--seeds {text} is a number of seeds, at most {_MOST_SEEDS}; give '{text},' for one seed")
    seeds = numbers if "," in text else tuple(range(numbers[0]))
    if not seeds or len(set(seeds)) < len(seeds):
        raise UserError(f"--seeds {text} gives {'a seed twice' if seeds else 'no seed'}; give one or more, each once")
    return seeds


def parse_changes(texts: Sequence[str]) -> dict[str, Any]:
    """Parse changes of settings, KEY=VALUE each; a value that is not a Python literal is text.

    Raises:
        UserError: a text has no key or no value, or the setting is an option of its own.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        key, _, value = text.partition("=")
        if not key or not value:
            raise UserError(f"--changes {text} is not KEY=VALUE, such as train.steps=3000")
        if key in _OPTIONS:
            raise UserError(f"--changes cannot set {key}; give {_OPTIONS[key]}")
        try:
            changes[key] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            changes[key] = value
    return changes


def parse_data(text: str) -> tuple[str, str]:
    """Parse NAME or NAME:DIR of a data set; return its name and the folder, "" without one.

    Raises:
        UserError: there is no such data set.
    """
    data, _, folder = text.partition(":")
    if data not in presets.DATA:
        raise UserError(f"no data {data!r}; expected one of {', '.join(presets.DATA)}")
    return data, folder


def corpus_path(request: Request) -> pathlib.Path:
    """Return the folder of the corpus; make the Talk corpus if it is missing, a small one for the debug size, and that
    of the factorial study.

    Raises:
        UserError: the data set needs a path, or the Talk corpus cannot be made.
    """
    if request.path:
        return pathlib.Path(request.path).resolve()
    if request.data != "talk":
        raise UserError(f"--data {request.data} needs the folder of a corpus: --data {request.data}:DIR (docs/data.md)")
    table = request.table if request.table == factorial.TABLE else ""
    if (table, request.size == "debug") not in _CORPORA:
        return build.talk_path("talk").resolve()
    name, speakers, minutes = _CORPORA[table, request.size == "debug"]
    path = request.workdir.resolve() / name
    if not path.exists() and (request.has_training or not (request.workdir / KEPT).is_file()):
        build.make_talk(path, speakers=speakers, minutes=minutes, seed=0)
    return path


def _run(request: Request, plan: Plan, method: str, changes: Mapping[str, Any], row: str, seed: int) -> Run:
    """Return a run, named after the row, or only after the method if it has the method's own settings."""
    more = {"data.path": str(plan.corpus.path), "seed": seed}
    asked = dict(request.changes)
    if changes.get("model.audio.kind") != "whisper":
        asked.pop(_WHISPER, None)  # a setting of one row; the runs of the others do not change
    config = presets.make(request.data, request.size, method, {**asked, **changes, **more}).lock()
    plain = presets.make(request.data, request.size, method, {**asked, **more})
    settings.check(config)
    values = json.loads(config.to_json())
    is_plain = values == json.loads(plain.to_json())
    label = method if is_plain else f"{method}-{re.sub('[^a-z0-9]+', '-', row.lower()).strip('-')}"
    end = f"-{digest([without_path(values | {'seed': None}), plan.digest])}-seed{seed}"
    folder = request.workdir.resolve()
    run = Run(f"{request.data}-{request.size}-{label}{end}", seed, config, folder, {**asked, **changes})
    # Two tables may have different names for the same settings: an existing run is used, whatever its name.
    there = sorted(path.name for path in folder.glob(f"*{end}") if path.is_dir())
    kept = plan.kept.find(run)
    name = there[0] if there else run.name if kept is None else kept.name
    return run._replace(name=name, workdir=folder / name)


def _lacks_whisper(run: Run) -> bool:
    return run.config.model.audio.kind == "whisper" and not run.config.model.audio.weights


def _split(text: str) -> list[str]:
    """Split text at commas outside of brackets: "(0.5,0.9),(0.9,0.99)" has two values."""
    values, depth = [""], 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == "," and not depth:
            values.append("")
        else:
            values[-1] += character
    if depth or not all(values):
        raise UserError(f"{text!r} is not a list of values between commas; close the brackets and leave none empty")
    return values

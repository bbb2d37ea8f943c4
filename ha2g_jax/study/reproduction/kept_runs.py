"""Copies of finished runs without weights: what the report of a table needs, and small enough to be published."""

import json
import pathlib
import shutil
from collections.abc import Iterable, Sequence
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.files.partial_folder import partial_folder
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.study.reproduction.plan import Plan, Run, checkpoint_folder, is_finished, scores_path


def keep_runs(plan: Plan, has_legacy: bool, folder: pathlib.Path) -> list[str]:
    """Copy the finished runs that have scores, and the auto-encoder; files that are there already stay as they are.

    A copy has the settings, the record of the training, the metrics of the validation split, the scores, and the
    hashes of the checkpoints, but no weights. With the folder as the workdir, `reproduce` takes a copy for the run
    itself: it is not trained again, and its scores are reported. Only the auto-encoder keeps its weights, because
    the scores of further runs need them. Absolute paths are shortened to their last part.

    Args:
        plan: plan of the table.
        has_legacy: whether the scores include those of the public release.
        folder: folder of the copies.

    Returns:
        Names of the runs of which something was copied.

    Raises:
        UserError: a copy cannot be written.
    """
    runs = {run.name: run for run in (plan.autoencoder, *plan.runs) if is_finished(run)}
    scores = {name: scores_path(run, plan, has_legacy) for name, run in runs.items()}
    files = {name: [path] for name, path in scores.items() if path is not None and path.is_file()}
    if plan.autoencoder.name in runs:
        files[plan.autoencoder.name] = _weights(plan.autoencoder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [name for name, found in files.items() if _keep(runs[name], found, folder / name)]
    except OSError as error:
        raise UserError(f"cannot write to {shown(folder)} ({reason(error).lower()}); use another folder") from error


def _keep(run: Run, files: Sequence[pathlib.Path], copy: pathlib.Path) -> bool:
    """Make the copy of a run, or add the files that it lacks, such as scores of another kind; return whether it did."""
    if copy.is_dir():
        missing = [path for path in files if not (copy / path.relative_to(run.workdir)).exists()]
        for path in missing:
            with whole_file(copy / path.relative_to(run.workdir)) as temporary:
                shutil.copyfile(path, temporary)
        return bool(missing)
    with partial_folder(copy) as part:
        _copy(run, files, part)
        part.chmod(0o755)
        part.rename(copy)
    return True


def _weights(run: Run) -> list[pathlib.Path]:
    checkpoint = checkpoint_folder(run)
    files = [] if checkpoint is None else [path for path in checkpoint.rglob("*") if path.is_file()]
    return [run.workdir / "assets.json", *files]


def _copy(run: Run, files: Iterable[pathlib.Path], target: pathlib.Path) -> None:
    hashes = [path for name in ("best", "latest") for path in (run.workdir / name).glob("*/SHA256SUMS")]
    for path in {*files, *hashes}:
        copy = target / path.relative_to(run.workdir)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
    lines = (run.workdir / "metrics.jsonl").read_text().splitlines()
    validations = [line for line in lines[:-1] if any(name.startswith("validation/") for name in json.loads(line))]
    (target / "metrics.jsonl").write_text("\n".join([*validations, lines[-1]]) + "\n")
    for name in ("config.json", "run.json"):
        values = _without_folders(json.loads((run.workdir / name).read_text()))
        (target / name).write_text(json.dumps(values, indent=1) + "\n")


def _without_folders(values: Any) -> Any:
    """Return values of JSON in which only the last part of each absolute path is left."""
    match values:
        case dict():
            return {key: _without_folders(value) for key, value in values.items()}
        case list():
            return [_without_folders(value) for value in values]
        case str() if (path := pathlib.PurePath(values)).is_absolute():
            return path.name
    return values

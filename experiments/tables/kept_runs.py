"""Copies of finished runs without weights: what the report of a table needs, and small enough to be published."""

import json
import pathlib

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.files.writing import whole_file, whole_folder, writing
from ha2g_jax.train.workdir import METRICS, read_metrics
from tables.plan import Plan, Run, checkpoint_folder, is_finished, read_stored, scores_path

_HASHES = "SHA256SUMS"
_START = ("time", "step", "python", "versions", "commit", "hardware")  # what a copy says of each start of the training


def keep_run(run: Run, plan: Plan, has_legacy: bool, folder: pathlib.Path) -> None:
    """Copy a run if it is finished and has scores, or add scores that an earlier copy lacks.

    A copy has the settings (with the name of the corpus for its path), the record of the training, the metrics of the
    validation split, the scores, and the hashes of the checkpoints, but no weights. With `folder` as the workdir,
    `reproduce` takes a copy for the run itself: it is not trained again, and its scores are reported. Only the
    auto-encoder is copied with its weights, because the scores of further runs need them.

    Args:
        run: run or auto-encoder of the plan.
        plan: plan of the table.
        has_legacy: whether the scores include those of the public release.
        folder: folder of the copies, which is made.

    Raises:
        UserError: a file cannot be read or written, or there is a copy of another training of this run.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if not is_finished(run):
        return
    scores = None if run.name == plan.autoencoder.name else scores_path(run, plan, has_legacy)
    copy = _copy_of(run, folder)
    if copy.is_dir():
        if _hashes(copy) != _hashes(run.workdir):
            raise UserError(f"{shown(copy)} is a copy of another training of this run; use another folder")
        if scores is not None and read_stored(scores) is not None and read_stored(copy / scores.name) is None:
            with whole_file(copy / scores.name) as temporary:
                temporary.write_bytes(scores.read_bytes())
    elif run.name == plan.autoencoder.name:
        _write(_content(run) | _weights(run), copy)
    elif scores is not None and read_stored(scores) is not None:
        _write(_content(run) | {scores.name: scores.read_bytes()}, copy)


def _copy_of(run: Run, folder: pathlib.Path) -> pathlib.Path:
    """Return the folder of a copy, which another table may have made under the name that it has for these settings."""
    *_, settings, seed = run.name.split("-")
    return next(iter(sorted(folder.glob(f"*-{settings}-{seed}"))), folder / run.name)


def _hashes(workdir: pathlib.Path) -> dict[str, bytes]:
    """Return the hashes of the checkpoints of a run by their path in its workdir."""
    found = [path for name in ("best", "latest") for path in workdir.glob(f"{name}/*/{_HASHES}")]
    return {path.relative_to(workdir).as_posix(): path.read_bytes() for path in found}


def _content(run: Run) -> dict[str, bytes]:
    """Return the files of a copy by their path, without scores."""
    texts = {METRICS: "".join(json.dumps(line) + "\n" for line in read_metrics(run.workdir / METRICS, '"validation/'))}
    try:
        config = json.loads((run.workdir / "config.json").read_text())
        starts = json.loads((run.workdir / "run.json").read_text())["starts"]
        hashes = _hashes(run.workdir)
    except (OSError, ValueError, KeyError) as error:
        raise UserError(f"the files of {shown(run.workdir)} cannot be read ({reason(error).lower()})") from error
    config["data"]["path"] = pathlib.Path(config["data"]["path"]).name
    record = {"starts": [{key: start[key] for key in _START if key in start} for start in starts]}
    documents = {"config.json": config, "run.json": record}
    texts |= {name: json.dumps(values, indent=1) + "\n" for name, values in documents.items()}
    return {name: text.encode() for name, text in texts.items()} | hashes


def _weights(run: Run) -> dict[str, bytes]:
    checkpoint = checkpoint_folder(run)
    assert checkpoint is not None
    files = [run.workdir / "assets.json", *(path for path in checkpoint.rglob("*") if path.is_file())]
    return {path.relative_to(run.workdir).as_posix(): path.read_bytes() for path in files}


def _write(content: dict[str, bytes], copy: pathlib.Path) -> None:
    with whole_folder(copy) as folder:
        for name, data in content.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)

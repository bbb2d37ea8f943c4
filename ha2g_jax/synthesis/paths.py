"""Paths of generation: the speech that is read, and the files that are written for it, checked before the work."""

import os
import pathlib
import sys
from collections.abc import Sequence
from typing import NamedTuple

from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import has_sound
from ha2g_jax.files.reading import check_regular, reading, shown
from ha2g_jax.files.writing import check_kept
from ha2g_jax.motion import formats

VIDEO, PAGE = ".mp4", ".html"
SUFFIXES = (*formats.SUFFIXES, VIDEO, PAGE)
_APPENDED = "_gestures"
_DEFAULT_SUFFIXES = (".npz", VIDEO)
_EXPECTED = "a recording of speech"
_NAMES_SHOWN = 5

Path = str | pathlib.Path


class Task(NamedTuple):
    """A file of speech, and the files that are written for it."""

    speech: pathlib.Path
    paths: tuple[pathlib.Path, ...]


def plan(
    speech: Path | Sequence[Path], out: Path | None = None, suffix: str | None = None, others: Sequence[Path] = ()
) -> list[Task]:
    """Return what is read and written; no two files share a path, and each file of speech can be opened.

    Args:
        speech, out, suffix: see `synthesis.generate_files`.
        others: paths of the files that are read beside the speech.

    Raises:
        UserError: there is no speech, a file cannot be opened, the folder of the results cannot be written, a suffix is
            unknown, two results would have one path, or a result would overwrite a file that is read.
    """
    inputs = [pathlib.Path(path) for path in ([speech] if isinstance(speech, Path) else speech)]
    if not inputs:
        raise UserError("no file of speech; give the path of at least one")
    if suffix is not None and suffix not in SUFFIXES:
        raise UserError(f"cannot write {shown(suffix)}; expected one of {', '.join(SUFFIXES)}")
    if len(inputs) == 1 and not inputs[0].is_dir():
        tasks = [Task(inputs[0], out_paths(inputs[0], out, suffix))]
        _check_speech(inputs[0])
    else:
        folder = None if out is None else pathlib.Path(out)
        if folder is not None and folder.suffix.lower() in SUFFIXES and not folder.is_dir():
            raise UserError(f"{shown(folder)} would be a folder, for several files; name their format with --format")
        tasks = [Task(path, _gestures(path, folder, suffix)) for path in find_speech(inputs)]
        for target in {task.paths[0].parent for task in tasks}:
            _check_writable(target)
    results = [path for task in tasks for path in task.paths]
    check_kept(results, [*(task.speech for task in tasks), *map(pathlib.Path, others)])
    _check_distinct(tasks)
    return tasks


def out_paths(speech: pathlib.Path, out: Path | None = None, suffix: str | None = None) -> tuple[pathlib.Path, ...]:
    """Return the paths of the files that are written for one file of speech.

    Args:
        speech: path of the speech.
        out, suffix: see `synthesis.generate_files`.

    Raises:
        UserError: `out` has a suffix that is not one of `SUFFIXES`, or one although there is `suffix`.
    """
    if out is None or pathlib.Path(out).is_dir():
        return _gestures(speech, None if out is None else pathlib.Path(out), suffix)
    out = pathlib.Path(out)
    if not out.suffix:
        return _with_suffixes(out, suffix)
    if out.suffix.lower() not in SUFFIXES:
        raise UserError(
            f"cannot write {shown(out.name)}: {shown(out.suffix)}; expected one of {', '.join(SUFFIXES)}, or a name "
            "without a suffix for .npz and .mp4"
        )
    if suffix is not None:
        raise UserError(f"{shown(out.name)} names a format, and --format another time; leave out one of them")
    return (out,)


def _gestures(speech: pathlib.Path, folder: pathlib.Path | None, suffix: str | None) -> tuple[pathlib.Path, ...]:
    """Return the paths of the default name, in a folder or beside the speech."""
    return _with_suffixes((folder or speech.parent) / f"{speech.stem}{_APPENDED}", suffix)


def _with_suffixes(stem: pathlib.Path, suffix: str | None) -> tuple[pathlib.Path, ...]:
    return tuple(stem.with_name(stem.name + each) for each in ((suffix,) if suffix else _DEFAULT_SUFFIXES))


def find_speech(inputs: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    """Return the files of speech that are named, or are in a folder that is named, in order.

    Args:
        inputs: paths of files and folders.

    Raises:
        UserError: a file cannot be opened, or a folder has no speech.
    """
    found: list[pathlib.Path] = []
    for path in inputs:
        if path.is_dir():
            found += _in_folder(path)
        else:
            _check_speech(path)
            found.append(path)
    return found


def find_transcript(speech: pathlib.Path) -> pathlib.Path | None:
    """Find the transcript beside a file of speech, see `transcripts.find`; what was generated is no other recording.

    Args:
        speech: path of the speech.

    Returns:
        Path of the transcript, None if there is none.

    Raises:
        UserError: the folder cannot be read.
    """
    from ha2g_jax.features import words as transcripts

    if (found := transcripts.find(speech)) == transcripts.find(speech, is_alone=False):
        return found
    return found if _speech_among(_files_in(speech.parent)) == [speech] else None


def _in_folder(folder: pathlib.Path) -> list[pathlib.Path]:
    """Return the files with sound of a folder by name, without what was generated from the others before."""
    files = _files_in(folder)
    speech = _speech_among(files)
    if not speech:
        raise UserError(f"no file with sound in {shown(folder)}; give a folder of recordings of speech")
    if skipped := [shown(path.name) for path in files if path not in speech]:
        more = f" and {len(skipped) - _NAMES_SHOWN} more" if skipped[_NAMES_SHOWN:] else ""
        names = ", ".join(skipped[:_NAMES_SHOWN])
        tqdm.write(f"skipping files that are not speech in {shown(folder)}: {names}{more}", file=sys.stderr)
    return speech


def _files_in(folder: pathlib.Path) -> list[pathlib.Path]:
    """Return the files of a folder by name, without hidden ones."""
    with reading(folder, "a folder of recordings"):
        return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def _speech_among(files: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    """Return the files with sound, without what was generated from the others before."""
    sounds = [path for path in files if has_sound(path)]
    results = {f"{path.stem}{_APPENDED}" for path in sounds}
    return [path for path in sounds if path.stem not in results]


def _check_speech(path: pathlib.Path) -> None:
    check_regular(path, _EXPECTED)
    with reading(path, _EXPECTED), path.open("rb"):
        pass


def _check_writable(folder: pathlib.Path) -> None:
    """Check that a folder can be written, or made in the nearest one that exists."""
    existing = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    if not (existing.is_dir() and os.access(existing, os.W_OK)):
        raise UserError(f"cannot write in {shown(folder)}; give another folder with --out")


def _check_distinct(tasks: list[Task]) -> None:
    """Check that no result would overwrite another result."""
    writers: dict[pathlib.Path, pathlib.Path] = {}
    for task in tasks:
        for path in task.paths:
            resolved = path.resolve()
            if resolved in writers:
                raise UserError(
                    f"{shown(writers[resolved])} and {shown(task.speech)} would both be written to {shown(path)}; "
                    "generate them one after the other, with another --out"
                )
            writers[resolved] = task.speech

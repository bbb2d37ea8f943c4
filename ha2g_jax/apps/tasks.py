"""Choose the files of speech, and name the files that are generated for each of them."""

import os
import pathlib
import re
import sys
from collections.abc import Sequence
from typing import NamedTuple

from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.features.media import SOUND_SUFFIXES, has_sound
from ha2g_jax.files.reading import check_regular, reading, resolved, shown, why_not_there
from ha2g_jax.files.writing import check_kept
from ha2g_jax.motion import formats

VIDEO, PAGE = ".mp4", ".html"
SUFFIXES = (*formats.SUFFIXES, formats.FBX, VIDEO, PAGE)
_APPENDED, _SEED = "_gestures", "_seed"
_DEFAULT_SUFFIXES = (".npz", VIDEO)
_EXPECTED = "a recording of speech"
_NAMES_SHOWN = 5

Path = str | pathlib.Path


class Task(NamedTuple):
    """A file of speech, and the files that are written for it."""

    speech: pathlib.Path
    paths: tuple[pathlib.Path, ...]


def plan(
    speech: Path | Sequence[Path],
    out: Path | None = None,
    suffix: str | None = None,
    others: Sequence[Path] = (),
    seeds: Sequence[int] = (0,),
) -> list[Task]:
    """Return the tasks; no two files have the same path, and each file of speech can be opened.

    The arguments are those of `generate_files`; `others` are the paths of other files that are read, and `seeds` are
    those of the takes.

    Raises:
        UserError: there is no speech, a file cannot be opened, a result cannot be written, or would overwrite another
            one or a file that is read, or a suffix is unknown.
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
    if len(seeds) > 1:
        tasks = [Task(task.speech, _take_paths(task.paths, seeds)) for task in tasks]
    results = [path for task in tasks for path in task.paths]
    check_kept(results, [*(task.speech for task in tasks), *map(pathlib.Path, others)])
    _check_distinct(tasks)
    return tasks


def out_paths(speech: pathlib.Path, out: Path | None = None, suffix: str | None = None) -> tuple[pathlib.Path, ...]:
    """Return the paths of the files that are written for one file of speech, see `generate_files`.

    Raises:
        UserError: `out` has a suffix that is not one of `SUFFIXES`, or one although there is `suffix`.
    """
    if out is None or str(out).endswith(("/", os.sep)) or pathlib.Path(out).is_dir():
        return _gestures(speech, None if out is None else pathlib.Path(out), suffix)
    out = pathlib.Path(out)
    if not out.suffix or (suffix is not None and out.suffix.lower() not in SUFFIXES):
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
    return _with_suffixes((folder or speech.parent) / f"{speech.stem}{_APPENDED}", suffix)


def _with_suffixes(stem: pathlib.Path, suffix: str | None) -> tuple[pathlib.Path, ...]:
    return tuple(stem.with_name(stem.name + each) for each in ((suffix,) if suffix else _DEFAULT_SUFFIXES))


def _take_paths(paths: Sequence[pathlib.Path], seeds: Sequence[int]) -> tuple[pathlib.Path, ...]:
    """Return the paths of several takes, take by take, and that of the page with all of them."""
    takes = [path.with_name(f"{path.stem}{_SEED}{seed}{path.suffix}") for seed in seeds for path in paths]
    return (*takes, paths[0].with_name(f"{paths[0].stem}_takes{PAGE}"))


def find_speech(inputs: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    """Return the files of speech among the inputs, and those in folders among the inputs, in order.

    In a folder, files of sound and of video with sound are speech; a file whose suffix is one of sound is, even if it
    is damaged, so that its reader says so.

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
    """Find the transcript beside a file of speech, see `transcripts.find`; generated files do not count as recordings.

    Raises:
        UserError: the folder cannot be read.
    """
    from ha2g_jax.features import words as transcripts

    if (found := transcripts.find(speech)) == transcripts.find(speech, is_alone=False):
        return found
    return found if _speech_among(_files_in(speech.parent)) == [speech] else None


def _in_folder(folder: pathlib.Path) -> list[pathlib.Path]:
    files = _files_in(folder)
    speech = _speech_among(files)
    for path in files:
        if path not in speech and (why := why_not_there(path)):
            tqdm.write(f"{shown(path)} {why}", file=sys.stderr)
    if not speech:
        raise UserError(
            f"no file with sound in {shown(folder)}, whose subfolders are not searched; give a folder of recordings"
        )
    folders = sorted(f"{path.name}/" for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    if skipped := [*map(shown, folders), *(shown(path.name) for path in files if path not in speech)]:
        more = f" and {len(skipped) - _NAMES_SHOWN} more" if skipped[_NAMES_SHOWN:] else ""
        names = ", ".join(skipped[:_NAMES_SHOWN])
        tqdm.write(
            f"skipping subfolders and files that are not speech in {shown(folder)}: {names}{more}", file=sys.stderr
        )
    return speech


def _files_in(folder: pathlib.Path) -> list[pathlib.Path]:
    with reading(folder, "a folder of recordings"):
        return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def _speech_among(files: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    sounds = [path for path in files if path.suffix.lower() in SOUND_SUFFIXES or has_sound(path)]
    results = {f"{path.stem}{_APPENDED}" for path in sounds}
    return [path for path in sounds if re.sub(rf"{_SEED}\d+$", "", path.stem) not in results]


def _check_speech(path: pathlib.Path) -> None:
    check_regular(path, _EXPECTED)
    with reading(path, _EXPECTED), path.open("rb"):
        pass


def _check_writable(folder: pathlib.Path) -> None:
    existing = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    if not (existing.is_dir() and os.access(existing, os.W_OK)):
        raise UserError(f"cannot write in {shown(folder)}; give another folder with --out")


def _check_distinct(tasks: list[Task]) -> None:
    writers: dict[pathlib.Path, pathlib.Path] = {}
    for task in tasks:
        for path in task.paths:
            real = resolved(path)
            if real in writers:
                if resolved(writers[real]) == resolved(task.speech):
                    raise UserError(f"{shown(task.speech)} is given twice; give each file once")
                raise UserError(
                    f"{shown(writers[real])} and {shown(task.speech)} would both be written to {shown(path)}; "
                    "generate them one after the other, with another --out"
                )
            writers[real] = task.speech

"""Which videos there are, and how the corpus names them and their speakers."""

import collections
import os
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

from ha2g_jax.errors import UserError

SUFFIXES = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v")


class Talk(NamedTuple):
    """A video that was found.

    Attributes:
        video: its absolute path.
        name: its path within the folder that all videos share, without suffix unless another one has the same.
        speaker: the sub-folder of the shared folder that it lies in; its own name where it lies in none.
    """

    video: pathlib.Path
    name: str
    speaker: str


def find_talks(
    videos: Sequence[str | os.PathLike], without: pathlib.Path | None = None
) -> tuple[pathlib.Path, list[Talk]]:
    """The videos of files and folders, sorted by name.

    Args:
        videos: files, of any suffix, and folders, searched for `SUFFIXES` at any depth; hidden files are passed over.
        without: a folder to leave out.

    Returns:
        The folder that all share, and the videos.

    Raises:
        UserError: something is not there, or no video is found.
    """
    # Without following links: a video is named by where it was listed.
    given = [pathlib.Path(os.path.abspath(path)) for path in videos]  # noqa: PTH100
    if missing := [path for path in given if not path.exists()]:
        raise UserError(f"no file or folder at {missing[0]}; give videos, or folders of videos")
    found = {file for path in given for file in (_inside(path, without) if path.is_dir() else [path])}
    if not found:
        raise UserError(f"no video in {', '.join(map(str, given))}; expected files ending in {', '.join(SUFFIXES)}")
    root = pathlib.Path(os.path.commonpath([path if path.is_dir() else path.parent for path in given]))
    names = collections.Counter(_name(file, root) for file in found)
    talks = []
    for file in found:
        name = _name(file, root)
        name = name if names[name] == 1 else file.relative_to(root).as_posix()
        folder, slash, _ = name.partition("/")
        talks.append(Talk(file, name, folder if slash else name))
    return root, sorted(talks, key=lambda talk: talk.name)


def _inside(folder: pathlib.Path, without: pathlib.Path | None) -> list[pathlib.Path]:
    return [
        file
        for file in folder.rglob("*")
        if file.suffix.lower() in SUFFIXES
        and file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(folder).parts)
        and (without is None or without not in file.parents)
    ]


def _name(file: pathlib.Path, root: pathlib.Path) -> str:
    return file.relative_to(root).with_suffix("").as_posix()

"""Finding of videos, and their names and speakers in the corpus."""

import collections
import os
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.files.reading import check_regular, reading, shown

SUFFIXES = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v")


class VideoRecording(NamedTuple):
    """A video of a speaker.

    Attributes:
        video: absolute path of the video.
        name: path within the common folder of all videos, without suffix unless another video has the same path.
        speaker: first subfolder of the common folder, or `name` if the video lies directly in the common folder.
        is_alone: whether no other video is in its folder.
    """

    video: pathlib.Path
    name: str
    speaker: str
    is_alone: bool = True

    @property
    def transcript(self) -> pathlib.Path | None:
        """Return the transcript beside the video, None if there is none."""
        return transcripts.find(self.video, is_alone=self.is_alone)


def find_recordings(
    videos: Sequence[str | os.PathLike], without: pathlib.Path | None = None
) -> tuple[pathlib.Path, list[VideoRecording]]:
    """Find the videos of files and folders, sorted by name.

    Args:
        videos: paths of files of any suffix, and of folders, which are searched for `SUFFIXES` at any depth; hidden
            files are skipped.
        without: folder to leave out.

    Returns:
        The common folder of all videos, and the videos.

    Raises:
        UserError: a path does not exist, or no video is found.
    """
    # Links are not followed, so that a video is named by the path where it was found.
    given = [pathlib.Path(os.path.abspath(path)) for path in videos]  # noqa: PTH100
    for path in given:
        with reading(path, "a video or a folder of videos"):
            if not path.exists():
                raise UserError(f"no file or folder at {shown(path)}; give videos, or folders of videos")
        if not path.is_dir():
            check_regular(path, "a video")
    found = {file for path in given for file in (_inside(path, without) if path.is_dir() else [path])}
    if not found:
        raise UserError(f"no video in {', '.join(map(shown, given))}; expected files ending in {', '.join(SUFFIXES)}")
    root = pathlib.Path(os.path.commonpath([path if path.is_dir() else path.parent for path in given]))
    names = collections.Counter(_name(file, root) for file in found)
    recordings, in_folder = [], collections.Counter(file.parent for file in found)
    for file in found:
        name = _name(file, root)
        name = name if names[name] == 1 else shown(file.relative_to(root).as_posix())
        folder, slash, _ = name.partition("/")
        recordings.append(VideoRecording(file, name, folder if slash else name, in_folder[file.parent] == 1))
    return root, sorted(recordings, key=lambda recording: recording.name)


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
    return shown(file.relative_to(root).with_suffix("").as_posix())

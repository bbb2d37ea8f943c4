"""Pages of the viewer from files of motion, sound and words."""

import collections
import pathlib
from collections.abc import Sequence

from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.audio import read_audio
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import check_kept
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.joint_maps import AUTO
from ha2g_jax.viewer.page import write_page

_FPS = 30


def view_files(
    motions: Sequence[pathlib.Path],
    out: pathlib.Path,
    *,
    audio: pathlib.Path | None = None,
    words: pathlib.Path | None = None,
    joint_map: str = AUTO,
    source_fps: float | None = None,
) -> pathlib.Path:
    """Write a page with the motions of several files side by side, each with the name of its file.

    Args:
        motions: files of any kind of motion, see `motion_files`.
        out: `.html` file to write.
        audio: audio or video file with the sound.
        words: transcript with times, or without times if there is sound that it can be aligned to.
        joint_map: names of the joints, see `motion.readers.read_motion`.
        source_fps: frames per second of files that do not say it.

    Returns:
        Path of the page.

    Raises:
        UserError: a file cannot be read or does not hold a motion, or the page cannot be written.
    """
    check_kept([out], [*motions, audio, words], what="page", option="-o")
    read = (read_shown(path, joint_map=joint_map, source_fps=source_fps) for path in motions)
    named = dict(zip(names_of(motions), read, strict=True))
    samples = None if audio is None else read_audio(audio)
    spoken = ()
    if words is not None:
        spoken = (
            transcripts.read_words(words) if samples is None else transcripts.words_of(samples, words, recognise=None)
        )
    return write_page(out, named, samples, words=spoken)


def read_shown(path: pathlib.Path, *, joint_map: str = AUTO, source_fps: float | None = None) -> Motion:
    """Read the motion of a file to be shown, that of others at 30 frames per second.

    Args:
        path: file of any kind of motion, see `motion_files`.
        joint_map: names of the joints, see `motion.readers.read_motion`.
        source_fps: frames per second of a file that does not say it.

    Raises:
        UserError: the file cannot be read or does not hold a motion.
    """
    return read_motion(path, fps=_FPS, joint_map=joint_map, source_fps=source_fps)


def names_of(paths: Sequence[pathlib.Path]) -> list[str]:
    """Choose a name for each file: its stem, with its folder where two stems are equal, or else its path.

    Args:
        paths: files to name.

    Returns:
        Different names in the order of the files.

    Raises:
        UserError: a file is given twice.
    """
    names = [shown(path.stem) for path in paths]
    for name in (lambda path: f"{path.parent.resolve().name}/{path.stem}", lambda path: path):
        counts = collections.Counter(names)
        names = [old if counts[old] == 1 else shown(name(path)) for old, path in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        raise UserError(f"{shown(', '.join(map(str, paths)))} contains a motion twice; give each file once")
    return names

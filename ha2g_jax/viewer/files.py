"""Pages of the viewer from files of motion, sound and words."""

import collections
import pathlib
from collections.abc import Sequence

from ha2g_jax.data import transcripts
from ha2g_jax.data.mocap.motion import read_motion
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.files.reading import shown
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton, positions_to_directions
from ha2g_jax.viewer.page import write_page

_BVH_FPS = 30


def view_files(
    motions: Sequence[pathlib.Path],
    out: pathlib.Path,
    *,
    audio: pathlib.Path | None = None,
    words: pathlib.Path | None = None,
) -> pathlib.Path:
    """Write a page with the motions of several files side by side, each with the name of its file.

    Args:
        motions: `.npz` files of `ha2g generate`, or `.bvh` files with a skeleton that `ha2g data import-bvh` supports.
        out: `.html` file to write.
        audio: audio or video file with the sound.
        words: transcript with times, or without times if there is sound that it can be aligned to.

    Returns:
        Path of the page.

    Raises:
        UserError: a file cannot be read or does not hold a motion, or the page cannot be written.
    """
    if out in motions or out in (audio, words):
        raise UserError(f"the page would overwrite {shown(out)}; choose another name with -o")
    named = dict(zip(names_of(motions), map(_read, motions), strict=True))
    samples = None if audio is None else read_audio(audio)
    spoken = ()
    if words is not None:
        spoken = (
            transcripts.read_words(words) if samples is None else transcripts.words_of(samples, words, recognise=None)
        )
    return write_page(out, named, samples, words=spoken)


def _read(path: pathlib.Path) -> Motion:
    if path.suffix.lower() != ".bvh":
        return Motion.load(path)
    skeleton = load_skeleton("ted_expressive")
    positions = read_motion(path, skeleton, fps=_BVH_FPS).positions
    return Motion.from_directions(skeleton, positions_to_directions(skeleton, positions), _BVH_FPS)


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
    for name in (lambda path: shown(f"{path.resolve().parent.name}/{path.stem}"), shown):
        counts = collections.Counter(names)
        names = [old if counts[old] == 1 else name(path) for old, path in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        raise UserError(f"{', '.join(map(shown, paths))} contains a motion twice; give each file once")
    return names

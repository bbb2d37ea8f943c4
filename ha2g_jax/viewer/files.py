"""Files in, a page out."""

import collections
import pathlib
from collections.abc import Sequence

from ha2g_jax.data import transcripts
from ha2g_jax.data.mocap.motion import read_motion
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
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
    """Write a page with the motion of several files side by side, each under its file's name.

    Args:
        motions: `.npz` that `ha2g generate` wrote, or `.bvh` of a skeleton that `ha2g data import-bvh` knows.
        out: the `.html` to write.
        audio: a file with sound.
        words: a transcript, with times, or without them if there is sound to align it to.

    Returns:
        The path of the page.

    Raises:
        UserError: a file cannot be read or is no motion, or the page cannot be written.
    """
    if out in motions or out in (audio, words):
        raise UserError(f"the page would overwrite {out}; choose another name with -o")
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
    """Return a name for each file: its stem, with its folder where two have the same, its path where that is not enough.

    Raises:
        UserError: a file is named twice.
    """
    names = [path.stem for path in paths]
    for name in (lambda path: f"{path.resolve().parent.name}/{path.stem}", lambda path: str(path)):
        counts = collections.Counter(names)
        names = [old if counts[old] == 1 else name(path) for old, path in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        raise UserError(f"{', '.join(map(str, paths))} names a motion twice; give each once")
    return names

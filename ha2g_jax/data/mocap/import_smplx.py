"""Imports SMPL-X motion with its sound and words as a corpus."""

import collections
import functools
import os
import pathlib
import re

from ha2g_jax.data.import_report import Report
from ha2g_jax.data.mocap.axes import UPS
from ha2g_jax.data.mocap.importing import FileMotion, import_files
from ha2g_jax.data.mocap.smplx import AUTO, read_smplx
from ha2g_jax.data.mocap.smplx_model import read_body_model
from ha2g_jax.data.mocap.smplx_template import Body, template
from ha2g_jax.data.mocap.sources import AUDIO_SUFFIXES, Source, find_sources
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton

_SUFFIX = ".npz"
_TIMED_WORDS = ".textgrid"
# BEAT2 calls a recording NUMBER_SPEAKER_..., and keeps motion, sound and words in folders of their own.
_BEAT_NAME = re.compile(r"\d+_([A-Za-z]+)(_\d+){3}")


def import_smplx(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    *,
    model: str | os.PathLike | None = None,
    up: str = AUTO,
    source_fps: float | None = None,
    audio: str | os.PathLike | None = None,
    words: str | os.PathLike | None = None,
    speaker: str | None = None,
    split: str = "train",
    fps: float = 15,
    skeleton: str = "ted_expressive",
    with_words: bool = True,
    licence: str = "",
) -> Report:
    """Writes a corpus of one file of SMPL-X motion, or of all .npz in a folder and below it; see `smplx.read_smplx`.

    Sound and words lie beside the motion and have its stem; where they do not, sound and TextGrids of that stem are
    looked for in the whole of `src`, as BEAT2 has them. For broken files and lengths see `importing.import_files`.

    Args:
        src: a .npz, a .npy of joint positions, or a folder.
        dst: folder to make.
        model: the user's SMPL-X body model (.npz), for joints of the right shape; None for the neutral template.
        up: axis of the files that points up, one of `axes.UPS`, or "auto".
        source_fps: frames per second of the files; None for what they say.
        audio: the sound of the only file; any format of `read_audio`.
        words: the transcript of the only file.
        speaker: name of the speaker of all files; by default that in a name like BEAT2's, else the folder of a file
            where `src` has subfolders, else the file's name.
        split: name of the split to write.
        fps: frames per second of the corpus.
        skeleton: "ted_expressive" or "ted_gesture".
        with_words: whether a recording needs a transcript; without one, its windows need no words.
        licence: of the data, noted in the corpus.

    Returns:
        What was kept and left out; also in the corpus, under "import".

    Raises:
        UserError: no file, or none that can be used, or `dst` exists, or an option has no such value.
    """
    src = pathlib.Path(src)
    if up not in (AUTO, *UPS):
        raise UserError(f"up {up!r}; expected {AUTO} or one of {', '.join(UPS)}")
    if source_fps is not None and not 1 <= source_fps <= 2000:
        raise UserError(f"{source_fps:g} frames per second of the files; expected 1 to 2000")
    sources = find_sources(
        src,
        _SUFFIX,
        audio=None if audio is None else pathlib.Path(audio),
        words=None if words is None else pathlib.Path(words),
        speaker=speaker,
    )
    if src.is_dir():
        sources = _with_folders_of_beat(sources, src)
    if speaker is None:
        sources = [_with_speaker_of_beat(source) for source in sources]
    body = template() if model is None else read_body_model(model)
    read = functools.partial(_read, body=body, skeleton=skeleton, fps=fps, source_fps=source_fps, up=up)
    joints = "neutral template" if model is None else f"body model {pathlib.Path(model).name}"
    name = src.resolve().name
    metadata = {"name": name, "source": f"SMPL-X files: {name}, {joints}", "licence": licence}
    return import_files(
        sources, read, dst, skeleton=skeleton, fps=fps, split=split, with_words=with_words, metadata=metadata
    )


def _read(path: pathlib.Path, body: Body, skeleton: str, fps: float, source_fps: float | None, up: str) -> FileMotion:
    motion = read_smplx(path, load_skeleton(skeleton), body, fps=fps, source_fps=source_fps, up=up)
    return FileMotion(motion.positions, motion.seconds, f"{motion.kind}, {motion.up} up")


def _with_folders_of_beat(sources: list[Source], root: pathlib.Path) -> list[Source]:
    """The sources with sound and words from other folders, where one file of that name is all there is."""
    found: dict[tuple[str, bool], list[pathlib.Path]] = collections.defaultdict(list)
    for path in sorted(root.rglob("*")):
        suffix = path.suffix.lower()
        if suffix in AUDIO_SUFFIXES or suffix == _TIMED_WORDS:
            found[path.stem, suffix == _TIMED_WORDS].append(path)

    def elsewhere(source: Source, is_words: bool) -> pathlib.Path | None:
        paths = found[source.path.stem, is_words]
        return paths[0] if len(paths) == 1 and paths[0].parent != source.path.parent else None

    return [source._replace(audio=elsewhere(source, False), words=elsewhere(source, True)) for source in sources]


def _with_speaker_of_beat(source: Source) -> Source:
    name = _BEAT_NAME.fullmatch(source.path.stem)
    return source._replace(speaker=name.group(1)) if name else source

"""Generate files from files of speech: motions, videos, pages, and the formats of other programs."""

import contextlib
import pathlib
import sys
from collections.abc import Callable, Sequence
from typing import Any, Unpack

import numpy as np
from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.files.writing import check_kept, whole_file
from ha2g_jax.motion import formats, rigs
from ha2g_jax.motion.motion import Motion
from ha2g_jax.progress import progress_bar, stage
from ha2g_jax.synthesis.backends import load
from ha2g_jax.synthesis.generator import Generator, Options
from ha2g_jax.synthesis.paths import PAGE, VIDEO, Path, Task, find_transcript, plan
from ha2g_jax.synthesis.speech import Audio, read_speech


def generate_files(
    speech: Path | Sequence[Path],
    out: Path | None = None,
    checkpoint: Path = "demo",
    *,
    backend: str | None = None,
    suffix: str | None = None,
    rig: str | None = None,
    words: pathlib.Path | None = None,
    size: int | tuple[int, int] = 720,
    report: Callable[[pathlib.Path], None] = lambda path: None,
    **options: Unpack[Options],
) -> tuple[pathlib.Path, ...]:
    """Generate motion for one or more files of speech and write it.

    The suffix of a result is its format: one of `motion.formats.SUFFIXES`, `.mp4` for a video with the sound, or
    `.html` for a page of the viewer with it. By default the motion (`.npz`) and the video (`.mp4`) are written, both or
    neither. Their names are those of the speech with `_gestures` appended, in the folder of the speech. What the work
    is and how long it has taken is shown on stderr.

    Args:
        speech: path of a file with sound; or several files, or a folder whose files with sound are taken.
        out: for one file, the file to write, whose suffix is the format, or a name without a suffix; for one or several
            files, a folder, which for several is made if it does not exist.
        checkpoint: model, see `backends.load`.
        backend: what computes the motion, one of `backends.BACKENDS`; by default the checkpoint decides.
        suffix: format of the results, one of `SUFFIXES`, where `out` names none.
        rig: joints of the results, see `motion.formats.export`; video and page have none.
        words: path of a transcript of the speech, for a model that reads words, where there is one file; by default a
            transcript beside the speech is used. HA2G needs none.
        size: width and height of the video in pixels, one number for both.
        report: is called with the path of each file when it is complete.
        options: keyword arguments of `Generator.generate`.

    Returns:
        The paths of the files.

    Raises:
        UserError: before anything is written, as `plan`, `backends.load` and `Generator.check_options`. One file of
            speech cannot be used, or a file cannot be written; of several files this is said in a line on stderr, and
            the error comes when the others are complete.
    """
    if words is not None:
        with reading(words, "a transcript"), words.open("rb"):
            pass
    tasks = plan(speech, out, suffix, _others(words, options))
    if words is not None and len(tasks) > 1:
        raise UserError(f"{shown(words)} is one transcript, and there are {len(tasks)} files; leave out --words")
    if rig is not None:
        for task in tasks:
            for path in task.paths:
                formats.choose_rig(path, rig)
    if any(path.suffix.lower() == VIDEO for task in tasks for path in task.paths):
        from ha2g_jax.motion.formats.video import check_size

        check_size((size, size) if isinstance(size, int) else size)
    with stage("loading the model"):
        model = load(checkpoint, backend)
    if model.reads_words and words is None:
        results = [path for task in tasks for path in task.paths]
        check_kept(results, [find_transcript(task.speech) for task in tasks])
    if len(tasks) == 1:
        _generate(model, tasks[0], words, rig, size, report, options)
        return tasks[0].paths
    model.check_options(**options)  # said once, not for each file
    failed = 0
    with progress_bar("generating", len(tasks), "file") as bar:
        for task in tasks:
            try:
                _generate(model, task, None, rig, size, report, options)
            except UserError as error:
                failed += 1
                tqdm.write(f"{shown(task.speech)} failed: {error}", file=sys.stderr)
            bar.update()
    if failed:
        raise UserError(f"{failed} of {len(tasks)} files failed, for the reasons above")
    return tuple(path for task in tasks for path in task.paths)


def _others(words: pathlib.Path | None, options: Options) -> list[Path]:
    """Return the paths of the files that are read beside the speech."""
    paths: list[Path] = [] if words is None else [words]
    seed_pose = options.get("seed_pose")
    if isinstance(seed_pose, Path):
        paths.append(seed_pose)
    style = options.get("style")
    images = None if style is None else style.images
    return [*paths, *([images] if isinstance(images, Path) else images or ())]


def _generate(
    model: Generator[Any],
    task: Task,
    words: pathlib.Path | None,
    rig: str | None,
    size: int | tuple[int, int],
    report: Callable[[pathlib.Path], None],
    options: Options,
) -> None:
    """Write the files of one file of speech, all or none."""
    with stage("reading the speech"):
        audio = read_speech(task.speech)
    spoken = read_words(model, task.speech, audio.samples, words)
    with contextlib.ExitStack() as stack:
        # The files are opened before the work, so that a path that cannot be written is noticed early.
        temporary = [stack.enter_context(whole_file(path)) for path in task.paths]
        with stage(f"generating {audio.duration:.1f} s of motion"):
            motion = model.generate(audio, words=spoken, **options)
        for path in temporary:
            _write(path, motion, audio, spoken, rig, size)
    for path in task.paths:
        report(path)


def _write(
    path: pathlib.Path,
    motion: Motion,
    audio: Audio,
    words: tuple[Word, ...],
    rig: str | None,
    size: int | tuple[int, int],
) -> None:
    """Write a motion in the format of the suffix of the path, with the sound if the format has sound."""
    suffix = path.suffix.lower()
    if suffix == VIDEO:
        from ha2g_jax.motion.formats.video import write_video

        write_video(path, motion, audio.samples, size=size)
        return
    with stage(f"writing {suffix}"):
        if suffix == PAGE:
            from ha2g_jax.viewer.page import write_page

            name = shown(pathlib.Path(audio.name or "").stem)
            write_page(path, {name: motion}, audio.samples, words=words)
        else:
            formats.export(motion, path, rig=rig or rigs.OWN)


def read_words(
    model: Generator[Any], speech: pathlib.Path, audio: np.ndarray, words: pathlib.Path | None
) -> tuple[Word, ...]:
    """Return the words of the speech; () if the model reads no words or there is no transcript.

    Args:
        model: model that the words are for.
        speech: path of the speech.
        audio: (samples,) float32 mono samples of the speech at 16 kHz.
        words: path of a transcript; by default one beside the speech.

    Raises:
        UserError: the transcript cannot be read.
    """
    if not model.reads_words:
        if words is not None:
            tqdm.write(f"{model.spec.method} reads no words: {shown(words)} is not used", file=sys.stderr)
        return ()
    words = words or find_transcript(speech)
    if words is None:
        tqdm.write(
            f"{model.spec.method} reads words, but {shown(speech)} has no transcript beside it: continuing without "
            "words; name a transcript with --words",
            file=sys.stderr,
        )
        return ()
    from ha2g_jax.features import words as transcripts

    return transcripts.words_of(audio, words, recognise=None)

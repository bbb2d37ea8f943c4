"""Generate files from files of speech: motions, videos, pages, and the formats of other programs."""

import contextlib
import functools
import pathlib
import sys
from collections.abc import Callable, Sequence
from typing import Any, Unpack

import numpy as np
from tqdm import tqdm

from ha2g_jax.apps.tasks import PAGE, VIDEO, Path, Task, find_transcript, plan
from ha2g_jax.checkpoint.onnx.reading import SUFFIX as ONNX
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.files.writing import check_kept, do_each, whole_file
from ha2g_jax.limits import MAX_MOTION_FRAMES
from ha2g_jax.motion import formats, rigs
from ha2g_jax.motion.control import NEUTRAL
from ha2g_jax.motion.cues import Cue
from ha2g_jax.motion.cues.cue import CLIP
from ha2g_jax.motion.cues.reading import read_clip
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.progress import stage
from ha2g_jax.synthesis.generator import Audio, Generator, Options, read_speech
from ha2g_jax.synthesis.style import check_seed
from ha2g_jax.viewer.page import MAX_MOTIONS, view

BACKENDS = ("jax", "onnx")
_SIZE = 720  # pixels of a side of a video


def load(checkpoint: str | pathlib.Path, backend: str | None = None) -> Generator[Any]:
    """Load a model for a backend.

    Args:
        checkpoint: a file of `ha2g model onnx`, or a model, see `synthesis.load`.
        backend: one of `BACKENDS`; by default "onnx" for a file of `ha2g model onnx`, and "jax" for any other model,
            which "onnx" exports to the cache folder once.

    Raises:
        UserError: there is no model, it is damaged, or the backend cannot use it.
    """
    if backend not in (None, *BACKENDS):
        raise UserError(f"no backend {backend!r}; expected {' or '.join(BACKENDS)}")
    is_file = pathlib.Path(checkpoint).suffix.lower() == ONNX and not pathlib.Path(checkpoint).is_dir()
    if backend == "jax" and is_file:
        raise UserError(f"{shown(checkpoint)} is for the backend onnx; give the model that it was exported from")
    if backend == "onnx" or is_file:
        from ha2g_jax.synthesis.onnx_model import exported, load_onnx

        return load_onnx(checkpoint if is_file else exported(checkpoint))
    from ha2g_jax.synthesis.model import load as load_model

    return load_model(checkpoint)


def generate_files(
    speech: Path | Sequence[Path],
    out: Path | None = None,
    checkpoint: Path = "demo",
    *,
    backend: str | None = None,
    suffix: str | None = None,
    rig: str | None = None,
    words: pathlib.Path | None = None,
    size: int | tuple[int, int] | None = None,
    camera: str | None = None,
    takes: int = 1,
    report: Callable[[pathlib.Path], None] = lambda path: None,
    **options: Unpack[Options],
) -> tuple[pathlib.Path, ...]:
    """Generate motion for one or more files of speech, write it, and return the paths of the results.

    The suffix of a result is its format: one of `motion.formats.SUFFIXES`, `.mp4` for a video with the sound, or
    `.html` for a page of the viewer with it. By default the motion (`.npz`) and the video (`.mp4`) are written, both or
    neither. Their names are those of the speech with `_gestures` appended, in the folder of the speech. Progress is
    shown on stderr.

    Args:
        speech: path of a file with sound; or several files, or a folder whose files with sound are taken.
        out: for one file, the file to write, whose suffix is the format, or a name without a suffix; for one or several
            files, a folder, which for several is made if it does not exist.
        checkpoint, backend: model and runtime, see `load`.
        suffix: format of the results, one of `tasks.SUFFIXES`, if `out` names none.
        rig: joints of the results, see `motion.formats.export`; video and page have none.
        words: path of a transcript of the speech, for a model that reads words, for cues on words and for pages, where
            there is one file; by default a transcript beside the speech is used. HA2G needs none.
        size: width and height of the video in pixels, one number for both; 720 by default.
        camera: camera of video and page, one of `figure.CAMERAS`, by default "body".
        takes: number of motions for each file, with the seeds `seed`, `seed + 1` and so on; of several, the names of
            the files end in `_seed0` and so on, and a page whose name ends in `_takes` shows all side by side.
        report: function that is called with the path of each file when it is complete.
        options: keyword arguments of `Generator.generate`.

    Raises:
        UserError: `plan`, `load` or `Generator.check_options` raises it, before anything is written; or a file of
            speech cannot be used or a file cannot be written. With several files, such a failure is reported on stderr,
            and the error is raised when the others are complete.
    """
    transcript = None
    if words is not None:
        from ha2g_jax.features.words import split_speaker

        transcript = split_speaker(words)[0]
        with reading(transcript, "a transcript"), transcript.open("rb"):
            pass
    if not 1 <= takes <= MAX_MOTIONS:
        raise UserError(f"{takes} takes; expected 1 to {MAX_MOTIONS}")
    first = check_seed(options.get("seed", 0))
    seeds = range(first, check_seed(first + takes - 1) + 1)
    tasks = plan(speech, out, suffix, _others(transcript, options), seeds)
    if words is not None and len(tasks) > 1:
        raise UserError(f"{shown(words)} is one transcript, and there are {len(tasks)} files; leave out --words")
    suffixes = {path.suffix.lower() for path in tasks[0].paths}
    motions = (*formats.SUFFIXES, formats.FBX)
    kinds = {"size": (size, (VIDEO,)), "camera": (camera, (VIDEO, PAGE)), "rig": (rig, motions)}
    for name, (value, of_option) in kinds.items():
        if value is not None and suffixes.isdisjoint(of_option):
            found = " and ".join(sorted(suffixes))
            raise UserError(f"--{name} does not apply to {found}; leave it out, or write {' or '.join(of_option)}")
    for path in (path for task in tasks for path in task.paths if path.suffix.lower() in motions):
        if rig is not None or path.suffix.lower() == formats.FBX:
            formats.choose_rig(path, rig or rigs.OWN)
    pixels = _SIZE if size is None else size
    if VIDEO in suffixes:
        from ha2g_jax.motion.formats.video import check_size

        check_size(pixels if isinstance(pixels, tuple) else (pixels, pixels))
    picture = {"size": pixels, "camera": camera or "body", "fps": options.get("fps")}
    with stage("loading the model"):
        model = load(checkpoint, backend)
    cues = tuple(read_clip(cue, model.assets.skeleton) for cue in options.get("cues", ()))
    options = {**options, "cues": cues}
    needs_words = model.reads_words or any(cue.word for cue in cues) or PAGE in suffixes
    if words is not None and not needs_words:
        raise UserError(f"{model.spec.method} reads no words; leave --words out, or write .html, which shows them")
    if needs_words and words is None:
        results = [path for task in tasks for path in task.paths]
        check_kept(results, [find_transcript(task.speech) for task in tasks])

    def generate(task: Task) -> None:
        _generate(model, task, seeds, words, rig, picture, report, options)

    model.check_options(**options)  # said once, not for each file
    if len(tasks) == 1:
        generate(tasks[0])
    else:
        do_each("generating", [(task.speech, functools.partial(generate, task)) for task in tasks])
    return tuple(path for task in tasks for path in task.paths)


def _others(transcript: pathlib.Path | None, options: Options) -> list[Path]:
    paths: list[Path] = [] if transcript is None else [transcript]
    seed_pose = options.get("seed_pose")
    if isinstance(seed_pose, Path):
        paths.append(seed_pose)
    style = options.get("style")
    paths += [pin.path for pin in options.get("controls", NEUTRAL).pins if pin.path is not None]
    names = [cue.name if isinstance(cue, Cue) else cue for cue in options.get("cues", ())]
    paths += [name.removeprefix(CLIP) for name in names if name.startswith(CLIP)]
    images = None if style is None else style.images
    return [*paths, *([images] if isinstance(images, Path) else images or ())]


def _generate(
    model: Generator[Any],
    task: Task,
    seeds: Sequence[int],
    words: pathlib.Path | None,
    rig: str | None,
    picture: dict[str, Any],
    report: Callable[[pathlib.Path], None],
    options: Options,
) -> None:
    with stage("reading the speech"):
        audio = read_speech(task.speech)
    frames = len(seeds) * num_frames(audio.duration, options.get("fps") or model.fps)
    if len(seeds) > 1 and frames > MAX_MOTION_FRAMES:
        raise UserError(
            f"{len(seeds)} takes of {shown(task.speech)} have {frames} frames, and a page of all takes at most "
            f"{MAX_MOTION_FRAMES}; give fewer --takes, or less --fps"
        )
    has_page = any(path.suffix.lower() == PAGE for path in task.paths)
    spoken = read_words(model, task.speech, audio.samples, words, options.get("cues", ()), are_shown=has_page)
    with contextlib.ExitStack() as stack:
        # The files are opened before the work, so that a path that cannot be written is noticed early.
        temporary = [stack.enter_context(whole_file(path)) for path in task.paths]
        motions = {}
        for index, seed in enumerate(seeds):
            with stage(f"generating {audio.duration:.1f} s of motion" + f", seed {seed}" * (len(seeds) > 1)):
                options["seed"] = seed
                motion = motions[f"seed {seed}"] = model.generate(audio, words=spoken, **options)
            count = len(temporary) // len(seeds)
            for path in temporary[index * count : (index + 1) * count]:
                _write(path, motion, audio, spoken, rig, picture)
        if len(seeds) > 1:
            view(motions, audio.samples, words=spoken, camera=picture["camera"]).save(temporary[-1])
    for path in task.paths:
        report(path)


def _write(
    path: pathlib.Path,
    motion: Motion,
    audio: Audio,
    words: tuple[Word, ...],
    rig: str | None,
    picture: dict[str, Any],
) -> None:
    suffix = path.suffix.lower()
    if suffix == VIDEO:
        from ha2g_jax.motion.formats.video import write_video

        write_video(path, motion, audio.samples, **picture)
        return
    with stage(f"writing {suffix}"):
        if suffix == PAGE:
            name = shown(pathlib.Path(audio.name or "").stem)
            view({name: motion}, audio.samples, words=words, camera=picture["camera"]).save(path)
        else:
            formats.export(motion, path, rig=rig or rigs.OWN)


def read_words(
    model: Generator[Any],
    speech: pathlib.Path,
    audio: np.ndarray,
    words: pathlib.Path | None,
    cues: Sequence[Cue | str] = (),
    *,
    are_shown: bool = False,
) -> tuple[Word, ...]:
    """Return the words of the speech (samples,) at 16 kHz for a model that reads words, a cue on a word or a page on
    which they are shown, by default from the transcript beside its file, if there is one.

    A page alone shows the words that have times, and is made without words if the file beside the speech has none.

    Raises:
        UserError: the transcript cannot be read, or there is none for a cue.
    """
    on_words = [cue for cue in cues if isinstance(cue, Cue) and cue.word]
    if not (model.reads_words or on_words or are_shown):
        return ()
    found = words or find_transcript(speech)
    if found is None and on_words:
        raise UserError(
            f"the cue {shown(on_words[0].name)} is on a word, but {shown(speech)} has no transcript beside it; "
            "name one with --words, or give times"
        )
    if found is None and model.reads_words:
        tqdm.write(
            f"{model.spec.method} reads words, but {shown(speech)} has no transcript beside it: continuing without "
            "words; name a transcript with --words",
            file=sys.stderr,
        )
    if found is None:
        return ()
    from ha2g_jax.features import words as transcripts

    if model.reads_words or on_words or words:
        return transcripts.words_of(audio, found, recognise=None, media=speech)
    try:
        return transcripts.read_words(found)
    except UserError as error:
        tqdm.write(f"the page has no words: {error}", file=sys.stderr)
        return ()

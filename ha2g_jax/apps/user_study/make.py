"""Make a study from folders of motion: the site with its videos, which is published, and the key, which is not."""

import datetime
import hashlib
import itertools
import json
import logging
import pathlib
import secrets
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Unpack

import numpy as np

from ha2g_jax.apps.user_study.design import (
    ATTENTION,
    KEY_FILE,
    RATING,
    Design,
    Key,
    Scene,
    Stimulus,
    item_as_json,
    make_design,
    write_key,
)
from ha2g_jax.apps.user_study.pages import DEFAULT_TITLE, Wording, read_wording, write_site
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import find_motions, find_sounds, not_read, sound_key
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.espeak import Voice, say
from ha2g_jax.files.reading import file_sha256, resolved, shown
from ha2g_jax.files.writing import check_new, whole_folder
from ha2g_jax.limits import MAX_SEED
from ha2g_jax.motion.formats.video import VIDEO_FPS, check_size, fit_view, write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import Reading, check_reading, read_motion
from ha2g_jax.motion.readers.recordings import other_rate
from ha2g_jax.progress import progress_bar
from ha2g_jax.skeleton import SKELETONS, load_skeleton

_logger = logging.getLogger(__name__)

_ID_LETTERS = 16
MIN_SECONDS, MAX_SECONDS = 1.0, 120.0  # of a clip

_TOLERANCE = 0.5  # seconds by which a motion may be shorter than its sound
_FADE = 0.03  # seconds at the end of a sound that is cut
_VOICE = Voice("en-us", "f2", pitch=50, pitch_range=50, rate=140)
_NUMBERS = ("zero", "one", "two", "three", "four", "five")
_BAND = 0.15  # metres above the figure for the text of a check
_SILENCE = 0.5  # seconds before and after the words of a check


def make_study(
    motions: Sequence[str],
    out: str | pathlib.Path,
    *,
    speech: pathlib.Path | None = None,
    protocol: Sequence[str] = (RATING,),
    clips: int | None = None,
    clip_seconds: float | None = None,
    per_participant: int = 24,
    attention: int = 2,
    title: str = DEFAULT_TITLE,
    consent: pathlib.Path | None = None,
    closing: pathlib.Path | None = None,
    post: str | None = None,
    size: int = 480,
    seed: int | None = None,
    **reading: Unpack[Reading],
) -> pathlib.Path:
    """Write a study atomically: `site/`, which is published, and `key.json`.

    Args:
        motions: folder of each system, as DIR or NAME=DIR, with motion of the same clips.
        out: folder to write, which does not exist or is empty.
        speech: folder of the sounds, see `read_sources`.
        protocol, per_participant, attention: see `make_design`.
        clips: number of clips, drawn at random; by default all.
        clip_seconds: length in seconds to which longer clips are cut.
        title, consent, closing, post: see `pages.read_wording`.
        size: side of the videos in pixels.
        seed: seed of all choices; drawn by default, so that the ids of the videos cannot be guessed.

    Raises:
        UserError: the folder exists or cannot be written, or the motion, the sound or a setting cannot be used.
    """
    out = pathlib.Path(out)
    check_size((size, size))
    wording = read_wording(title=title, consent=consent, closing=closing, post=post)
    check_new(out)
    seed = secrets.randbelow(MAX_SEED) if seed is None else seed
    systems = name_systems(motions)
    options = {"clips": clips, "clip_seconds": clip_seconds, "speech": speech}
    sources = read_sources(systems, seed=seed, **options, **reading)
    design = make_design(
        list(systems),
        sources.durations,
        list(dict.fromkeys(protocol)),
        per_participant=per_participant,
        attention=attention,
        seed=seed,
    )
    with whole_folder(out) as folder:
        media = folder / "site" / "media"
        media.mkdir(parents=True)
        render(design.scenes, sources, media, size=size)
        key = _make_key(design, media, list(systems), list(sources.durations), wording, seed)
        write_site(folder / "site", key, design.lists, wording)
        write_key(folder / KEY_FILE, key)
    return out


def _make_key(
    design: Design, media: pathlib.Path, systems: list[str], clips: list[str], wording: Wording, seed: int
) -> Key:
    unhashed = sorted(itertools.chain.from_iterable(stimuli.items() for stimuli in design.scenes.values()))
    stimuli = {name: stimulus._replace(sha256=file_sha256(media / f"{name}.mp4")) for name, stimulus in unhashed}
    content = [wording, seed, systems, [item_as_json(item) for item in design.items], stimuli, design.lists]
    study = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:_ID_LETTERS]
    return Key(
        study=study,
        title=wording.title,
        seed=seed,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        systems=tuple(systems),
        clips=tuple(clips),
        stimuli=stimuli,
        items=design.items,
        per_participant=design.per_participant,
    )


class Sources(NamedTuple):
    """What a study shows: motion by system and clip, all on one skeleton with the same bone lengths.

    The sounds are (samples,) float32 at 16 kHz by clip. Sound and all motions last at least as long as the clip.
    """

    motions: Mapping[str, Mapping[str, Motion]]
    sounds: Mapping[str, np.ndarray]
    durations: Mapping[str, float]


def name_systems(folders: Sequence[str]) -> dict[str, pathlib.Path]:
    """Return the folder of each system from DIR, whose name is that of the system, or NAME=DIR.

    Raises:
        UserError: two systems have one name, or a name is empty.
    """
    systems: dict[str, pathlib.Path] = {}
    for text in folders:
        name, equals, folder = text.partition("=")
        if not equals or pathlib.Path(text).is_dir():
            name, folder = resolved(text).name, text
        name = shown(name).strip()
        if not name or not folder:
            raise UserError(f"{shown(text)} names no system and folder; give DIR or NAME=DIR")
        if name in systems:
            raise UserError(f"two systems have the name {name}; give one of them another name with NAME=DIR")
        systems[name] = pathlib.Path(folder)
    return systems


def read_sources(
    systems: Mapping[str, pathlib.Path],
    *,
    speech: pathlib.Path | None = None,
    clips: int | None = None,
    clip_seconds: float | None = None,
    seed: int = 0,
    **reading: Unpack[Reading],
) -> Sources:
    """Read the motion of all systems and its sound; the options are those of `make_study`.

    The sound of a clip is the file of the same name in `speech`, or else beside the motion of any system. Every figure
    gets the bone lengths of the skeleton, so that participants cannot recognise systems by the build of a person.

    Raises:
        UserError: a folder lacks a clip, a clip lacks sound, motion is much shorter than its sound, a clip is shorter
            than 1 s or longer than 120 s, or a file cannot be read.
    """
    if clip_seconds is not None and not MIN_SECONDS <= clip_seconds <= MAX_SECONDS:
        raise UserError(f"clips of {clip_seconds:g} s; expected {MIN_SECONDS:g} to {MAX_SECONDS:g} s")
    found = {name: find_motions(folder) for name, folder in systems.items()}
    names = _choose(_common(found), clips, seed)
    paths = _find_sounds(systems, found, names, speech)
    motion_paths = [path for files in found.values() for path in files.values()]
    check_reading(motion_paths, **reading)
    for note in not_read(motion_paths, paths.values()):
        _logger.warning(note)
    fits = {read_motion(files[names[0]], **reading).meta["skeleton"] for files in found.values()}
    skeleton = max(fits, key=SKELETONS.index)  # the one with the most joints that the motion of every system has
    motions: dict[str, dict[str, Motion]] = {name: {} for name in systems}
    sounds, durations = {}, {}
    with progress_bar("reading", len(names), "clip") as bar:
        for clip in names:
            sounds[clip] = _read_sound(paths[clip], clip_seconds)
            durations[clip] = len(sounds[clip]) / SAMPLE_RATE
            for name, files in found.items():
                motion = _read(files[clip], skeleton, durations[clip], **reading)
                motions[name][clip] = motion
            lengths = (each[clip].num_frames / each[clip].fps for each in motions.values())
            durations[clip] = min(durations[clip], *lengths)
            bar.update()
    return Sources(motions, sounds, durations)


def _common(found: Mapping[str, Mapping[str, pathlib.Path]]) -> list[str]:
    names = sorted({clip for files in found.values() for clip in files})
    for system, files in found.items():
        if missing := [clip for clip in names if clip not in files]:
            more = f" and {len(missing) - 1} more" if missing[1:] else ""
            raise UserError(
                f"{system} has no motion of {shown(missing[0])}{more}, which another system has; give every folder the "
                "same clips"
            )
    return names


def _choose(names: list[str], count: int | None, seed: int) -> list[str]:
    if count is None:
        return names
    if not 1 <= count <= len(names):
        raise UserError(f"{count} clips of {len(names)}; give --clips of 1 to {len(names)}")
    chosen = np.random.default_rng([seed, count]).permutation(len(names))[:count]
    return [names[index] for index in sorted(chosen)]


def _find_sounds(
    systems: Mapping[str, pathlib.Path],
    found: Mapping[str, Mapping[str, pathlib.Path]],
    names: Sequence[str],
    speech: pathlib.Path | None,
) -> dict[str, pathlib.Path]:
    if speech is not None and not speech.is_dir():
        raise UserError(f"no folder at {shown(speech)}; give a folder of sounds to --speech")
    roots = list(systems.values()) if speech is None else [speech]
    folders = {(root / clip).parent for root in roots for clip in names}
    sounds = find_sounds({folder for folder in folders if folder.is_dir()})
    paths = {}
    for clip in names:
        keys = [sound_key(root / f"{clip}.x") for root in roots]
        if not (at := [sounds[key] for key in keys if key in sounds]):
            where = shown(speech) if speech is not None else "beside its motion"
            raise UserError(f"no sound of {shown(clip)} {where}; give the folder of the sounds with --speech")
        paths[clip] = at[0]
    return paths


def _read_sound(path: pathlib.Path, clip_seconds: float | None) -> np.ndarray:
    sound = read_audio(path)
    if clip_seconds is not None and len(sound) > (count := round(clip_seconds * SAMPLE_RATE)):
        fade = round(_FADE * SAMPLE_RATE)
        sound = sound[:count].copy()
        sound[-fade:] *= np.linspace(1, 0, fade, dtype=np.float32)
    seconds = len(sound) / SAMPLE_RATE
    if seconds < MIN_SECONDS:
        raise UserError(f"{shown(path)} has {seconds:.1f} s of sound; expected at least {MIN_SECONDS:g} s")
    if seconds > MAX_SECONDS:
        raise UserError(f"{shown(path)} has {seconds:.0f} s of sound; cut the clips with --clip-seconds, such as 10")
    return sound


def _read(path: pathlib.Path, skeleton: str, seconds: float, **options) -> Motion:
    motion = read_motion(path, skeleton=skeleton, fps=VIDEO_FPS, **options)
    has = motion.num_frames / motion.fps
    if has < seconds - _TOLERANCE:
        raise UserError(
            f"{shown(path)} has {has:.1f} s of motion for {seconds:.1f} s of sound"
            f"{other_rate(has, motion.meta.get('read_from', {}).get('fps'), seconds)}; give motion as long "
            f"as the sound, or cut all clips with --clip-seconds {max(MIN_SECONDS, int(has * 10) / 10):g}"
        )
    count = min(motion.num_frames, round(seconds * motion.fps) + 1)
    return Motion.from_directions(load_skeleton(skeleton), motion.directions[:count], motion.fps)


def render(
    scenes: Mapping[Scene, Mapping[str, Stimulus]], sources: Sources, folder: pathlib.Path, *, size: int = 480
) -> None:
    """Write the video of each stimulus as `ID.mp4`, a square of `size` pixels.

    Raises:
        UserError: espeak-ng cannot be loaded, or a file cannot be written.
    """
    with progress_bar("rendering", sum(map(len, scenes.values())), "video") as bar:
        for scene, stimuli in scenes.items():
            # In the order of the random ids, so that the times of the files do not tell the system.
            motions = {name: sources.motions[stimuli[name].system][stimuli[name].clip] for name in sorted(stimuli)}
            sound = _sound(scene, list(motions.values()), sources)
            view = fit_view(motions.values(), len(sound) / SAMPLE_RATE)
            view = view._replace(top=view.top - _BAND) if scene.part == ATTENTION else view
            text = f"Please choose {scene.number}" if scene.part == ATTENTION else ""
            for name, motion in motions.items():
                write_video(folder / f"{name}.mp4", {text: motion}, sound, size=size, view=view, has_progress=False)
                bar.update()


def _sound(scene: Scene, motions: Sequence[Motion], sources: Sources) -> np.ndarray:
    if scene.number is not None:
        words = say(f"This is a check. Please choose the number {_NUMBERS[scene.number]}.", _VOICE).audio
        return np.pad(words, round(_SILENCE * SAMPLE_RATE))
    seconds = min(sources.durations[scene.clip], *(motion.num_frames / motion.fps for motion in motions))
    return sources.sounds[scene.clip][: round(seconds * SAMPLE_RATE)]

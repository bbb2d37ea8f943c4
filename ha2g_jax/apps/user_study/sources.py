"""The motion and the sound that a study shows: one folder for each system, with motion of the same clips."""

import pathlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import find_motions, find_sounds, sound_key
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.files.reading import shown
from ha2g_jax.motion.formats.video import VIDEO_FPS
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import find_skeleton, read_motion
from ha2g_jax.motion.readers.joint_maps import AUTO
from ha2g_jax.progress import progress_bar
from ha2g_jax.skeleton import SKELETONS, load_skeleton

MIN_SECONDS, MAX_SECONDS = 1.0, 120.0  # of a clip

_TOLERANCE = 0.5  # seconds by which a motion may be shorter than its sound
_FADE = 0.03  # seconds at the end of a sound that is cut


class Sources(NamedTuple):
    """What a study shows.

    Attributes:
        motions: motion by system and clip, all of one skeleton with the same lengths of bones.
        sounds: (samples,) float32 at 16 kHz by clip.
        durations: length in seconds of each clip, in which there is sound and motion of every system.
    """

    motions: Mapping[str, Mapping[str, Motion]]
    sounds: Mapping[str, np.ndarray]
    durations: Mapping[str, float]


def name_systems(folders: Sequence[str]) -> dict[str, pathlib.Path]:
    """Return the folder of each system.

    Args:
        folders: DIR, whose name is that of the system, or NAME=DIR.

    Raises:
        UserError: two systems have one name, or a name is empty.
    """
    systems: dict[str, pathlib.Path] = {}
    for text in folders:
        name, equals, folder = text.partition("=")
        if not equals or pathlib.Path(text).is_dir():
            name, folder = pathlib.Path(text).resolve().name, text
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
    joint_map: str = AUTO,
    source_fps: float | None = None,
    seed: int = 0,
) -> Sources:
    """Read the motion of all systems and its sound.

    The sound of a clip is the file of the same name in `speech`, or else beside a motion. Every figure gets the
    lengths of bones of the skeleton, so that participants cannot tell systems by the build of a person.

    Args:
        systems: folder of each system.
        speech: folder of the sounds; by default they lie beside the motion of any system.
        clips: number of clips, drawn with the seed; by default all.
        clip_seconds: length in seconds to which longer clips are cut.
        joint_map: names of the joints, see `motion.readers.read_motion`.
        source_fps: frames per second of files that do not say it.
        seed: seed of the choice of clips.

    Raises:
        UserError: a folder lacks a clip, a clip lacks sound, motion is much shorter than its sound, a clip is shorter
            than 1 s or longer than 120 s, or a file cannot be read.
    """
    if clip_seconds is not None and not MIN_SECONDS <= clip_seconds <= MAX_SECONDS:
        raise UserError(f"clips of {clip_seconds:g} s; expected {MIN_SECONDS:g} to {MAX_SECONDS:g} s")
    found = {name: find_motions(folder) for name, folder in systems.items()}
    names = _choose(_common(found), clips, seed)
    paths = _find_sounds(systems, found, names, speech)
    skeleton = _common_skeleton(found, names[0], joint_map)
    motions: dict[str, dict[str, Motion]] = {name: {} for name in systems}
    sounds, durations = {}, {}
    with progress_bar("reading", len(names), "clip") as bar:
        for clip in names:
            sounds[clip] = _read_sound(paths[clip], clip_seconds)
            durations[clip] = len(sounds[clip]) / SAMPLE_RATE
            for name, files in found.items():
                motion = _read(files[clip], skeleton, durations[clip], joint_map=joint_map, source_fps=source_fps)
                motions[name][clip] = motion
            lengths = (each[clip].num_frames / each[clip].fps for each in motions.values())
            durations[clip] = min(durations[clip], *lengths)
            bar.update()
    return Sources(motions, sounds, durations)


def _common(found: Mapping[str, Mapping[str, pathlib.Path]]) -> list[str]:
    """Return the names of the clips, which every system must have."""
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


def _common_skeleton(found: Mapping[str, Mapping[str, pathlib.Path]], clip: str, joint_map: str) -> str:
    """Return the skeleton with the most joints that the motion of every system has."""
    fits = {find_skeleton(files[clip], joint_map) for files in found.values()}
    return max(fits, key=SKELETONS.index)


def _read(path: pathlib.Path, skeleton: str, seconds: float, **options) -> Motion:
    motion = read_motion(path, skeleton=skeleton, fps=VIDEO_FPS, **options)
    has = motion.num_frames / motion.fps
    if has < seconds - _TOLERANCE:
        raise UserError(
            f"{shown(path)} has {has:.1f} s of motion for {seconds:.1f} s of sound; give motion as long as the sound, "
            f"or cut all clips with --clip-seconds {max(MIN_SECONDS, int(has * 10) / 10):g}"
        )
    count = min(motion.num_frames, round(seconds * motion.fps) + 1)
    return Motion.from_directions(load_skeleton(skeleton), motion.directions[:count], motion.fps)

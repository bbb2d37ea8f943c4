"""Reading of a folder of motion from any system and one of reference motion, paired by name, at one frame rate."""

import collections
import functools
import os
import pathlib
import re
import unicodedata
from collections.abc import Collection, Container, Iterable, Mapping
from typing import Any, NamedTuple, Unpack

import numpy as np

from ha2g_jax.data.processes import parallel_map
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.evaluation.evaluate import DRAWS, Intervals, differences, measure
from ha2g_jax.evaluation.remarks import too_few_recordings
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.files.reading import files_below, folded, shown
from ha2g_jax.metrics import sanity
from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.times import audio_onsets
from ha2g_jax.metrics.sanity import MISMATCHED, TRUTH
from ha2g_jax.motion.readers import SUFFIXES, Reading, borders_of, is_motion, read_motion, smplx, smplx_arrays
from ha2g_jax.motion.readers.containers import read_content
from ha2g_jax.motion.readers.recordings import AUDIO_SUFFIXES
from ha2g_jax.motion.readers.smplx_body import JOINTS, Body, read_body_model, template
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.progress import track
from ha2g_jax.skeleton import Skeleton, load_skeleton

FPS = 15.0  # frames per second at which everything is scored, the rate of the paper's data
BEAT2 = "beat2"  # protocol of the papers on BEAT2, for SMPL-X motion

SAMPLE = re.compile(r"^sample_[0-9]+/")
"""Beginning of the names of motion in a pack of `ha2g genea`, which has a folder for each sample."""

MANIFEST = "manifest.json"
"""Name of the file of a pack that holds no motion."""

_UPPER = [JOINTS.index(name) for name in rests.UPPER_BODY]
_BEAT2_SOUNDS = "wave16k"
_GENERATED = re.compile(r"_gestures(_seed\d+)?$")  # what `ha2g generate` puts after the name of the speech
_PAIRS_PER_PROCESS = 32  # a process takes seconds to start
_SHOWN = 3
_DIED = "a process that read the motion was killed, perhaps because memory ran out; evaluate fewer files at once"


class Folders(NamedTuple):
    """The clips of two folders; several motions of one id are for the same speech. The notes say what was changed."""

    motion: list[ClipResult]
    reference: list[ClipResult]
    skeleton: Skeleton
    notes: list[str]


class _Pair(NamedTuple):
    """Files of one clip."""

    name: str
    recording: str
    motion: pathlib.Path
    reference: pathlib.Path
    audio: pathlib.Path | None


class FileMotion(NamedTuple):
    """Directions (T, bones, 3) and borders of windows at 15 frames per second, and the frame rate of the file."""

    directions: np.ndarray
    fps: float
    borders: tuple[int, ...]


class _Read(NamedTuple):
    motion: ClipResult
    reference: ClipResult
    rates: tuple[float, float]
    is_cut_to_sound: bool


def from_folders(
    motion: str | os.PathLike,
    reference: str | os.PathLike,
    *,
    skeleton: str | None = None,
    with_audio: bool = False,
    **reading: Unpack[Reading],
) -> Folders:
    """Read the files of two folders that have the same name, up to the suffix, or all motion for one reference file.

    Folders may have subfolders, which must then be the same in both. The clips of a subfolder are assumed to be cut
    from one recording; without subfolders every clip is a recording of its own. The sound of a clip is the audio file
    with the same name beside the reference, in `wave16k` beside the folder of the reference (BEAT2), or beside the
    motion. `_gestures` at the end of a name is ignored. All motion is resampled to 15 frames per second, see
    `motion.readers`.

    The skeleton is "ted_expressive" or "ted_gesture", by default the first of them that the first reference file fits;
    the legacy scores need `with_audio`.

    Raises:
        UserError: a folder holds no motion, the names do not meet, or a file cannot be used.
    """
    motions, references = find_motions(pathlib.Path(motion)), find_motions(pathlib.Path(reference))
    if pathlib.Path(reference).is_file():
        clips = dict.fromkeys(sorted(motions), *references)
    else:
        clips = {name: clip for name in sorted(motions) if (clip := clip_of(name, references)) is not None}
    if not clips:
        raise UserError(
            f"no file in {shown(motion)} has the name of one in {shown(reference)}: found "
            f"{_few(motions)} and {_few(references)}; give both the names of the clips"
        )
    if skeleton is None:
        first = read_motion(references[min(clips.values())], **reading)
        skeleton = first.meta["skeleton"]
    folders = {path.parent for path in (*motions.values(), *references.values())}
    folders |= {side for path in references.values() if (side := path.parent.parent / _BEAT2_SOUNDS).is_dir()}
    sounds = find_sounds(folders)
    pairs = []
    for file, clip in clips.items():
        places = (
            references[clip],
            references[clip].parent.parent / _BEAT2_SOUNDS / references[clip].name,
            motions[file],
            motions[file].with_name(f"{clip.rpartition('/')[2]}.npz"),
        )
        audio = next((sounds[key] for place in places if (key := sound_key(place)) in sounds), None)
        pairs.append(_Pair(clip, clip.rpartition("/")[0] or clip, motions[file], references[clip], audio))
    options = {"skeleton": skeleton, "reading": reading, "with_audio": with_audio}
    processes = min(os.cpu_count() or 1, 1 + len(pairs) // _PAIRS_PER_PROCESS)
    with parallel_map(processes, _DIED) as each:
        found = each(functools.partial(_read, **options), pairs)
        read = list(track(found, "reading the motion", "clip", len(pairs)))
    truth = references_of(pair.reference for pair in read)
    left_out = {"motion": motions.keys() - clips.keys(), "reference": references.keys() - truth.keys()}
    notes = _notes(read, [pair for pair in read if pair.reference is truth[pair.reference.id]], left_out)
    sides = ((pathlib.Path(motion), motions), (pathlib.Path(reference), references))
    from_folder = [path for side, found in sides if side.is_dir() for path in found.values()]
    notes += not_read(from_folder, [pair.audio for pair in pairs if pair.audio is not None])
    return Folders([pair.motion for pair in read], list(truth.values()), load_skeleton(skeleton), notes)


def references_of(clips: Iterable[ClipResult]) -> dict[str, ClipResult]:
    """Return one reference for each clip by its id: of several the first with sound, which may lie beside a motion."""
    found: dict[str, ClipResult] = {}
    for clip in clips:
        if clip.id not in found or (found[clip.id].onsets is None and clip.onsets is not None):
            found[clip.id] = clip
    return found


def read_directions(path: pathlib.Path, skeleton: str, **reading: Unpack[Reading]) -> FileMotion:
    """Read the direction vectors of a file, about which `reading` is known, at 15 frames per second.

    Raises:
        UserError: the file cannot be read or is motion of another skeleton.
    """
    motion = read_motion(path, skeleton=skeleton, fps=FPS, **reading)
    fps = motion.meta.get("read_from", {}).get("fps", motion.fps) if motion.fps == FPS else motion.fps
    if motion.fps == FPS and fps % FPS:  # not frames of the file: all formats are resampled alike, below
        motion = read_motion(path, skeleton=skeleton, **reading)
    borders = borders_of(motion, path)
    if motion.fps == FPS:
        return FileMotion(np.asarray(motion.directions, np.float32), fps, borders)
    places = tuple(sorted({round(border * FPS / motion.fps) for border in borders}))
    count = num_frames(motion.num_frames / motion.fps, FPS)
    return FileMotion(resample(motion.directions, motion.fps, FPS, count), fps, places)


def clip_of(name: str, clips: Container[str]) -> str | None:
    """Return the clip of a file of motion, such as talk for talk, talk.2 and sample_2/talk, None if there is none."""
    clip, _, number = name.rpartition(".")
    found = (name, _GENERATED.sub("", clip) if number.isdecimal() else "", SAMPLE.sub("", name))
    return next((clip for clip in found if clip in clips), None)


def find_motions(folder: pathlib.Path) -> dict[str, pathlib.Path]:
    """Find the files of motion in a folder and its subfolders by the names of their clips; or a file by its own.

    Returns:
        As `list_motions`, without `_gestures` at the end of the names.

    Raises:
        UserError: there is no folder, no motion in it, or two files have the name of one clip.
    """
    found: dict[str, pathlib.Path] = {}
    for name, path in list_motions(folder).items():
        clip = unicodedata.normalize("NFC", _GENERATED.sub("", name))
        if clip in found:
            raise UserError(f"{shown(found[clip])} and {shown(path)} are motions of one clip; move one of them")
        found[clip] = path
    return found


def list_motions(folder: pathlib.Path) -> dict[str, pathlib.Path]:
    """List the files of motion in a folder and its subfolders; or one file.

    Of several files with one name the first kind of `SUFFIXES` is the motion, as others may hold words; so may a
    `.json` beside the motion of its clip, with or without `_gestures`.

    Returns:
        Path of the file by its path in the folder, without the suffix.

    Raises:
        UserError: there is no folder, or no motion in it, or it is a .zip.
    """
    if folder.is_file() and folder.suffix.lower() == ".zip":
        raise UserError(f"{shown(folder)} is a .zip, such as a pack of ha2g genea; unpack it and give the folder")
    if folder.is_file():
        return {folder.stem: folder}
    if not folder.is_dir():
        raise UserError(f"no file or folder at {shown(folder)}; give a folder of motion in {', '.join(SUFFIXES)}")
    found, clips = dict[str, pathlib.Path](), set[str]()
    paths = (path for path in files_below(folder) if is_motion(path))
    kinds = {suffix: rank for rank, suffix in enumerate(SUFFIXES)}
    for path in sorted(paths, key=lambda path: (kinds[path.suffix.lower()], path)):
        if not path.name.startswith(".") and path.name != MANIFEST:
            name = path.relative_to(folder).with_suffix("").as_posix()
            clip = _GENERATED.sub("", name)
            if path.suffix.lower() != ".json" or clip not in clips:
                found.setdefault(name, path)
                clips.add(clip)
    if not found:
        raise UserError(f"no motion in {shown(folder)}; expected files of {', '.join(SUFFIXES)}")
    return found


def find_sounds(folders: set[pathlib.Path]) -> dict[tuple[pathlib.Path, str], pathlib.Path]:
    """Find the files of sound that lie in folders, not in their subfolders.

    Returns:
        Path of the file by what `sound_key` gives for it and for the motion with its sound.
    """
    ranks = {suffix: rank for rank, suffix in enumerate(AUDIO_SUFFIXES)}
    sounds: dict[tuple[pathlib.Path, str], pathlib.Path] = {}
    for folder in folders:
        files = [path for path in folder.iterdir() if path.suffix.lower() in ranks and path.is_file()]
        for path in sorted(files, key=lambda path: (ranks[path.suffix.lower()], path)):
            sounds.setdefault(sound_key(path), path)
    return sounds


def not_read(motions: Iterable[pathlib.Path], sounds: Iterable[pathlib.Path]) -> list[str]:
    """Return notes on the files of motion and of sound that are not read, because another file of the same clip is.

    A `.json` does not count, as it may hold words.
    """
    notes = []
    for kind, paths, suffixes in (
        ("motion", set(motions), {*SUFFIXES} - {".json"}),
        ("sound", set(sounds), {*AUDIO_SUFFIXES}),
    ):
        read = {sound_key(path): path for path in paths}
        files = (path for folder in {path.parent for path in paths} for path in folder.iterdir())
        others = sorted(
            path
            for path in files
            if path.suffix.lower() in suffixes and path not in paths and sound_key(path) in read
            if kind == "sound" or is_motion(path)
        )
        if others:
            example = f"{shown(others[0].name)} beside {shown(read[sound_key(others[0])].name)}"
            notes.append(f"files of {kind} that are not read, as another is of the same clip: {len(others)}, {example}")
    return notes


def sound_key(path: pathlib.Path) -> tuple[pathlib.Path, str]:
    """Return the key that a motion and the sound beside it share: the folder, and the name of the clip."""
    return path.parent, folded(_GENERATED.sub("", path.stem))


def _read(pair: _Pair, skeleton: str, reading: Reading, with_audio: bool) -> _Read:
    motion, reference = (read_directions(path, skeleton, **reading) for path in (pair.motion, pair.reference))
    audio = None if pair.audio is None else read_audio(pair.audio)
    onsets, num_frames = None, len(reference.directions)
    if audio is not None:
        onsets = audio_onsets(audio, min(len(audio) / SAMPLE_RATE, (num_frames + 1) / FPS))
        num_frames = max(1, round(len(audio) / SAMPLE_RATE * FPS))
    own = {"id": pair.name, "recording": pair.recording, "fps": FPS}
    true = {"onsets": onsets, "audio": audio if with_audio else None, "borders": reference.borders}
    return _Read(
        ClipResult(directions=motion.directions, borders=motion.borders, path=pair.motion, **own),
        ClipResult(directions=reference.directions[:num_frames], path=pair.reference, **true, **own),
        (motion.fps, reference.fps),
        num_frames < len(reference.directions) - 1,
    )


def _notes(read: list[_Read], once: list[_Read], left_out: Mapping[str, Collection[str]]) -> list[str]:
    """Return sentences on what was done to all motion, and to the references, each of which is in `once` once."""
    notes = []
    for which, names in left_out.items():
        if names:
            notes.append(f"files of {which} that have no counterpart and are left out: {len(names)}, {_few(names)}")
    for which, index, pairs in (("motion", 0, read), ("reference", 1, once)):
        rates = collections.Counter(pair.rates[index] for pair in pairs if pair.rates[index] != FPS)
        for rate, count in sorted(rates.items()):
            notes.append(f"clips whose {which} was resampled from {rate:.6g} to {FPS:g} frames per second: {count}")
    if cut := sum(pair.is_cut_to_sound for pair in once):
        notes.append(f"clips whose reference was cut to the length of the sound: {cut}")
    return notes


def _few(names: Collection[str]) -> str:
    first = ", ".join(shown(name) for name in sorted(names)[:_SHOWN])
    return f"{first}, ..." if len(names) > _SHOWN else first


def score_beat2(
    read: Mapping[str, Folders],
    *,
    body_model: str | os.PathLike | None = None,
    seed: int = 0,
    **reading: Unpack[Reading],
) -> dict[str, Any]:
    """Score folders of SMPL-X motion by BC and L1div of BEAT2.

    A sequence is as long as the shortest of its motions and its reference. Shapes are those of the reference. Of
    several motions for one sequence the first is scored.

    Args:
        read: what `from_folders` read, by the name of the method.
        body_model: path of an SMPL-X body model (.npz), as the papers use; None for the neutral template.

    Returns:
        {"rows": {row: {metric: {"value", "low", "high"}}}, "notes"}; rows are the methods, their paired differences
        from the first, ground truth and mismatched speech.

    Raises:
        UserError: a file is no SMPL-X motion, or no sequence is left.
    """
    body = template() if body_model is None else read_body_model(body_model)
    methods = {name: {clip.id: clip.path for clip in reversed(each.motion)} for name, each in read.items()}
    truth = references_of(clip for each in read.values() for clip in each.reference)
    ids = [name for name in truth if all(name in paths for paths in methods.values())]
    if not ids:
        raise UserError("no sequence has motion by all methods; give motion of the same clips as the reference")
    joints: dict[str, list[np.ndarray]] = {name: [] for name in (TRUTH, *methods)}
    for clip in ids:
        arrays = _read_arrays(truth[clip].path, reading)
        found = {TRUTH: _joints(arrays, body, arrays.betas)}
        for name, paths in methods.items():
            found[name] = _joints(_read_arrays(paths[clip], reading), body, arrays.betas)
        length = min(map(len, found.values()))
        for name, places in found.items():
            joints[name].append(places[:length])
    recordings, members = np.unique([truth[clip].recording for clip in ids], return_inverse=True)
    speeds = rests.mean_speeds([places[:, _UPPER] for places in joints[TRUTH]], rests.FPS)
    onsets = [truth[clip].onsets for clip in ids]
    rows = {
        name: rests.Beat2Row(places, onsets, speeds, _UPPER, members, len(recordings))
        for name, places in joints.items()
    }
    if len(recordings) > 1:
        lengths, names = [len(places) for places in joints[TRUTH]], [str(member) for member in members]
        mismatched = sanity.mismatched_onsets(onsets, names, lengths, rests.FPS, seed=seed)
        rows[MISMATCHED] = rests.Beat2Row(joints[TRUTH], mismatched, speeds, _UPPER, members, len(recordings))
    intervals = Intervals(len(recordings), DRAWS, seed)
    scores = {name: measure(row, "beat2") for name, row in rows.items()}
    order = dict.fromkeys([*methods, TRUTH, *rows])
    results = {name: {key: intervals(score) for key, score in scores[name].items()} for name in order}
    results |= differences({name: scores[name] for name in methods}, intervals, list(scores[TRUTH]))
    notes = [*_beat2_notes(body_model, len(ids)), *too_few_recordings(len(recordings))]
    if any(len(each.motion) > len(methods[name]) for name, each in read.items()):
        notes.append("of several motions of a sequence the first is scored")
    return {"rows": results, "notes": notes}


def _read_arrays(path: pathlib.Path | None, reading: Reading) -> smplx_arrays.SmplxArrays:
    assert path is not None  # of a folder
    content = read_content(path)
    try:
        return smplx_arrays.to_arrays(content.arrays, reading.get("source_fps"), reading.get("unit"))
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}; the protocol beat2 scores SMPL-X only") from error


def _joints(arrays: smplx_arrays.SmplxArrays, body: Body, betas: np.ndarray) -> np.ndarray:
    """Return (T, 55, 3) metres of all joints at 30 frames per second, the pelvis where it is at rest."""
    return smplx.joints_at_origin(arrays, body.shaped(betas), rests.FPS)


def _beat2_notes(body_model: str | os.PathLike | None, count: int) -> list[str]:
    body = "the body model that was given" if body_model is not None else "the neutral template, not the body model"
    return [
        f"{count} sequences at {rests.FPS:g} frames per second; joints of {body} (--body-model)",
        f"BC without the first and last {rests.EDGE / rests.FPS:g} s; speeds relative to the mean of the reference; "
        "not times 10",
        "FGD is above, of --autoencoder: published FGDs are of the authors' auto-encoder and cannot be compared",
    ]

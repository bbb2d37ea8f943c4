"""Writing and checking of a pack of samples for the GENEA leaderboard, a folder or a `.zip` with a manifest."""

import contextlib
import functools
import hashlib
import json
import pathlib
import re
import tempfile
import unicodedata
import zipfile
import zlib
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple, Unpack

import numpy as np

from ha2g_jax import __version__
from ha2g_jax.apps.genea.sample import (
    FPS,
    NAMES,
    NUM_BETAS,
    TEXTS,
    WIDTHS,
    Clip,
    FromFiles,
    FromModel,
    read_shapes,
)
from ha2g_jax.apps.generate import load
from ha2g_jax.apps.tasks import find_speech
from ha2g_jax.data.validation import Verdict
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import MANIFEST
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, file_sha256, read_json, reading, shown
from ha2g_jax.files.writing import check_new, temporary_folder, whole_file, whole_folder
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_RECORD_BYTES
from ha2g_jax.motion.readers import Reading, smplx, smplx_arrays
from ha2g_jax.motion.readers.smplx_body import read_body_model, template
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.progress import progress_bar, stage
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis.generator import read_speech
from ha2g_jax.synthesis.style import RANDOM, Style

FORMAT = "ha2g-genea 1"
SAMPLES = 5  # samples of each clip that the rules require of a system with randomness
ZIP = ".zip"

_FILE = re.compile(r"sample_([1-9][0-9]?)/([^/]+)\.npz")
_EXPECTED = "a pack of ha2g genea: a folder or a .zip"
_composed = functools.partial(unicodedata.normalize, "NFC")  # macOS writes a letter and its accent apart
_ARCHIVES = (".7z", ".bz2", ".gz", ".rar", ".tar", ".tgz", ".xz", ".zst")
_GENDERS = ("neutral", "female", "male")
_MAX_FILES = 100_000


def write_pack(
    speech: pathlib.Path,
    out: pathlib.Path,
    *,
    checkpoint: str | pathlib.Path = "demo",
    motion: pathlib.Path | None = None,
    samples: int | None = None,
    seed: int = 0,
    style: Style = RANDOM,
    shapes: pathlib.Path | None = None,
    body_model: pathlib.Path | None = None,
    **reading: Unpack[Reading],
) -> pathlib.Path:
    """Write the motion of clips as a pack, a folder or a `.zip` atomically, and return its path.

    Sample k of a clip is `sample_k/CLIP.npz`, with the arrays of BEAT2 at 30 frames per second, and exactly round(30 x
    seconds of the speech) frames. The same arguments give the same bytes.

    Args:
        speech: folder of the files of speech, which have the names of the clips.
        checkpoint: model that generates the motion, see `apps.generate.load`.
        motion: folder of motion of any system, which is packed instead of motion of a model.
        samples: samples of each clip; by default 5 of a model, or all that are in the folder of motion.
        seed: seed of the first sample; each further sample has the next one.
        style: style of the generated motion; see `FromModel`.
        shapes: folder of files of BEAT2 with the shapes of the speakers; by default that of the packed file, or zero.
        body_model: SMPL-X body model (.npz), with which a person without a place stands on the floor.

    Raises:
        UserError: `out` exists or has the suffix of another archive than .zip, a file cannot be used, names do not
            meet, or the pack cannot be written.
    """
    check_new(out)
    if out.suffix.lower() in _ARCHIVES:
        name = f"{out.name.partition('.')[0]}{ZIP}"
        raise UserError(f"a pack is a folder or a .zip, not {shown(out)}; name it {shown(name)}")
    paths = _by_name(find_speech([speech]))
    shape_of = {} if shapes is None else read_shapes(shapes, list(paths))
    body = None if body_model is None else read_body_model(body_model)
    source: FromModel | FromFiles
    if motion is not None:
        source = FromFiles(motion, list(paths), samples, body, **reading)
    else:
        with stage("loading the model"):
            model = load(checkpoint)
        source = FromModel(model, samples or SAMPLES, seed, style, body)
    if out.suffix.lower() == ZIP:
        with whole_file(out) as archive, temporary_folder(out.absolute()) as folder:
            _add_samples(folder, source, paths, shape_of)
            with stage("packing"):
                _zip(folder, archive)
            check_new(out)  # another process may have made it meanwhile
    else:
        with whole_folder(out) as folder:
            _add_samples(folder, source, paths, shape_of)
    return out


def _add_samples(
    folder: pathlib.Path,
    source: FromModel | FromFiles,
    paths: dict[str, pathlib.Path],
    shapes: dict[str, np.ndarray],
) -> None:
    clips = {}
    with progress_bar("packing", len(paths), "clip") as bar:
        for name, path in paths.items():
            audio = read_speech(path)
            clip = Clip(name, path, audio, num_frames(audio.duration, FPS), shapes.get(name))
            made = []
            for number, (sample, facts) in enumerate(source.samples(clip), start=1):
                file = pathlib.Path(f"sample_{number}", f"{name}.npz")
                (folder / file).parent.mkdir(exist_ok=True)
                sample.write(folder / file)
                made.append({"file": file.as_posix(), "sha256": file_sha256(folder / file), **facts})
            speech = {"name": audio.name, "sha256": file_sha256(path), "seconds": audio.duration}
            clips[name] = {"speech": speech, "frames": clip.frames, "samples": made}
            bar.update()
    content = {"format": FORMAT, "version": __version__, "fps": FPS, **source.facts, "clips": clips}
    (folder / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _by_name(paths: list[pathlib.Path]) -> dict[str, pathlib.Path]:
    found: dict[str, pathlib.Path] = {}
    for path in paths:
        try:
            name = _composed(path.stem)
            name.encode()
        except UnicodeEncodeError:
            raise UserError(f"{shown(path)} has a name that is not UTF-8; rename it") from None
        if (other := found.setdefault(name, path)) != path:
            raise UserError(f"{shown(other)} and {shown(path)} are speech of one name; leave out one of them")
    return found


def _zip(folder: pathlib.Path, path: pathlib.Path) -> None:
    """Write all files of a folder to an archive without times; the files are compressed already."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            info = zipfile.ZipInfo(file.relative_to(folder).as_posix())
            info.external_attr = 0o644 << 16
            with file.open("rb") as source, archive.open(info, "w", force_zip64=True) as target:
                while part := source.read(1 << 20):
                    target.write(part)


class _File(NamedTuple):
    """What the check keeps of a file: its number of frames, 0 if unreadable, and a hash of poses and place."""

    frames: int
    motion: str
    sha256: str


def check_pack(pack: pathlib.Path, speech: pathlib.Path | None = None) -> Verdict:
    """Check the names, arrays, frame rates, axes, lengths, numbers of samples and hashes of a pack of any system.

    The clips and their lengths are those of the folder `speech`, or without it those of the manifest. A valid pack has
    no findings, but may have notes, for example about a missing manifest.

    Raises:
        UserError: there is no pack, or its manifest or the speech cannot be used.
    """
    if pack.is_dir():
        paths = {path.relative_to(pack).as_posix(): path for path in sorted(pack.rglob("*")) if path.is_file()}
        return _check(pack, paths, paths.__getitem__, speech)
    check_regular(pack, _EXPECTED)
    damage = (zipfile.BadZipFile, NotImplementedError, RuntimeError)
    with reading(pack, _EXPECTED, *damage), zipfile.ZipFile(pack) as archive, tempfile.TemporaryDirectory() as folder:
        names = sorted(info.filename for info in archive.infolist() if not info.is_dir())

        def unpacked(name: str) -> pathlib.Path:
            if archive.getinfo(name).file_size > MAX_MOTION_BYTES:
                raise UserError(f"{shown(name)} is too large")
            path = pathlib.Path(folder, "file.npz")
            try:
                path.write_bytes(archive.read(name))
            except (*damage, EOFError, zlib.error) as error:
                raise UserError(f"it cannot be unpacked ({error or type(error).__name__})") from error
            return path

        return _check(pack, names, unpacked, speech)


def _check(
    pack: pathlib.Path, names: Collection[str], path_of: Callable[[str], pathlib.Path], speech: pathlib.Path | None
) -> Verdict:
    findings: list[str] = []
    notes: list[str] = []
    if not any(_FILE.fullmatch(name) for name in names) or len(names) > _MAX_FILES:
        raise UserError(f"no file sample_1/CLIP.npz in {shown(pack)}; expected {_EXPECTED}")
    files: dict[str, dict[int, _File]] = defaultdict(dict)
    with progress_bar("checking", len(names), "file") as bar:
        for name in names:
            bar.update()
            if match := _FILE.fullmatch(name):
                files[_composed(match[2])][int(match[1])] = _check_file(name, path_of, findings)
            elif name != MANIFEST:
                findings.append(f"{shown(name)} does not belong to a pack; expected sample_K/CLIP.npz")
    numbers = {number for each in files.values() for number in each}
    if numbers == {1}:
        notes.append(f"one sample of each clip, as of a system without randomness; others need {SAMPLES}")
    elif numbers != set(range(1, SAMPLES + 1)):
        findings.append(f"samples {', '.join(map(str, sorted(numbers)))}; expected 1 to {SAMPLES}")
    for clip, each in files.items():
        _check_clip(clip, each, numbers, findings)
    if MANIFEST in names:
        _check_manifest(_read_manifest(pack, path_of), files, findings)
    else:
        notes.append(f"no {MANIFEST}: hashes are not checked")
    if speech is not None:
        _check_speech(speech, files, findings)
    return Verdict(findings, notes)


def _check_file(name: str, path_of: Callable[[str], pathlib.Path], findings: list[str]) -> _File:
    path = None
    try:
        path = path_of(name)
        digest = file_sha256(path)
        arrays = read_npz(path, max_bytes=MAX_MOTION_BYTES)
    except UserError as error:
        # A file of a .zip is read from a temporary place, which means nothing to the user.
        reason = str(error).replace(shown(path), "the file") if path else str(error)
        findings.append(f"{shown(name)}: {reason}")
        return _File(0, name, "")
    wrong = _wrong_arrays(arrays)
    if not wrong:
        try:
            found = smplx.to_motion(
                smplx_arrays.to_arrays(arrays), load_skeleton("ted_expressive"), template(), fps=1.0
            )
            wrong = [] if found.up == "y" else [f"up is {found.up}, expected y"]
        except UserError as error:
            wrong = [str(error)]
    if wrong:
        findings.append(f"{shown(name)}: {'; '.join(wrong)}")
        return _File(0, name, digest)
    motion = hashlib.sha256(arrays["poses"].tobytes() + arrays["trans"].tobytes()).hexdigest()
    return _File(len(arrays["poses"]), motion, digest)


def _wrong_arrays(arrays: Mapping[str, np.ndarray]) -> list[str]:
    wrong = [f"no array {name}" for name in NAMES if name not in arrays]
    if wrong:
        return wrong
    count = len(arrays["poses"]) if arrays["poses"].ndim else 0
    shapes = {name: (count, width) for name, width in WIDTHS.items()} | {"betas": (NUM_BETAS,)}
    for name, shape in shapes.items():
        array = arrays[name]
        if array.shape != shape or not count:
            wrong.append(f"{name} has shape {array.shape}, expected ({', '.join(map(str, shape))}) of frames")
        elif array.dtype.kind != "f" or not np.isfinite(array).all():
            wrong.append(f"{name} has values of {array.dtype} that are not finite floats")
    rate = arrays["mocap_frame_rate"]
    if rate.size != 1 or rate.dtype.kind not in "iuf" or float(rate.reshape(())) != FPS:
        wrong.append(f"mocap_frame_rate is {str(rate)[:40]} of type {rate.dtype}, expected the number {FPS:g}")
    for name, allowed in {"model": (TEXTS["model"],), "gender": _GENDERS}.items():
        if str(arrays[name])[:40] not in allowed:
            wrong.append(f"{name} is {str(arrays[name])[:40]!r}, expected {' or '.join(allowed)}")
    return wrong


def _check_clip(clip: str, files: Mapping[int, _File], numbers: set[int], findings: list[str]) -> None:
    if missing := sorted(numbers - files.keys()):
        findings.append(f"sample_{missing[0]} has no {shown(clip)}, which others have")
    good = [file for file in files.values() if file.frames]
    if len({file.frames for file in good}) > 1:
        findings.append(f"the samples of {shown(clip)} have different numbers of frames")
    if len({file.motion for file in good}) < len(good):
        findings.append(f"two samples of {shown(clip)} are the same motion; a system without randomness gives one")


def _read_manifest(pack: pathlib.Path, path_of: Callable[[str], pathlib.Path]) -> Mapping[str, Any]:
    content = None
    with contextlib.suppress(UserError):  # it may name the temporary place of a file of a .zip
        content = read_json(path_of(MANIFEST), "the manifest of a pack", MAX_RECORD_BYTES)
    if not isinstance(content, dict) or content.get("format") != FORMAT or not isinstance(content.get("clips"), dict):
        raise UserError(
            f"{MANIFEST} of {shown(pack)} is damaged or not that of a pack; write the pack again, or leave it out"
        )
    return {_composed(clip): facts for clip, facts in content["clips"].items()}


def _check_manifest(clips: Mapping[str, Any], files: Mapping[str, Mapping[int, _File]], findings: list[str]) -> None:
    if set(clips) != set(files):
        findings.append(f"{MANIFEST} has {len(clips)} clips, and the pack {len(files)}, or others")
    expected = {}
    for clip, facts in clips.items():
        listed = facts.get("samples") if isinstance(facts, dict) else None
        for each in listed if isinstance(listed, list) else []:
            if isinstance(each, dict) and isinstance(each.get("file"), str):
                expected[_composed(each["file"])] = each.get("sha256")
        for number, file in files.get(clip, {}).items():
            if expected.get(f"sample_{number}/{clip}.npz") != file.sha256:
                findings.append(f"sample_{number}/{shown(clip)}.npz is not the file of {MANIFEST}")
            if isinstance(facts, dict) and file.frames and file.frames != facts.get("frames"):
                findings.append(f"sample_{number}/{shown(clip)}.npz has {file.frames} frames, not those of {MANIFEST}")
    there = {f"sample_{number}/{clip}.npz" for clip, each in files.items() for number in each}
    if lost := sorted(expected.keys() - there):
        findings.append(f"{len(lost)} files of {MANIFEST} are missing, such as {shown(lost[0])}")


def _check_speech(speech: pathlib.Path, files: Mapping[str, Mapping[int, _File]], findings: list[str]) -> None:
    paths = _by_name(find_speech([speech]))
    findings += [f"{shown(clip)} has no motion" for clip in paths if clip not in files]
    findings += [f"{shown(clip)} has no speech in {shown(speech)}" for clip in files if clip not in paths]
    for clip in (clip for clip in paths if clip in files):
        try:
            seconds = read_speech(paths[clip]).duration
        except UserError as error:
            findings.append(str(error))
            continue
        frames = {file.frames for file in files[clip].values() if file.frames}
        if wrong := frames - {num_frames(seconds, FPS)}:
            findings.append(
                f"{shown(clip)} has {min(wrong)} frames, and {seconds:.3f} s of speech are {num_frames(seconds, FPS)}"
            )

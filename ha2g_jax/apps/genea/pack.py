"""A pack of samples for the GENEA leaderboard, as a folder or a `.zip`, with a manifest of seeds and hashes."""

import hashlib
import json
import os
import pathlib
import zipfile

import numpy as np

from ha2g_jax import __version__
from ha2g_jax.apps.genea.sample import FPS
from ha2g_jax.apps.genea.sources import Clip, FromFiles, FromModel, Source, read_shapes
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import MANIFEST
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import temporary_folder, whole_file, whole_folder
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.smplx_body import read_body_model
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.progress import progress_bar, stage
from ha2g_jax.synthesis.files import find_speech
from ha2g_jax.synthesis.generator import read_speech
from ha2g_jax.synthesis.style import RANDOM, Style

FORMAT = "ha2g-genea 1"
SAMPLES = 5  # that the rules ask for of a system with randomness
ZIP = ".zip"

Path = str | os.PathLike


def write_pack(
    speech: Path,
    out: Path,
    *,
    checkpoint: str | pathlib.Path = "demo",
    motion: Path | None = None,
    samples: int | None = None,
    seed: int = 0,
    style: Style = RANDOM,
    shapes: Path | None = None,
    body_model: Path | None = None,
    joint_map: str = joint_maps.AUTO,
    source_fps: float | None = None,
) -> pathlib.Path:
    """Write the motion of clips as a pack, completely or not at all.

    Sample k of a clip is `sample_k/CLIP.npz`, with the arrays of BEAT2 at 30 frames per second, and exactly
    round(30 x seconds of the speech) frames. The same arguments give the same bytes.

    Args:
        speech: folder of the files of speech, which have the names of the clips.
        out: folder to write, or a path that ends in `.zip`.
        checkpoint: model that generates the motion, see `synthesis.files.load`.
        motion: folder of motion of any system that is packed in place of what a model generates.
        samples: samples of each clip; by default 5 of a model, or all that are in the folder of motion.
        seed: seed of the first sample; the next has the next one.
        style: style of what a model generates; see `FromModel`.
        shapes: folder of files of BEAT2 with the shapes of the speakers; without it a shape is that of the file that
            is packed, or zero.
        body_model: SMPL-X body model (.npz), with which a person without a place stands on the floor.
        joint_map, source_fps: see `motion.readers.read_motion`, for `motion`.

    Returns:
        The path of the pack.

    Raises:
        UserError: `out` exists, a file cannot be used, names do not meet, or the pack cannot be written.
    """
    out = pathlib.Path(out)
    _check_place(out)
    paths = _by_name(find_speech([pathlib.Path(speech)]))
    shape_of = {} if shapes is None else read_shapes(pathlib.Path(shapes), list(paths))
    body = None if body_model is None else read_body_model(body_model)
    source: Source
    if motion is not None:
        reading = {"joint_map": joint_map, "source_fps": source_fps}
        source = FromFiles(pathlib.Path(motion), list(paths), samples, body, **reading)
    else:
        from ha2g_jax.synthesis.files import load

        with stage("loading the model"):
            model = load(checkpoint)
        source = FromModel(model, samples or SAMPLES, seed, style, body)
    if out.suffix.lower() == ZIP:
        with whole_file(out) as archive, temporary_folder(out.absolute()) as folder:
            _add_samples(folder, source, paths, shape_of)
            with stage("packing"):
                _zip(folder, archive)
            _check_place(out)  # another process may have made it meanwhile
    else:
        with whole_folder(out) as folder:
            _add_samples(folder, source, paths, shape_of)
    return out


def _add_samples(
    folder: pathlib.Path, source: Source, paths: dict[str, pathlib.Path], shapes: dict[str, np.ndarray]
) -> None:
    """Write the samples of all clips and the manifest."""
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
                made.append({"file": file.as_posix(), "sha256": hash_of(folder / file), **facts})
            speech = {"name": audio.name, "sha256": hash_of(path), "seconds": audio.duration}
            clips[name] = {"speech": speech, "frames": clip.frames, "samples": made}
            bar.update()
    content = {"format": FORMAT, "version": __version__, "fps": FPS, **source.facts, "clips": clips}
    (folder / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def hash_of(path: pathlib.Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _by_name(paths: list[pathlib.Path]) -> dict[str, pathlib.Path]:
    found: dict[str, pathlib.Path] = {}
    for path in paths:
        if (other := found.setdefault(path.stem, path)) != path:
            raise UserError(f"{shown(other)} and {shown(path)} are speech of one name; leave out one of them")
    return found


def _check_place(out: pathlib.Path) -> None:
    if out.exists():
        raise UserError(f"{shown(out)} exists; choose another name or remove it")


def _zip(folder: pathlib.Path, path: pathlib.Path) -> None:
    """Write all files of a folder to an archive without times; the files are compressed already."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            info = zipfile.ZipInfo(file.relative_to(folder).as_posix())
            info.external_attr = 0o644 << 16
            with file.open("rb") as source, archive.open(info, "w", force_zip64=True) as target:
                while part := source.read(1 << 20):
                    target.write(part)

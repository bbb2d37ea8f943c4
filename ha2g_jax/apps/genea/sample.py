"""Motions in the layout of BEAT2, that of a submission (SMPL-X at 30 frames per second), from a model or from files."""

import collections
import pathlib
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np

from ha2g_jax.apps.generate import read_words
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import clip_of, find_motions
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import naming, resolved, shown
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_SEED
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.formats.tables import arrays_of
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.motion.lower_body import SOLE
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import Reading, check_reading, read_motion, smplx, smplx_arrays
from ha2g_jax.motion.readers.containers import read_content
from ha2g_jax.motion.readers.recordings import other_rate
from ha2g_jax.motion.readers.smplx_arrays import NUM_SMPLH
from ha2g_jax.motion.readers.smplx_body import JOINTS, Body, template
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.progress import counted
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis.generator import Audio, Generator
from ha2g_jax.synthesis.style import Style

FPS = 30.0
NUM_BETAS, NUM_EXPRESSIONS, NUM_POSES = 300, 100, 3 * len(JOINTS)

WIDTHS = {"poses": NUM_POSES, "expressions": NUM_EXPRESSIONS, "trans": 3}
"""Values of a frame in each array of (T, values)."""

TEXTS = {"model": "smplx2020", "gender": "neutral"}
"""Facts of the body model."""

NAMES = ("betas", *WIDTHS, *TEXTS, "mocap_frame_rate")
"""Names of all arrays of a file."""

_MAX_DIFFERENCE = 1.0  # seconds between the ends of the motion of a file and of the speech
_FEET = [JOINTS.index(name) for name in LOWER_JOINTS if name.endswith(("ankle", "foot"))]
_BEAT_CLIP = re.compile(r"(\d+_([A-Za-z]+))(_\d+){3}")  # number and name of the speaker, then those of the recording


class Sample(NamedTuple):
    """A motion for the speech of one clip.

    Attributes:
        poses: (T, 165) float32 axis-angle vectors in radians of the 55 joints, zero for the flat hand.
        expressions: (T, 100) float32 weights of the expressions of FLAME, zero without a face.
        trans: (T, 3) float32 metres, y up.
        betas: (300,) float32 shape of the body.
    """

    poses: np.ndarray
    expressions: np.ndarray
    trans: np.ndarray
    betas: np.ndarray

    def write(self, path: pathlib.Path) -> None:
        """Write the arrays of BEAT2 to an `.npz` file; the same sample gives the same bytes."""
        arrays: dict[str, Any] = self._asdict() | TEXTS | {"mocap_frame_rate": int(FPS)}
        np.savez_compressed(path, **arrays)


def from_motion(motion: Motion, count: int, *, betas: np.ndarray | None = None, body: Body | None = None) -> Sample:
    """Convert a motion to `count` frames at 30 frames per second.

    Pelvis, legs, place and face are those of the motion, if it has them; otherwise the legs stand still. The shape
    `betas` (n,) is zero by default. With the SMPL-X body model `body`, the soles of a person who stands still touch the
    floor, y = 0, and `trans` is exact for other motion; without it `trans` is the position of the pelvis, or zero.
    """
    animation = retarget(solver.animate(motion), rigs.load_rig("smplx"))
    arrays = arrays_of(animation, moves=motion.lower is not None, face=motion.face)
    arrays |= {"mocap_frame_rate": np.array(motion.fps), "betas": np.zeros(0) if betas is None else betas}
    if body is not None:
        points = body.shaped(arrays["betas"])
        arrays["trans"] = arrays["trans"] - points[0].astype(np.float32)  # the pelvis is not at the model's origin
        if motion.lower is None:
            arrays["trans"][:, 1] += np.float32(points[0, 1] - points[_FEET, 1].min() + SOLE)
    return _sample(smplx.at_rate(smplx_arrays.to_arrays(arrays), FPS, count))


def from_file(
    path: pathlib.Path,
    count: int,
    *,
    betas: np.ndarray | None = None,
    body: Body | None = None,
    **reading: Unpack[Reading],
) -> Sample:
    """Read a motion of any kind as `count` frames; poses of SMPL-X with y up keep their values.

    `betas` (n,) replaces the shape of the file; for `body` see `from_motion`.

    Raises:
        UserError: the file cannot be read, or its length differs from that of the speech by more than a second.
    """
    content = read_content(path)
    if smplx_arrays.has_poses(content.arrays):
        with naming(path):
            arrays = smplx_arrays.to_arrays(content.arrays, reading.get("source_fps"), reading.get("unit"))
            up = smplx.to_motion(arrays, load_skeleton("ted_expressive"), template(), fps=1.0).up
        betas = _own_betas(content.arrays, arrays) if betas is None else betas
        _check_length(path, len(arrays.frames) / arrays.fps, arrays.fps, count)
        if up == "y":
            return _sample(smplx.at_rate(arrays._replace(betas=betas), FPS, count))
        skeleton = load_skeleton("ted_expressive")
        with naming(path):  # `trans` turns about the origin of the body model, not about the pelvis
            found = smplx.to_motion(arrays, skeleton, body or template(), fps=None)
        turned = Motion.from_positions(skeleton, found.positions, arrays.fps, {}, lower=found.lower, face=found.face)
        return from_motion(turned, count, betas=betas, body=body)
    motion = read_motion(path, **reading)
    _check_length(path, motion.num_frames / motion.fps, motion.meta.get("read_from", {}).get("fps"), count)
    return from_motion(motion, count, betas=betas, body=body)


def _own_betas(given: Mapping[str, np.ndarray], arrays: smplx_arrays.SmplxArrays) -> np.ndarray:
    """Return the shape of a file; that of SMPL-H belongs to another body model."""
    is_smplh = smplx_arrays.POSES in given and given[smplx_arrays.POSES].size == len(arrays.frames) * 3 * NUM_SMPLH
    return np.zeros(0) if is_smplh else arrays.betas


def _check_length(path: pathlib.Path, seconds: float, fps: float | None, count: int) -> None:
    speech = count / FPS
    if abs(seconds - speech) > _MAX_DIFFERENCE:
        raise UserError(
            f"{shown(path)} lasts {seconds:.2f} s, and the speech {speech:.2f} s; expected a difference of at most "
            f"{_MAX_DIFFERENCE:g} s: give the motion of this speech{other_rate(seconds, fps, speech)}"
        )


def _sample(arrays: smplx_arrays.SmplxArrays) -> Sample:
    count = len(arrays.frames)
    face = arrays.face.get("expressions", np.zeros((count, 0)))
    return Sample(
        poses=arrays.frames.reshape(count, NUM_POSES).astype(np.float32),
        expressions=_width(face, NUM_EXPRESSIONS),
        trans=arrays.trans.astype(np.float32),
        betas=_width(arrays.betas[None], NUM_BETAS)[0],
    )


def _width(values: np.ndarray, width: int) -> np.ndarray:
    """Return the first `width` coefficients, which matter most, padded with zeros."""
    found = np.zeros((len(values), width), np.float32)
    found[:, : values.shape[1]] = values[:, :width]
    return found


class Clip(NamedTuple):
    """The speech of one clip, the frames of each of its samples, and the shape (300,) of the speaker if it is known."""

    name: str
    path: pathlib.Path
    audio: Audio
    frames: int
    betas: np.ndarray | None


class FromModel:
    """Samples that a model generates: sample k of `count` is the motion of the seed `seed + k - 1`.

    Each comes with its entry in the manifest; `facts` is the part of the manifest about all samples. A style without a
    source is that of the speaker of the clip of BEAT2 if the model has this speaker, or else random.

    Raises:
        UserError: the style or a seed cannot be used.
    """

    def __init__(self, model: Generator[Any], count: int, seed: int, style: Style, body: Body | None) -> None:
        if seed + count - 1 > MAX_SEED:
            raise UserError(f"the seed of sample {count} is above {MAX_SEED}; give a smaller --seed")
        model.check_options(style=style, seed=seed, fps=FPS)
        self._model, self._seeds, self._style, self._body = model, range(seed, seed + count), style, body

    @property
    def facts(self) -> dict[str, Any]:
        return {"model": self._model.name, "checkpoint": self._model.assets.hash}

    def samples(self, clip: Clip) -> Iterator[tuple[Sample, dict[str, Any]]]:
        words = read_words(self._model, clip.path, clip.audio.samples, None)
        for seed in self._seeds:
            motion = self._model.generate(clip.audio, style=self._style_of(clip), seed=seed, fps=FPS, words=words)
            made = from_motion(motion, clip.frames, betas=clip.betas, body=self._body)
            yield made, {"seed": seed, "style": motion.meta["style"]}

    def _style_of(self, clip: Clip) -> Style:
        named = _BEAT_CLIP.fullmatch(clip.name)
        if self._style.has_source or not named or named[2] not in self._model.assets.speakers:
            return self._style
        return self._style._replace(speaker=named[2])


class FromFiles:
    """Samples of files that `motion.readers` reads: CLIP.npz, CLIP.1.npz to CLIP.5.npz, or sample_1/CLIP.npz and so on.

    There are `count` samples of each clip, or with None as many as there are files. For `body` see `from_motion`.

    Raises:
        UserError: a clip has no file, or clips have different numbers of files, or not `count`.
    """

    def __init__(
        self,
        folder: pathlib.Path,
        clips: Sequence[str],
        count: int | None,
        body: Body | None,
        **reading: Unpack[Reading],
    ) -> None:
        found: dict[str, list[pathlib.Path]] = collections.defaultdict(list)
        for name, path in find_motions(folder).items():
            if (clip := clip_of(name, set(clips))) is not None:
                found[clip].append(path)
        expected = count or max(map(len, found.values()), default=1)
        if short := [clip for clip in clips if len(found[clip]) != expected]:
            raise UserError(
                f"{shown(folder)} has {counted(len(found[short[0]]), 'motion')} of {shown(short[0])}; expected "
                f"{expected} of each clip, named {shown(short[0])}.1.npz and so on"
            )
        self._folder, self._paths, self._body = folder, dict(found), body
        check_reading([path for paths in found.values() for path in paths], **reading)
        self._reading = reading

    @property
    def facts(self) -> dict[str, Any]:
        return {"motion": shown(resolved(self._folder).name)}

    def samples(self, clip: Clip) -> Iterator[tuple[Sample, dict[str, Any]]]:
        for path in sorted(self._paths[clip.name], key=_number):
            made = from_file(path, clip.frames, betas=clip.betas, body=self._body, **self._reading)
            yield made, {"read_from": shown(path.relative_to(self._folder))}


def read_shapes(folder: pathlib.Path, clips: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the shape (300,) of the speaker of each clip, read from files of BEAT2.

    The file is that of the clip, or for clips with names of BEAT2 that of another clip of the speaker.

    Raises:
        UserError: there is no file for a clip, or it has no shape.
    """
    paths = {unicodedata.normalize("NFC", path.stem): path for path in sorted(find_motions(folder).values())}
    speakers = {_speaker(name): path for name, path in paths.items()}
    shapes: dict[str, np.ndarray] = {}
    for clip in clips:
        path = paths.get(clip) or speakers.get(_speaker(clip))
        if path is None:
            raise UserError(
                f"{shown(folder)} has no file of {shown(clip)} or its speaker; give the folder smplxflame_30 of BEAT2"
            )
        arrays = read_npz(path, max_bytes=MAX_MOTION_BYTES, names=["betas"])
        with naming(path):
            if "betas" not in arrays:
                raise UserError("no betas in it; expected a file of BEAT2")
            shapes[clip] = _width(smplx_arrays.read_shape(arrays)[None], NUM_BETAS)[0]
    return shapes


def _speaker(clip: str) -> str:
    named = _BEAT_CLIP.fullmatch(clip)
    return named[1] if named else clip


def _number(path: pathlib.Path) -> tuple[int, str]:
    """Return the key of the order of samples, 2 before 10: the number at the end of the name of the file or folder."""
    number = path.stem.rpartition(".")[2]
    numbers = re.findall(r"\d+", number if number.isdecimal() and number != path.stem else path.parent.name)
    return (int(numbers[-1]) if numbers else 0), path.as_posix()

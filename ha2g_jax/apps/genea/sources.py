"""Where the samples of a pack come from: a model, or files that any system has written."""

import collections
import pathlib
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ha2g_jax.apps.genea import sample
from ha2g_jax.apps.genea.sample import FPS, Sample
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.motion_folders import clip_of, find_motions
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_SEED
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.smplx_body import Body
from ha2g_jax.synthesis.files import read_words
from ha2g_jax.synthesis.generator import Audio, Generator
from ha2g_jax.synthesis.style import Style

_BEAT_CLIP = re.compile(r"(\d+_([A-Za-z]+))(_\d+){3}")  # number and name of the speaker, then those of the recording


class Clip(NamedTuple):
    """The speech of one clip.

    Attributes:
        name: name of the clip.
        path: path of the speech.
        audio: the speech.
        frames: number of frames of each sample.
        betas: (300,) shape of the speaker; None without.
    """

    name: str
    path: pathlib.Path
    audio: Audio
    frames: int
    betas: np.ndarray | None


class Source(Protocol):
    """Samples of clips, and what the manifest says of them."""

    @property
    def facts(self) -> dict[str, Any]: ...

    def samples(self, clip: Clip) -> Iterator[tuple[Sample, dict[str, Any]]]:
        """Make the samples of a clip, each with facts for the manifest."""
        ...


class FromModel:
    """Samples that a model generates: sample k is the motion of the seed `seed + k - 1`."""

    def __init__(self, model: Generator[Any], count: int, seed: int, style: Style, body: Body | None) -> None:
        """Check that the model can be asked for these samples.

        Args:
            model: trained generator.
            count: number of samples of each clip.
            seed: seed of the first sample.
            style: style of all clips; one without a source is that of the speaker of a clip of BEAT2, where the model
                has this speaker, and else random.
            body: see `sample.from_motion`.

        Raises:
            UserError: the style or a seed cannot be used.
        """
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
            made = sample.from_motion(motion, clip.frames, betas=clip.betas, body=self._body)
            yield made, {"seed": seed, "style": motion.meta["style"]}

    def _style_of(self, clip: Clip) -> Style:
        named = _BEAT_CLIP.fullmatch(clip.name)
        if self._style.has_source or not named or named[2] not in self._model.assets.speakers:
            return self._style
        return self._style._replace(speaker=named[2])


class FromFiles:
    """Samples that are read from files: CLIP.npz, CLIP.1.npz to CLIP.5.npz, or sample_1/CLIP.npz and so on."""

    def __init__(
        self,
        folder: pathlib.Path,
        clips: Sequence[str],
        count: int | None,
        body: Body | None,
        *,
        joint_map: str = joint_maps.AUTO,
        source_fps: float | None = None,
    ) -> None:
        """Find the files of all clips.

        Args:
            folder: folder of the files, of any kind that `motion_files` reads.
            clips: names of the clips.
            count: number of samples of each clip; None takes what is there.
            body: see `sample.from_motion`.
            joint_map, source_fps: see `motion.readers.read_motion`.

        Raises:
            UserError: a clip has no file, or clips have different numbers of files, or not `count`.
        """
        found: dict[str, list[pathlib.Path]] = collections.defaultdict(list)
        for name, path in find_motions(folder).items():
            if (clip := clip_of(name, set(clips))) is not None:
                found[clip].append(path)
        expected = count or max(map(len, found.values()), default=1)
        if short := [clip for clip in clips if len(found[clip]) != expected]:
            raise UserError(
                f"{shown(folder)} has {len(found[short[0]])} motions of {shown(short[0])}; expected {expected} of each "
                f"of the {len(clips)} clips, such as {shown(short[0])}.1.npz to {shown(short[0])}.{expected}.npz"
            )
        self._folder, self._paths, self._body = folder, dict(found), body
        self._reading: dict[str, Any] = {"joint_map": joint_map, "source_fps": source_fps}

    @property
    def facts(self) -> dict[str, Any]:
        return {"motion": shown(self._folder.resolve().name)}

    def samples(self, clip: Clip) -> Iterator[tuple[Sample, dict[str, Any]]]:
        for path in sorted(self._paths[clip.name], key=_number):
            made = sample.from_file(path, clip.frames, betas=clip.betas, body=self._body, **self._reading)
            yield made, {"read_from": shown(path.relative_to(self._folder))}


def read_shapes(folder: pathlib.Path, clips: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the shapes of the speakers of clips from files of BEAT2.

    Args:
        folder: folder with a file of each clip, or for clips with names of BEAT2 of another clip of the speaker.
        clips: names of the clips.

    Returns:
        (300,) shape by the name of the clip.

    Raises:
        UserError: there is no file for a clip, or it has no shape.
    """
    paths = {path.stem: path for path in sorted(find_motions(folder).values())}
    speakers = {_speaker(name): path for name, path in paths.items()}
    shapes: dict[str, np.ndarray] = {}
    for clip in clips:
        path = paths.get(clip) or speakers.get(_speaker(clip))
        if path is None:
            raise UserError(
                f"{shown(folder)} has no file of {shown(clip)} or its speaker; give the folder smplxflame_30 of BEAT2"
            )
        try:
            shapes[clip] = sample.read_betas(read_npz(path, max_bytes=MAX_MOTION_BYTES, names=["betas"]))
        except UserError as error:
            raise UserError(f"{shown(path)}: {error}") from error
    return shapes


def _speaker(clip: str) -> str:
    named = _BEAT_CLIP.fullmatch(clip)
    return named[1] if named else clip


def _number(path: pathlib.Path) -> tuple[int, str]:
    """Return the key of the order of samples: 2 before 10."""
    numbers = re.findall(r"\d+", f"{path.parent.name} {path.suffixes[0] if path.suffixes else ''}")
    return (int(numbers[-1]) if numbers else 0), path.as_posix()

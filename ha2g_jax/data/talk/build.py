"""Builds the Talk corpus: synthetic speakers, their speech, and gestures with a known ground truth."""

import os
import pathlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import tqdm

from ha2g_jax.data import records
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.processes import parallel_map
from ha2g_jax.data.talk import grammar, portrait, speech, teacher
from ha2g_jax.data.talk.style import Style, sample_style
from ha2g_jax.data.talk.voices import Voice, sample_voice
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.files.cache_folder import cache_folder

FPS = 15
SPLITS = ("train", "val", "test", "test_unseen_speakers")

_VERSION = "talk-v1"
_DIED = "a process that made the corpus was killed, perhaps for want of memory; use fewer --workers"
_DEFAULT_SPEAKERS, _DEFAULT_MINUTES = 24, 120
_CLIP_SECONDS = (10.0, 19.0)  # until the last sentence is over, a clip lasts some seconds more
_MEAN_CLIP_SECONDS = 17.6
_CLIPS_PER_TALK = 2
_UNSEEN_SPEAKERS, _UNSEEN_TALKS, _TEST_TALKS, _VAL_TALKS = 1 / 6, 1 / 11, 1 / 11, 1 / 17

_REFERENCE_FRAMES = 4
_PEAK = 0.7
_NOISE_DB = (-75.0, -50.0)  # of the room, relative to full scale

# First numbers of spawn keys, so that no speaker shares a seed with a talk.
_SPEAKER_SEEDS, _TALK_SEEDS = 0, 1


class Speaker(NamedTuple):
    """Who speaks and moves."""

    name: str
    voice: Voice
    style: Style


class _Talk(NamedTuple):
    """All that a worker needs to make the clips of one talk; equal values give equal bytes."""

    name: str
    split: str
    speaker: Speaker
    num_clips: int
    seed: np.random.SeedSequence


def make_talk(
    out: str | os.PathLike,
    *,
    speakers: int = _DEFAULT_SPEAKERS,
    minutes: float = _DEFAULT_MINUTES,
    seed: int = 0,
    workers: int | None = None,
) -> None:
    """Makes the corpus in the folder `out`; the same numbers give the same bytes whatever the workers.

    One speaker in six is kept for `test_unseen_speakers`: a new voice, and a style between two styles of training.

    Args:
        out: folder to make; nothing is left of it if the work is interrupted.
        speakers: number of speakers, at least 2.
        minutes: about how much speech in all.
        seed: of everything random.
        workers: processes; one a core by default.

    Raises:
        UserError: `out` exists, or there are too few speakers or minutes for all splits.
    """
    talks = _plan(speakers, minutes, seed)
    metadata = {
        "name": _VERSION,
        "source": f"ha2g data make-talk --speakers {speakers} --minutes {minutes:g} --seed {seed}",
        "licence": "Synthetic speech and motion; free of third-party rights",
    }
    workers = min(workers or os.cpu_count() or 1, len(talks))
    with (
        CorpusWriter(out, splits=SPLITS, skeleton=teacher.SKELETON, fps=FPS, metadata=metadata) as writer,
        parallel_map(workers, _DIED) as each,
    ):
        for talk, clips in tqdm.tqdm(zip(talks, each(_make_clips, talks)), "Talk corpus", len(talks), unit="talk"):
            for clip in clips:
                writer.add(talk.split, clip)


def talk_path(spec: str) -> pathlib.Path:
    """The folder of a corpus: "talk" is the default Talk corpus, built on first use; else `spec` is a path."""
    path = talk_folder(spec)
    if spec == "talk" and not path.exists():
        try:
            make_talk(path)
        except UserError:
            if not path.exists():  # else another process has made the same corpus meanwhile
                raise
    return path


def talk_folder(spec: str) -> pathlib.Path:
    """Where `talk_path` has a corpus, or will have it: "talk" in $HA2G_CACHE, by default ~/.cache/ha2g-jax."""
    if spec != "talk":
        return pathlib.Path(spec)
    return cache_folder() / _VERSION


def _plan(num_speakers: int, minutes: float, seed: int) -> list[_Talk]:
    """Who gives which talk in which split, in the order of writing."""
    num_clips = round(minutes * 60 / _MEAN_CLIP_SECONDS)
    unseen = max(1, round(num_speakers * _UNSEEN_SPEAKERS))
    seen = num_speakers - unseen
    clips_per_talk = _CLIPS_PER_TALK if num_clips >= 4 * _CLIPS_PER_TALK * num_speakers else 1
    num_talks = num_clips // clips_per_talk
    counts = {
        "val": max(1, round(num_talks * _VAL_TALKS)),
        "test": max(1, round(num_talks * _TEST_TALKS)),
        "test_unseen_speakers": max(unseen, round(num_talks * _UNSEEN_TALKS)),
    }
    counts["train"] = num_talks - sum(counts.values())
    if seen < 1:
        raise UserError(f"{num_speakers} speakers are too few for a split of unseen ones; give at least 2")
    if counts["train"] < seen:
        raise UserError(f"{minutes:g} minutes are too few for {num_speakers} speakers; give at least {num_speakers}")

    cast = _cast(seen, unseen, seed)
    talks: list[_Talk] = []
    for key, split in enumerate(SPLITS):
        pool = cast[seen:] if split == "test_unseen_speakers" else cast[:seen]
        for number in range(counts[split]):
            # A stride keeps val and test, which hold a talk or none of each speaker, from choosing the same speakers.
            speaker = pool[(number * 7 if split == "val" else number) % len(pool)]
            talk_seed = np.random.SeedSequence(seed, spawn_key=(_TALK_SEEDS, key, number))
            talks.append(_Talk(f"{split}-{number:04d}", split, speaker, clips_per_talk, talk_seed))
    return talks


def _cast(seen: int, unseen: int, seed: int) -> list[Speaker]:
    """The speakers of training, then the unseen ones; each from a seed of their own."""
    cast: list[Speaker] = []
    for number in range(seen + unseen):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SPEAKER_SEEDS, number)))
        voice, style = sample_voice(rng), sample_style(rng)
        if number >= seen:
            first, second = (np.array(cast[index].style) for index in rng.choice(seen, 2, replace=seen < 2))
            style = Style(*(first + rng.uniform(0.3, 0.7) * (second - first)).tolist())
        cast.append(Speaker(f"speaker-{number:02d}", voice, style))
    return cast


def _make_clips(talk: _Talk) -> list[bytes]:
    """The encoded clips of one talk, in order of time."""
    speech_rng, room_rng, motion_rng = (np.random.default_rng(seed) for seed in talk.seed.spawn(3))
    style, sentences = talk.speaker.style, grammar.sentences(speech_rng)
    noise_level = 10 ** (room_rng.uniform(*_NOISE_DB) / 20)
    clips: list[bytes] = []
    time = 0.0
    for index in range(talk.num_clips):
        audio, words = _speak(sentences, talk.speaker.voice, speech_rng)
        # Rounded as it will be stored, so that the teacher hears what the model will hear.
        audio = np.round((audio + noise_level * _pink_noise(len(audio), room_rng)) * 2**15) / np.float32(2**15)
        positions, strokes = teacher.perform(audio, words, style, motion_rng, FPS)
        clip = records.Clip(
            id=f"{talk.name}-{index}",
            speaker=talk.speaker.name,
            audio=audio,
            words=words,
            positions=positions,
            reference_frames=np.stack([portrait.portrait(pose, style) for pose in positions[:_REFERENCE_FRAMES]]),
            source_time=time,
            window_starts=tuple(range(0, len(positions) - records.WINDOW_FRAMES + 1, records.WINDOW_STRIDE)),
            strokes=strokes,
            style=tuple(style),
            talk=talk.name,
        )
        clips.append(records.encode_clip(clip))
        time += len(audio) / SAMPLE_RATE
    return clips


def _speak(sentences: Iterator[str], voice: Voice, rng: np.random.Generator) -> tuple[np.ndarray, tuple[Word, ...]]:
    """Sentences with pauses between them, enough for one clip: (samples,) float32 and the words."""
    target = round(rng.uniform(*_CLIP_SECONDS) * SAMPLE_RATE)
    audio = np.zeros(round(rng.uniform(0.2, 0.6) * SAMPLE_RATE), np.float32)
    words: list[Word] = []
    while len(audio) < target:
        start = len(audio) / SAMPLE_RATE
        utterance = speech.say(next(sentences), voice)
        words += [Word(word.text, start + word.start, start + word.end) for word in utterance.words]
        # espeak-ng ends every sentence with the same silence; people do not.
        spoken = utterance.audio[: round(utterance.words[-1].end * SAMPLE_RATE)]
        pause = np.zeros(round(rng.gamma(4, 0.12) * SAMPLE_RATE), np.float32)
        audio = np.concatenate([audio, spoken, pause])
    return audio * (_PEAK / np.abs(audio).max()), tuple(words)


def _pink_noise(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of a room, (num_samples,) float32 of standard deviation 1."""
    spectrum = np.fft.rfft(rng.standard_normal(num_samples))
    spectrum /= np.sqrt(np.arange(len(spectrum)) + 100.0)
    noise = np.fft.irfft(spectrum, num_samples)
    return (noise / noise.std()).astype(np.float32)

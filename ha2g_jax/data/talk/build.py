"""Build the Talk corpus: synthetic speakers, their speech, and gestures with a known ground truth."""

import functools
import itertools
import math
import os
import pathlib
import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import tqdm

from ha2g_jax.data import records
from ha2g_jax.data.corpus import TALK, TALK_VERSION, corpus_folder
from ha2g_jax.data.corpus_writer import MAX_FPS, MIN_FPS, CorpusWriter
from ha2g_jax.data.processes import parallel_map
from ha2g_jax.data.talk import grammar
from ha2g_jax.data.talk.speakers import (
    DEFAULT_SEED,
    DEFAULT_SPEAKERS,
    DEFAULT_SYNTHESISER,
    SYNTHESISERS,
    Speaker,
    draw_speakers,
    num_unseen,
    portrait,
)
from ha2g_jax.errors import UserError
from ha2g_jax.features import espeak as speech
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.files.cache import one_maker
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_TALK_MINUTES, MAX_TALK_SPEAKERS
from ha2g_jax.progress import progress_bar

FPS = 15
SPLITS = ("train", "val", "test", "test_unseen_speakers")

_DIED = "a worker process was killed, perhaps because memory ran out; use fewer --workers"
_DEFAULT_MINUTES = 144
_CLIP_SECONDS = (10.0, 19.0)  # a clip lasts until the end of the sentence at this time, some seconds longer
_MEAN_CLIP_SECONDS = 17.8
_LONG_PAUSE, _LONG_PAUSE_SECONDS = 0.15, (2.0, 6.0)  # probability of a long pause between sentences, its duration
_CLIPS_PER_RECORDING = 2
# Of a core of a server of 2023, and of the disk, for one minute of speech.
_SECONDS_PER_MINUTE, _MEGABYTES_PER_MINUTE = 2.1, 1.7
# Fractions of the recordings.
_UNSEEN_RECORDINGS, _TEST_RECORDINGS, _VAL_RECORDINGS = 1 / 11, 1 / 11, 1 / 17

_REFERENCE_FRAMES = 7  # the largest M of Table 11
_PEAK = 0.7
_NOISE_DB = (-75.0, -50.0)  # background noise, relative to full scale

_VAL_STRIDE = 7

_RECORDING_SEEDS = 1  # first number of spawn keys; those of `speakers` have 0


class _RecordingPlan(NamedTuple):
    """All that a worker needs to make the clips of one recording; equal values give equal bytes."""

    name: str
    split: str
    synthesiser: str
    speaker: Speaker
    num_clips: int
    seed: np.random.SeedSequence


def make_talk(
    out: str | os.PathLike,
    *,
    speakers: int = DEFAULT_SPEAKERS,
    minutes: float = _DEFAULT_MINUTES,
    seed: int = DEFAULT_SEED,
    workers: int | None = None,
    fps: int = FPS,
    synthesiser: str = DEFAULT_SYNTHESISER,
) -> None:
    """Make a Talk corpus in the folder `out`, of about so many minutes of speech of at least 2 speakers.

    Equal arguments give equal bytes, whatever the number of workers, which is one per core by default; the speech does
    not depend on the frames per second of the motion. One speaker in six occurs only in the split
    `test_unseen_speakers`, with a new voice and a style between two styles of training. Nothing is left of the folder
    if the work is interrupted. The voices are those of one of `SYNTHESISERS`.

    Raises:
        UserError: `out` exists or cannot be written, there are too few speakers or minutes for all splits, a number is
            beyond its limits, or the synthesiser is not installed.
    """
    from ha2g_jax.data.talk import teacher  # its import takes a second, which training on a corpus need not wait for

    _check(speakers, minutes, seed, fps, synthesiser)
    plans = _plan(speakers, minutes, seed, synthesiser)
    options = f" --fps {fps}" if fps != FPS else ""
    if synthesiser != DEFAULT_SYNTHESISER:
        options += f" --synthesiser {synthesiser}"
    metadata = {
        "name": TALK_VERSION,
        "source": f"ha2g data make-talk --speakers {speakers} --minutes {minutes:g} --seed {seed}{options}",
        "licence": SYNTHESISERS[synthesiser].licence,
    }
    workers = min(workers or os.cpu_count() or 1, len(plans))
    with (
        CorpusWriter(out, splits=SPLITS, skeleton=teacher.SKELETON, fps=fps, metadata=metadata) as writer,
        parallel_map(workers, _DIED) as each,
    ):
        _say_how_long(minutes, workers)
        with progress_bar("making the Talk corpus", len(plans), "recording") as bar:
            for plan, clips in zip(plans, each(functools.partial(_make_clips, fps=fps), plans)):
                for clip in clips:
                    writer.add(plan.split, clip)
                bar.update()


def talk_path(spec: str) -> pathlib.Path:
    """Return `data.corpus.corpus_folder` of a name, and build the Talk corpus if it is asked for and not there.

    Raises:
        UserError: the default Talk corpus cannot be written.
    """
    path = corpus_folder(spec)
    if spec == TALK and not os.path.lexists(path):
        with one_maker(path):
            if not os.path.lexists(path):  # otherwise another process has made the same corpus in the meantime
                tqdm.tqdm.write(
                    f"the Talk corpus is made once, and kept in {shown(path)} (HA2G_CACHE names another folder)",
                    file=sys.stderr,
                )
                make_talk(path)
    return path


def _check(num_speakers: int, minutes: float, seed: int, fps: int, synthesiser: str) -> None:
    limits = {
        "speakers": (num_speakers, 0, MAX_TALK_SPEAKERS),
        "minutes": (minutes, 0, MAX_TALK_MINUTES),
        "seed": (seed, 0, 2**64 - 1),
        "fps": (fps, MIN_FPS, MAX_FPS),
    }
    for name, (value, least, most) in limits.items():
        if not least <= value <= most:  # NaN is not
            raise UserError(f"--{name} is {shown(str(value))}, expected {least} to {most:,}")
    voice = SYNTHESISERS[synthesiser].sample_voice(np.random.default_rng(0))
    SYNTHESISERS[synthesiser].say("ready.", voice)  # fails here if it is not installed, and not in the workers


def _say_how_long(minutes: float, workers: int) -> None:
    expected = minutes * _SECONDS_PER_MINUTE / min(workers, os.cpu_count() or 1)
    if expected > 30:
        tqdm.tqdm.write(
            f"making {minutes:g} minutes of speech and gestures, {minutes * _MEGABYTES_PER_MINUTE:.0f} MB: about "
            f"{max(1, round(expected / 60))} min with {workers} processes if the machine is otherwise idle",
            file=sys.stderr,
        )


def _plan(num_speakers: int, minutes: float, seed: int, synthesiser: str) -> list[_RecordingPlan]:
    num_clips = round(minutes * 60 / _MEAN_CLIP_SECONDS)
    unseen = num_unseen(num_speakers)
    seen = num_speakers - unseen
    clips_each = _CLIPS_PER_RECORDING if num_clips >= 4 * _CLIPS_PER_RECORDING * num_speakers else 1
    num_recordings = num_clips // clips_each
    counts = {
        "val": max(1, round(num_recordings * _VAL_RECORDINGS)),
        "test": max(1, round(num_recordings * _TEST_RECORDINGS)),
        "test_unseen_speakers": max(unseen, round(num_recordings * _UNSEEN_RECORDINGS)),
    }
    counts["train"] = num_recordings - sum(counts.values())
    if seen < 1:
        raise UserError(f"{num_speakers} speakers are too few for a split of unseen ones; give at least 2")
    if counts["train"] < seen:
        raise UserError(f"{minutes:g} minutes are too few for {num_speakers} speakers; give at least {num_speakers}")

    speakers = draw_speakers(seen, unseen, seed, synthesiser)
    plans: list[_RecordingPlan] = []
    for key, split in enumerate(SPLITS):
        pool = speakers[seen:] if split == "test_unseen_speakers" else speakers[:seen]
        # With a stride of its own, val takes other speakers than test, and each once before any twice.
        stride = _coprime(len(pool), _VAL_STRIDE) if split == "val" else 1
        for number in range(counts[split]):
            speaker = pool[number * stride % len(pool)]
            own_seed = np.random.SeedSequence(seed, spawn_key=(_RECORDING_SEEDS, key, number))
            plans.append(_RecordingPlan(f"{split}-{number:04d}", split, synthesiser, speaker, clips_each, own_seed))
    return plans


def _coprime(number: int, least: int) -> int:
    """Return the smallest integer from `least` on that has no divisor in common with a number."""
    return next(candidate for candidate in itertools.count(least) if math.gcd(candidate, number) == 1)


def _make_clips(plan: _RecordingPlan, fps: int) -> list[bytes]:
    from ha2g_jax.data.talk import teacher

    speech_rng, noise_rng, motion_rng = (np.random.default_rng(seed) for seed in plan.seed.spawn(3))
    length, stride = (records.frames_at(frames, fps) for frames in (records.WINDOW_FRAMES, records.WINDOW_STRIDE))
    style, sentences = plan.speaker.style, grammar.sentences(speech_rng)
    say = SYNTHESISERS[plan.synthesiser].say
    noise_level = 10 ** (noise_rng.uniform(*_NOISE_DB) / 20)
    clips: list[bytes] = []
    time = 0.0
    for index in range(plan.num_clips):
        audio, words = _speak(sentences, say, plan.speaker.voice, speech_rng)
        # Rounded as it will be stored, so that the teacher gets the samples that the model will get.
        audio = np.round((audio + noise_level * _pink_noise(len(audio), noise_rng)) * 2**15) / np.float32(2**15)
        positions, strokes = teacher.perform(audio, words, style, motion_rng, fps)
        clip = records.Clip(
            id=f"{plan.name}-{index}",
            speaker=plan.speaker.name,
            audio=audio,
            words=words,
            positions=positions,
            reference_images=np.stack([portrait(pose, style) for pose in positions[:_REFERENCE_FRAMES]]),
            recording_start=time,
            window_starts=tuple(range(0, len(positions) - length + 1, stride)),
            strokes=strokes,
            style=tuple(style),
            recording=plan.name,
        )
        clips.append(records.encode_clip(clip))
        time += len(audio) / SAMPLE_RATE
    return clips


def _speak(
    sentences: Iterator[str], say: Callable[[str, Any], speech.Utterance], voice: Any, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[Word, ...]]:
    """Speak sentences with pauses between them, enough for one clip: (samples,) float32 and the words."""
    target = round(rng.uniform(*_CLIP_SECONDS) * SAMPLE_RATE)
    audio = np.zeros(round(rng.uniform(0.2, 0.6) * SAMPLE_RATE), np.float32)
    words: list[Word] = []
    while len(audio) < target:
        start = len(audio) / SAMPLE_RATE
        utterance = say(next(sentences), voice)
        words += [Word(word.text, start + word.start, start + word.end) for word in utterance.words]
        # A synthesiser ends every sentence with the same silence; people do not.
        spoken = utterance.audio[: round(utterance.words[-1].end * SAMPLE_RATE)]
        is_long, short, long = rng.random() < _LONG_PAUSE, rng.gamma(4, 0.12), rng.uniform(*_LONG_PAUSE_SECONDS)
        pause = np.zeros(round((long if is_long else short) * SAMPLE_RATE), np.float32)
        audio = np.concatenate([audio, spoken, pause])
    return audio * (_PEAK / np.abs(audio).max()), tuple(words)


def _pink_noise(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    """Draw background noise, (num_samples,) float32 of standard deviation 1."""
    spectrum = np.fft.rfft(rng.standard_normal(num_samples))
    spectrum /= np.sqrt(np.arange(len(spectrum)) + 100.0)
    noise = np.fft.irfft(spectrum, num_samples)
    return (noise / noise.std()).astype(np.float32)

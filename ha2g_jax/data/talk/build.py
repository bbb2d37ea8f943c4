"""Build the Talk corpus: synthetic speakers, their speech, and gestures with a known ground truth."""

import functools
import itertools
import math
import os
import pathlib
import re
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import tqdm

from ha2g_jax.data import records
from ha2g_jax.data.corpus import TALK, TALK_VERSION, corpus_folder
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.processes import parallel_map
from ha2g_jax.data.talk import backgrounds, grammar
from ha2g_jax.data.talk.speakers import (
    DEFAULT_SEED,
    DEFAULT_SPEAKERS,
    DEFAULT_SYNTHESISER,
    SYNTHESISERS,
    Speaker,
    Voice,
    draw_speakers,
    num_unseen,
    portrait,
    sample_voice,
    say,
)
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.espeak import Utterance
from ha2g_jax.features.text import Word
from ha2g_jax.files.cache import one_maker
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_FPS, MAX_TALK_MINUTES, MAX_TALK_SPEAKERS, MIN_FPS
from ha2g_jax.progress import progress_bar

FPS = 15
SPLITS = ("train", "val", "test", "test_unseen_speakers")

_DIED = "a worker process was killed, perhaps because memory ran out; use fewer --workers"
_DEFAULT_MINUTES = 144
_CLIP_SECONDS = (10.0, 19.0)  # a clip ends with the sentence that is spoken at such a time, some seconds later
_MEAN_CLIP_SECONDS = 17.8
_LONG_PAUSE, _LONG_PAUSE_SECONDS = 0.15, (2.0, 6.0)  # probability of a long pause between sentences, and its duration
_LATE = 0.1  # probability that a varied clip begins with a long pause
_GAP = 0.04  # largest gap in seconds between two words of speech without pauses
_TURN = 0.6  # probability that the other of two people goes on after a sentence
_CLIPS_PER_RECORDING = 2
# Time of a core of a server of 2023, and disk space, for one minute of speech.
_SECONDS_PER_MINUTE, _MEGABYTES_PER_MINUTE = 0.6, 1.4
# Fractions of the recordings.
_UNSEEN_RECORDINGS, _TEST_RECORDINGS, _VAL_RECORDINGS = 1 / 11, 1 / 11, 1 / 17

# Recordings of speech like that of the other splits, and recordings of other kinds, with their fractions.
_SPEECH, _KINDS = "speech", dict.fromkeys(("rest", "two people", "no pauses", "no emphasis"), 1 / 12)
_VARIED = ("train", "val")  # splits that have those kinds, other languages, and background sounds

_REFERENCE_FRAMES = 7  # the largest M of Table 11
_PEAK_DB = (-0.3, -40.0)  # peak of speech, relative to full scale; four of five are above -20
_NOISE_DB = (-72.0, -47.0)  # power of the background noise, relative to the peak of the speech
_BACKGROUND, _BACKGROUND_DB = 0.25, (-30.0, -5.0)  # probability of louder noise or of music, relative to the speech
_REST_DB = (-10.0, -90.0)  # level of noise and music alone, relative to full scale
_PARTS, _PART_SECONDS, _PART_DB, _SILENT = 3, (4.0, 9.0), (-20.0, 0.0), 0.15  # parts of rest; probability of silence
_PARTNER_DB = (-6.0, 6.0)  # level of the second of two people

_VAL_STRIDE = 7

_RECORDING_SEEDS, _KIND_SEEDS = 1, 2  # first numbers of spawn keys; those of `speakers` have 0


class _RecordingPlan(NamedTuple):
    """Everything that a worker needs to make the clips of one recording; equal plans give equal bytes."""

    name: str
    split: str
    kind: str
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
    """Make a Talk corpus in the folder `out`, with about `minutes` minutes of speech by at least 2 speakers.

    Equal arguments give equal bytes, whatever the number of workers, which is one per core by default; the speech does
    not depend on the frames per second of the motion. One speaker in six occurs only in the split
    `test_unseen_speakers`, with a new voice and a style between two styles of training. The splits `train` and `val`
    also have other languages, noise and music, with speech and alone, two people in turn, and speech without pauses or
    without emphasis.
    Nothing is left of the folder if the work is interrupted. The voices are those of one of `SYNTHESISERS`. A script
    calls this function below `if __name__ == "__main__":`, because worker processes import the script once more.

    Raises:
        UserError: `out` exists or cannot be written, there are too few speakers or minutes for all splits, a number is
            beyond its limits, or the synthesiser is not installed.
    """
    from ha2g_jax.data.talk import teacher  # imported here because it takes a second, for which training need not wait

    _check(speakers, minutes, seed, fps, synthesiser)
    plans = _plan(speakers, minutes, seed, synthesiser)
    options = f" --fps {fps}" if fps != FPS else ""
    if synthesiser != DEFAULT_SYNTHESISER:
        options += f" --synthesiser {synthesiser}"
    metadata = {
        "name": TALK_VERSION,
        "source": f"ha2g data make-talk --speakers {speakers} --minutes {minutes:g} --seed {seed}{options}",
        "licence": SYNTHESISERS[synthesiser],
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
    """Return `data.corpus.corpus_folder` of a name, and build the Talk corpus if it is requested and missing.

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
    for speaker in draw_speakers(6, 3, seed, synthesiser):  # with every voice of Flite
        say("ready.", speaker.voice)  # fails here if the synthesiser is not installed, and not in the workers


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
    english = [speaker for speaker in speakers[:seen] if speaker.language == grammar.ENGLISH]
    pools = {"train": speakers[:seen], "val": speakers[:seen], "test": english, "test_unseen_speakers": speakers[seen:]}
    for key, (split, pool) in enumerate(pools.items()):
        kinds = _draw_kinds(counts[split], np.random.SeedSequence(seed, spawn_key=(_KIND_SEEDS, key)))
        # With its own stride, val takes other speakers than test, and each once before any twice.
        stride = _coprime(len(pool), _VAL_STRIDE) if split == "val" else 1
        for number in range(counts[split]):
            speaker = pool[number * stride % len(pool)]
            own_seed = np.random.SeedSequence(seed, spawn_key=(_RECORDING_SEEDS, key, number))
            kind = kinds[number] if split in _VARIED else _SPEECH
            plans.append(_RecordingPlan(f"{split}-{number:04d}", split, kind, speaker, clips_each, own_seed))
    return plans


def _draw_kinds(count: int, seed: np.random.SeedSequence) -> list[str]:
    kinds = [kind for kind, fraction in _KINDS.items() for _ in range(round(fraction * count))]
    return np.random.default_rng(seed).permutation(kinds + [_SPEECH] * (count - len(kinds))).tolist()


def _coprime(number: int, least: int) -> int:
    """Return the smallest integer from `least` on that has no divisor in common with a number."""
    return next(candidate for candidate in itertools.count(least) if math.gcd(candidate, number) == 1)


def _make_clips(plan: _RecordingPlan, fps: int) -> list[bytes]:
    from ha2g_jax.data.talk import teacher

    speech_rng, noise_rng, motion_rng = (np.random.default_rng(seed) for seed in plan.seed.spawn(3))
    length, stride = (records.frames_at(frames, fps) for frames in (records.WINDOW_FRAMES, records.WINDOW_STRIDE))
    style, language = plan.speaker.style, plan.speaker.language
    sentences, voices = grammar.sentences(speech_rng, language), [plan.speaker.voice]
    if plan.kind == "two people":
        voices.append(sample_voice(speech_rng, language))
    noise_db = noise_rng.uniform(*_NOISE_DB)
    clips: list[bytes] = []
    time = 0.0
    for index in range(plan.num_clips):
        if plan.kind == "rest":
            audio, words = _rest(noise_rng), ()
            heard = np.zeros_like(audio)
        else:
            speech, words = _speak(sentences, voices, plan, speech_rng)
            audio, heard = _mix(speech, noise_db, plan.split in _VARIED, noise_rng)
        positions, strokes = teacher.perform(heard, words, style, motion_rng, fps)
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
    sentences: Iterator[str], voices: Sequence[Voice], plan: _RecordingPlan, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[Word, ...]]:
    """Speak sentences with pauses between them, enough for one clip: (samples,) float32 with a peak of 1, and words."""
    target = round(rng.uniform(*_CLIP_SECONDS) * SAMPLE_RATE)
    is_late = plan.split in _VARIED and rng.random() < _LATE
    length = round(rng.uniform(*(_LONG_PAUSE_SECONDS if is_late else (0.2, 0.6))) * SAMPLE_RATE)
    turns: list[tuple[int, int, np.ndarray]] = []  # number of the voice, first sample, samples
    words: list[Word] = []
    speaking = 0
    while length < target:
        start = length / SAMPLE_RATE
        markup = next(sentences)
        if plan.kind == "no emphasis":
            markup = re.sub("<[^>]*>", "", markup)
        utterance = say(markup, voices[speaking])
        if plan.kind == "no pauses":
            utterance = _without_gaps(utterance)
        words += [Word(word.text, start + word.start, start + word.end) for word in utterance.words]
        # A synthesiser ends every sentence with the same silence; people do not.
        spoken = utterance.audio[: round(utterance.words[-1].end * SAMPLE_RATE)]
        turns.append((speaking, length, spoken))
        is_long, short, long = rng.random() < _LONG_PAUSE, rng.gamma(4, 0.12), rng.uniform(*_LONG_PAUSE_SECONDS)
        pause = _GAP if plan.kind == "no pauses" else long if is_long else short
        length += len(spoken) + round(pause * SAMPLE_RATE)
        if len(voices) > 1 and rng.random() < _TURN:
            speaking = 1 - speaking
    tracks = np.zeros((len(voices), length), np.float32)
    for speaking, first, spoken in turns:
        tracks[speaking, first : first + len(spoken)] = spoken
    tracks /= np.maximum(np.abs(tracks).max(axis=1, keepdims=True), 1e-6)
    tracks[1:] *= 10 ** (rng.uniform(*_PARTNER_DB) / 20) if len(voices) > 1 else 1
    audio = tracks.sum(axis=0)
    return audio / np.abs(audio).max(), tuple(words)


def _without_gaps(utterance: Utterance) -> Utterance:
    """Shorten the silences between the words of an utterance."""
    keep = np.ones(len(utterance.audio), bool)
    ends = [0.0, *(word.end for word in utterance.words)]
    for end, word in zip(ends, utterance.words):
        keep[round((end + _GAP) * SAMPLE_RATE) : round(word.start * SAMPLE_RATE)] = False
    kept = np.cumsum(keep) / SAMPLE_RATE

    def moved(time: float) -> float:
        return float(kept[min(round(time * SAMPLE_RATE), len(kept) - 1)])

    words = tuple(Word(word.text, moved(word.start), moved(word.end)) for word in utterance.words)
    return Utterance(utterance.audio[keep], words)


def _mix(
    speech: np.ndarray, noise_db: float, is_varied: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return speech with background noise and perhaps louder sounds, and the same without those sounds.

    Both are rounded as they will be stored, so that the teacher, which gets the latter, and the model agree.
    """
    heard = speech + 10 ** (noise_db / 20) * backgrounds.coloured_noise(len(speech), 1.0, rng)
    audio = heard
    if is_varied and rng.random() < _BACKGROUND:
        power = np.mean(np.square(speech, dtype=np.float64)[speech != 0])
        audio = heard + np.sqrt(power) * 10 ** (rng.uniform(*_BACKGROUND_DB) / 20) * _background(len(speech), rng)
    loud, quiet = _PEAK_DB
    gain = 10 ** ((loud + (quiet - loud) * rng.beta(1, 2.5)) / 20) / np.abs(audio).max()
    return _as_stored(gain * audio), _as_stored(gain * heard)


def _rest(rng: np.random.Generator) -> np.ndarray:
    """Draw several noises, pieces of music and silences one after another, enough for one clip: (samples,) float32."""
    parts = []
    for _ in range(_PARTS):
        num_samples = round(rng.uniform(*_PART_SECONDS) * SAMPLE_RATE)
        gain = 10 ** (rng.uniform(*_PART_DB) / 20) * (rng.random() >= _SILENT)
        parts.append(gain * _background(num_samples, rng))
    sound = np.concatenate(parts)
    loud, quiet = _REST_DB
    level = 10 ** ((loud + (quiet - loud) * rng.random() ** 1.5) / 20)
    return _as_stored(sound * min(level, 0.95 / max(np.abs(sound).max(), 1e-9)))


def _background(num_samples: int, rng: np.random.Generator) -> np.ndarray:
    draw = backgrounds.draw_noise if rng.random() < 0.5 else backgrounds.draw_music
    return draw(num_samples, rng)


def _as_stored(sound: np.ndarray) -> np.ndarray:
    return np.round(sound * 2**15).astype(np.float32) / np.float32(2**15)

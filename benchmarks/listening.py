"""Nods of a stream that listens, against the ends of phrases of the other's words.

python benchmarks/listening.py
python benchmarks/listening.py --minutes 5 --json

Voices of languages and of a person (Flite, where it is installed) that set no threshold read sentences with pauses of
random length. The times of their words come from the synthesiser, and the nods from the motion. The floor is the mean
over the same nods against sound that is rotated by 4, 6, 8, ... seconds. The exit code is 1 where precision or recall
over all voices is below 0.8.
"""

import argparse
import json
import sys
from typing import Any

import numpy as np
import tqdm

import ha2g_jax
from ha2g_jax.cli.parser import positive
from ha2g_jax.data.talk import flite, grammar, speakers
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.nods import TOLERANCE, due_nods, nod_times
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.espeak import Voice
from ha2g_jax.features.text import Word
from ha2g_jax.metrics.beats.strokes import match, precision, recall
from ha2g_jax.synthesis import Model

_LEAST = 0.8
_LANGUAGES = ("de", "fr", "cs", "el", "ro")  # none of them is in the Talk corpus
_SHIFT = 2.0  # seconds


def main() -> int:
    """Run the benchmark and print the table; return 1 where precision or recall is too low."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=positive, default=2, help="of each voice")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = measure(ha2g_jax.load("demo"), 60.0 * arguments.minutes)
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0 if min(rows[-1]["recall"], rows[-1]["precision"]) >= _LEAST else 1


def measure(model: Model, seconds: float) -> list[dict[str, Any]]:
    """Return the scores of each voice, and of all together in the last row."""
    voices: dict[str, speakers.Voice] = {
        f"espeak-ng {language}": Voice(language, variant, 50, 60, rate)
        for language, variant, rate in zip(_LANGUAGES, ("m3", "f2", "m5", "f4", "m1"), (165, 150, 180, 140, 200))
    }
    voices |= {f"Flite {name}": flite.FliteVoice(name, 1.0, 1.0, 1.0) for name in ("rms", "kal16")}
    counts: dict[str, np.ndarray] = {}
    for name, voice in tqdm.tqdm(voices.items(), desc="voices", disable=None, leave=False):
        try:
            sound, words = speak(voice, seconds, np.random.default_rng(0))
        except UserError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        counts[name] = score(model, sound, words)
    counts["all"] = np.sum(list(counts.values()), axis=0)
    return [_row(name, own, floor) for name, (own, *floor) in counts.items()]


def speak(voice: speakers.Voice, seconds: float, rng: np.random.Generator) -> tuple[np.ndarray, list[Word]]:
    """Return sound (samples,) of sentences with pauses of 0.1 to 3 s, and its words."""
    pieces, words, time = [np.zeros(SAMPLE_RATE, np.float32)], [], 1.0
    for sentence in grammar.sentences(rng):
        if time > seconds:
            break
        utterance = speakers.say(sentence, voice)
        words += [Word(word.text, time + word.start, time + word.end) for word in utterance.words]
        audio = utterance.audio[: round(utterance.words[-1].end * SAMPLE_RATE)]
        pause = rng.uniform(1, 3) if rng.random() < 0.25 else rng.uniform(0.1, 1)
        pieces += [audio / np.abs(audio).max() / 3, np.zeros(round(pause * SAMPLE_RATE), np.float32)]
        time = sum(map(len, pieces)) / SAMPLE_RATE
    return np.concatenate([*pieces, np.zeros(2 * SAMPLE_RATE, np.float32)]), words


def score(model: Model, sound: np.ndarray, words: list[Word]) -> np.ndarray:
    """Return the counts (1 + shifts, 4) of `strokes.Matches` of the nods at a sound and at its rotations."""
    stream = model.stream()
    frames = [stream.feed(np.zeros_like(part), part) for part in np.array_split(sound, len(sound) // 1600)]
    nods = nod_times(stream.skeleton, np.concatenate([*frames, stream.flush()]), stream.fps)
    due, length = due_nods(words), len(sound) / SAMPLE_RATE
    shifts = [0.0, *np.linspace(2 * _SHIFT, length - 2 * _SHIFT, 50)]
    turned = [np.sort((due + shift) % length) for shift in shifts]
    return np.array([match(times, times, nods, TOLERANCE) for times in turned])


def _row(name: str, own: np.ndarray, floor: list[np.ndarray]) -> dict[str, Any]:
    due, _, nods, _ = own.tolist()
    scores = {"recall": recall(own[None]), "precision": precision(own[None])}
    floors = {"recall_floor": recall(np.array(floor)), "precision_floor": precision(np.array(floor))}
    return {"voice": name, "due": due, "nods": nods, **scores, **floors}


def as_table(rows: list[dict[str, Any]]) -> str:
    """Return the result as text."""
    lines = [f"{'voice':<14} {'due':>5} {'nods':>5} {'recall':>7} {'floor':>6} {'precision':>10} {'floor':>6}"]
    lines += [
        f"{row['voice']:<14} {row['due']:>5} {row['nods']:>5} {row['recall']:>7.2f} {row['recall_floor']:>6.2f} "
        f"{row['precision']:>10.2f} {row['precision_floor']:>6.2f}"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

"""A conversation of two voices in turn, with interruptions, cues and states, as a stream takes it.

python benchmarks/conversation.py
python benchmarks/conversation.py --minutes 1 --save conversation.npz

The agent and the other read sentences in turn, in pieces of 20 ms. The other interrupts at random moments, so that the
agent's speech is cleared; before half of its turns the agent thinks, and cues are made at random moments. A frame is
late where its computation ends more than a hop after the sound for it has come, if it is computed on one thread. A
transition ends with the first frame from which on the motion is that of a stream that has always been in the new state.
Memory is counted from when the stream remembers a minute. The exit code is 1 where a number is beyond its limit.
"""

import argparse
import gc
import resource
import sys
import time

import numpy as np
import tqdm

import ha2g_jax
from ha2g_jax.cli.parser import positive
from ha2g_jax.data.talk import speakers
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.espeak import Voice
from ha2g_jax.metrics.beats.strokes import wrist_positions
from ha2g_jax.motion.cues import NAMES
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.states import EASE, STATES
from ha2g_jax.synthesis import Model

INTERRUPTIONS, CUES = 10, 6  # a minute
MAX_WRIST_SPEED, MAX_SPEED = 6.0, 9.0  # m/s of a wrist, and of any joint: fingertips are the fastest
_PIECE = SAMPLE_RATE // 50
_REMEMBERED = 75.0  # seconds until a stream remembers a minute
_SETTLED_SPEED = 0.4  # m/s of a wrist that is at rest or listens


def main() -> int:
    """Run the benchmark and print the table; return 1 where a number is beyond its limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=positive, default=10)
    parser.add_argument("--save", metavar="FILE.npz", help="write the motion")
    arguments = parser.parse_args()
    rows, frames = measure(model := ha2g_jax.load("demo"), arguments.minutes)
    if arguments.save:
        Motion.from_directions(model.assets.skeleton, frames, model.spec.fps).save(arguments.save)
    for name, (value, limit) in rows.items():
        print(f"| {name} | {value:.4g} | {'' if limit is None else f'{limit:.4g}'} |")
    return int(any(limit is not None and value > limit for value, limit in rows.values()))


def speech(voice: Voice, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Return a voice that reads sentences, (samples,) at 16 kHz, for at least some seconds."""
    parts: list[np.ndarray] = []
    while sum(map(len, parts)) < seconds * SAMPLE_RATE:
        audio = speakers.say(" ".join(str(rng.choice(_SENTENCES)) for _ in range(3)), voice).audio
        parts.append((0.2 * audio / np.abs(audio).max()).astype(np.float32))
    return np.concatenate(parts)


_VOICES = Voice("en-us", "m3", 50, 60, 165), Voice("en", "f2", 50, 60, 180)
_SENTENCES = (
    "Well, there are three things that I would like to say about it.",
    "I really think that we should look at the whole picture first.",
    "No, that is not what I meant, and you know it very well.",
    "It was a big house on a hill, and you could see all of the town.",
)


def measure(model: Model, minutes: float) -> tuple[dict[str, tuple[float, float | None]], np.ndarray]:
    """Return values and limits by name, and the frames (T, bones, 3)."""
    rng, stream = np.random.default_rng(0), model.stream(seed=1)
    own, other = (speech(voice, 60, rng) for voice in _VOICES)
    count = round(60 * minutes * SAMPLE_RATE / _PIECE)
    chosen = rng.permutation(count)
    interruptions = set(chosen[: round(INTERRUPTIONS * minutes)].tolist())
    cues = set(chosen[-round(CUES * minutes) :].tolist())
    expected = round(count * _PIECE / SAMPLE_RATE * stream.fps)
    motion = np.full((expected, stream.skeleton.num_bones, 3), np.nan, np.float32)
    gc.freeze()  # as the programs that stream do
    lateness, firsts, cue_frames, made, ready, memory = np.zeros(count), [], [], 0, 0.0, 0
    turn, left = "agent", 0
    for piece in tqdm.tqdm(range(count), desc="conversation", disable=None, leave=False):
        if piece in interruptions:
            firsts.append(stream.clear())
            turn, left = "other", round(rng.uniform(1, 4) * 50)
        if piece in cues:
            cue_frames.append(made)
            stream.cue(str(rng.choice(NAMES)))
        if left == 0:
            is_thoughtful = turn == "other" and rng.random() < 0.5
            turn = "nobody" if is_thoughtful else "other" if turn == "agent" else "agent"
            left = round(rng.uniform(1, 3 if is_thoughtful else 8) * 50)
            stream.state = "think" if is_thoughtful else stream.state
        left -= 1
        start = piece * _PIECE % (60 * SAMPLE_RATE - _PIECE)
        silence = np.zeros(_PIECE, np.float32)
        voices = {"agent": own, "other": other}
        heard = [voice[start : start + _PIECE] if turn == name else silence for name, voice in voices.items()]
        begun = time.perf_counter()
        new = stream.feed(*heard)
        arrived = (piece + 1) * _PIECE / SAMPLE_RATE
        ready = max(ready, arrived) + time.perf_counter() - begun
        lateness[piece] = ready - arrived
        motion[made : made + len(new)] = new
        made += len(new)
        if arrived <= _REMEMBERED:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    growth = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    rest = stream.flush()
    motion[made : made + len(rest)] = rest
    missing = abs(made + len(rest) - expected)
    motion = motion[: made + len(rest)]
    wrists = wrist_positions(stream.skeleton, motion)
    speeds = stream.fps * np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max(axis=-1)
    joints = Motion.from_directions(stream.skeleton, motion, stream.fps).positions
    settled = [
        speeds[first + 7 : first + 12].max(initial=0)
        for first in firsts
        if not any(first - 45 < frame < first + 20 for frame in cue_frames)
    ]
    return {
        "minutes": (minutes, None),
        "interruptions": (len(firsts), None),
        "cues": (len(cue_frames), None),
        "frames missing or doubled": (missing, 0),
        "latest frame, s": (lateness.max(), stream.hop / stream.fps),
        "latest frame of 99.9 %, s": (float(np.quantile(lateness, 0.999)), None),
        "slowest transition, s": (slowest_transition(model, rng), EASE),
        "fastest wrist, m/s": (speeds.max(), MAX_WRIST_SPEED),
        "fastest joint, m/s": (
            stream.fps * np.linalg.norm(np.diff(joints, axis=0), axis=-1).max(),
            MAX_SPEED,
        ),
        "wrist 8 frames after a clear, m/s, 95 %": (float(np.quantile(settled, 0.95)), _SETTLED_SPEED),
        "memory after the first minutes, MiB": (growth, 8),
    }, motion


def slowest_transition(model: Model, rng: np.random.Generator) -> float:
    """Return the seconds that changes of state at random moments take at most."""
    silence, slowest = np.zeros(4 * SAMPLE_RATE, np.float32), 0.0
    states = [state for state in STATES if state != "auto"]
    for state in states:
        steady = model.stream()
        steady.state = state
        expected = steady.feed(silence)
        for before in states * 3:
            stream = model.stream()
            stream.state = before
            change = int(rng.integers(SAMPLE_RATE, 3 * SAMPLE_RATE))
            first = len(stream.feed(silence[:change]))
            stream.state = state
            differs = (stream.feed(silence[change:]) != expected[first:]).any(axis=(1, 2))
            slowest = max(slowest, (np.flatnonzero(differs).max(initial=-2) + 2) / stream.fps)
    return slowest


if __name__ == "__main__":
    sys.exit(main())

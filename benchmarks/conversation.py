"""A conversation of two voices in turn, with interruptions, cues and states, as a stream takes it.

python benchmarks/conversation.py
python benchmarks/conversation.py --minutes 1 --save conversation.npz

The agent and the other read sentences in turn, in pieces of 20 ms. The other interrupts at random moments, so that the
agent's speech is cleared; before most of its turns the agent thinks, and cues are made at random moments. A frame is
late where its computation ends more than a hop after the sound for it has come, if it is computed on one thread. The
exit code is 1 where a number is beyond its limit.
"""

import argparse
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
from ha2g_jax.synthesis import Model

INTERRUPTIONS, CUES = 10, 6  # a minute
MAX_WRIST_SPEED = 6.0  # m/s, of speech that is interrupted while a cue begins
_PIECE = SAMPLE_RATE // 50
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
    own, other = (
        speech(voice, 60, rng) for voice in (Voice("en-us", "m3", 50, 60, 165), Voice("en", "f2", 50, 60, 180))
    )
    count = round(60 * minutes * SAMPLE_RATE / _PIECE)
    chosen = rng.permutation(count)
    interruptions = set(chosen[: round(INTERRUPTIONS * minutes)].tolist())
    cues = set(chosen[-round(CUES * minutes) :].tolist())
    frames: list[np.ndarray] = []
    settled, cue_frames, late, ready, memory, firsts = [], [], 0.0, 0.0, 0, []
    turn, left = "agent", 0
    for piece in tqdm.tqdm(range(count), desc="conversation", disable=None, leave=False):
        if piece in interruptions:
            firsts.append(stream.clear())
            turn, left = "other", round(rng.uniform(1, 4) * 50)
        if piece in cues:
            cue_frames.append(len(frames))
            stream.cue(str(rng.choice(NAMES)))
        if left == 0:
            turn = "other" if turn == "agent" else "agent"
            left = round(rng.uniform(1, 8) * 50)
            stream.state = "think" if turn == "agent" and rng.random() < 0.5 else "auto"
        left -= 1
        start = piece * _PIECE % (60 * SAMPLE_RATE - _PIECE)
        silence = np.zeros(_PIECE, np.float32)
        voices = {"agent": own[start : start + _PIECE]} if turn == "agent" else {"other": other[start : start + _PIECE]}
        begun = time.perf_counter()
        new = stream.feed(voices.get("agent", silence), voices.get("other", silence))
        arrived = (piece + 1) * _PIECE / SAMPLE_RATE
        ready = max(ready, arrived) + time.perf_counter() - begun
        late = max(late, ready - arrived)
        frames += [*new]
        if piece == count // 4:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    growth = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    frames += [*stream.flush()]
    motion = np.stack(frames)
    speeds = stream.fps * np.linalg.norm(np.diff(wrist_positions(stream.skeleton, motion), axis=0), axis=-1).max(
        axis=-1
    )
    for first in firsts:
        if not any(first - 45 < frame < first + 20 for frame in cue_frames):
            settled.append(speeds[first + 7 : first + 12].max(initial=0))
    bones = 2 * np.arcsin(np.clip(np.linalg.norm(np.diff(motion, axis=0), axis=-1) / 2, 0, 1)) * stream.fps
    return {
        "minutes": (minutes, None),
        "interruptions": (len(firsts), None),
        "cues": (len(cue_frames), None),
        "frames missing or doubled": (abs(len(motion) - round(count * _PIECE / SAMPLE_RATE * stream.fps)), 0),
        "latest frame, s": (late, stream.hop / stream.fps),
        "fastest wrist, m/s": (speeds.max(), MAX_WRIST_SPEED),
        "fastest bone, rad/s": (bones.max(), None),
        "wrist 8 frames after a clear, m/s, 95 %": (float(np.quantile(settled, 0.95)), _SETTLED_SPEED),
        "memory after the first quarter, MiB": (growth, 8),
    }, motion


if __name__ == "__main__":
    sys.exit(main())

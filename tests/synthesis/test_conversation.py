"""A conversation of two voices in turn, with interruptions, cues and states, as a stream takes it."""

import numpy as np
import pytest

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.motion.cues import NAMES
from ha2g_jax.motion.motion import Motion
from ha2g_jax.synthesis import stream as streams

FPS, SECONDS, PIECE = 15, 30, 1600
MAX_SPEED = 6.0  # metres per second of a joint
EASE, SETTLED = 6, 8  # frames of a transition, and from a clear to rest or listening


def voice(seconds: float, seed: int) -> np.ndarray:
    """Noise with the rhythm of syllables, and a pause after each second."""
    time = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    noise = np.random.default_rng(seed).normal(0, 0.1, len(time)) * np.sin(4 * np.pi * time) ** 2
    return (noise * (time % 1.5 < 1.1)).astype(np.float32)


def test_a_conversation_has_no_gap_no_jump_and_a_flat_memory(debug_model, held_bytes, monkeypatch):
    """A few frames after it is interrupted the agent is as one who never spoke, whichever way its sound is sent."""
    monkeypatch.setattr(streams, "_REMEMBERED_SECONDS", 4)
    rng = np.random.default_rng(2)
    stream, silent = debug_model.stream(seed=3), debug_model.stream(seed=3)
    voices = np.stack([voice(SECONDS, 1), voice(SECONDS, 2)])
    moments = rng.permutation(np.arange(30, SECONDS * SAMPLE_RATE // PIECE - 30))
    frames, rest, cues, clears, sizes = [], [], [], [], []
    turn, left, samples = 0, 30, 0
    for number, start in enumerate(range(0, voices.shape[1], PIECE)):
        if number in moments[:9]:
            frame = None if rng.random() < 0.5 else len(frames) - int(rng.integers(20))
            first = stream.clear(frame)
            assert silent.clear(frame) == first
            samples = samples if frame is None else first * SAMPLE_RATE // FPS
            del frames[first:], rest[first:]
            clears = [*(earlier for earlier in clears if earlier + 15 < first), first]
            turn, left = 1, 15
        if number in moments[9:13]:
            cues.append(len(frames))
            stream.cue(str(rng.choice(NAMES)))
        if left == 0:
            turn, left = 1 - turn, int(rng.integers(10, 50))
            stream.state = str(rng.choice(["auto", "idle", "listen", "think"]))
        left -= 1
        silent.state = stream.state
        own, other = voices[:, start : start + PIECE] * np.eye(2, dtype=np.float32)[turn][:, None]
        frames += [*stream.feed(own, other)]
        rest += [*silent.feed(0 * own, other)]
        samples += PIECE
        assert samples / SAMPLE_RATE * FPS - len(frames) < FPS * stream.latency + 1e-6
        sizes.append(held_bytes(stream) if number % 10 == 9 else 0)
    frames += [*stream.flush()]
    assert len(frames) == round(samples / SAMPLE_RATE * FPS)
    assert max(sizes[len(sizes) // 2 :]) < 1.2 * max(sizes[: len(sizes) // 2])
    motion = np.stack(frames)
    positions = Motion.from_directions(stream.skeleton, motion, FPS).positions
    assert FPS * np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() < MAX_SPEED
    plain = [first for first in clears if not any(first - 30 < cue < first + 15 for cue in cues)]
    assert len(plain) >= 3
    for first in plain:
        settled = slice(first + SETTLED - 1, first + 15)
        np.testing.assert_allclose(motion[settled], np.stack(rest[settled]), atol=0.01)
    assert np.quantile(np.abs(motion[: len(rest)] - np.stack(rest)).max(axis=(1, 2)), 0.7) > 0.1


@pytest.mark.parametrize("state", ["idle", "listen", "think"])
def test_a_new_state_is_reached_from_any_other_within_its_time(debug_model, state):
    """Then the frames are those of a stream that has always been in it, whose next speech is without it."""
    sound = np.concatenate([np.zeros(32000, np.float32), voice(1, 1)])
    steady = debug_model.stream()
    steady.state = state
    expected = steady.feed(sound)
    for before in {"idle", "listen", "think"} - {state}:
        stream = debug_model.stream()
        stream.state = before
        first = len(stream.feed(sound[:16000]))
        stream.state = state
        frames = stream.feed(sound[16000:])
        is_equal = (frames == expected[first:]).all(axis=(1, 2))
        assert not is_equal[: EASE - 1].any() and is_equal[EASE - 1 :].all()

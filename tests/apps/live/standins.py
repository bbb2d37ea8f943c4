"""A clock that does not wait, a stream that computes nothing, and sounds."""

import numpy as np

from ha2g_jax.apps.live.clock import Clock
from ha2g_jax.skeleton import normalize

FPS = 15


class FakeClock(Clock):
    """A clock that advances by sleeping only."""

    def __init__(self):
        self.time = 100.0

    def now(self):
        return self.time

    def sleep(self, seconds):
        self.time += seconds


class FakeStream:
    """A stream whose frame k is known from its number and leaves when the sound of frame k + look_ahead has come."""

    fps = FPS

    def __init__(self, skeleton, look_ahead=3, hop=1):
        self.skeleton, self.look_ahead, self.hop = skeleton, look_ahead, hop
        self.latency = (look_ahead + hop) / FPS
        self.heard = self.frames = 0
        self.state = "auto"

    def feed(self, samples, other=None):
        assert samples.dtype == np.float32
        self.heard += len(samples)
        return self._until(self.heard * FPS // 16000 - self.look_ahead)

    def flush(self):
        return self._until(max(1, round(self.heard / 16000 * FPS)))

    def _until(self, count):
        first, self.frames = self.frames, max(count, self.frames)
        return poses(self.skeleton, self.frames)[first:]


def poses(skeleton, frames):
    """Return (frames, bones, 3) unit vectors of slow movements about the mean pose."""
    time = np.arange(frames)[:, None, None] / FPS
    phase = np.random.default_rng(0).uniform(0, 6, (1, skeleton.num_bones, 3))
    return normalize((skeleton.mean_directions + 0.1 * np.sin(time + phase)).astype(np.float32))


def tone(rate, seconds=1.0):
    return (0.3 * np.sin(2 * np.pi * 300 * np.arange(round(rate * seconds)) / rate)).astype(np.float32)


def pcm(samples):
    return np.round(samples * 32767).astype("<i2").tobytes()


def joined(chunks, name="samples"):
    return np.concatenate([getattr(chunk, name) for chunk in chunks])

"""Motion that stops at known moments, and stand-ins for what takes long."""

import dataclasses

import numpy as np
import pytest

from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.skeleton import Skeleton, load_skeleton, normalize

FPS = 15.0


@pytest.fixture(scope="session")
def skeleton() -> Skeleton:
    return load_skeleton("ted_gesture")


@dataclasses.dataclass
class LinearFeatures:
    """A random linear map in place of the encoder."""

    skeleton: Skeleton
    id: str = "0123456789abcdef" * 4
    name: str = "autoencoder"
    data: str = "toy"
    latent_dim: int = 4
    fps: float = FPS

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        weights = np.random.default_rng(0).standard_normal(
            (WINDOW_FRAMES * 3 * self.skeleton.num_bones, self.latent_dim)
        )
        centred = windows.astype(np.float64) - self.skeleton.mean_directions[None, None]
        return centred.reshape(len(windows), -1) @ weights / 10

    def reconstruction_error(self, windows: np.ndarray) -> float:
        return 0.125


@pytest.fixture(scope="session")
def features(skeleton) -> LinearFeatures:
    return LinearFeatures(skeleton)


def stopping_motion(
    skeleton: Skeleton, clip: int, num_frames: int, delay: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Direction vectors that stop `delay` seconds after every second onset, and the onsets; random by the clip."""
    random = np.random.default_rng(clip)
    onsets = np.cumsum(random.uniform(0.25, 0.8, 60))
    time = np.arange(num_frames) / FPS
    stops = np.exp(-np.square(time - onsets[::2, None] - delay) / (2 * 0.06**2)).sum(axis=0)
    phase = np.cumsum(1 - np.clip(stops, 0, 0.98)) / FPS * 2 * np.pi * 0.7
    first, second = random.normal(0, 0.25, (2, 1, skeleton.num_bones, 3))
    waves = first * np.sin(phase)[:, None, None] + second * np.cos(1.3 * phase)[:, None, None]
    directions = normalize((skeleton.mean_directions[None] + waves).astype(np.float32))
    return directions, onsets[onsets < num_frames / FPS]


@pytest.fixture(scope="session")
def perform(skeleton):
    """A function to clip results of clips 0 to n - 1, three clips to a source."""

    def perform(num_clips: int, num_frames: int = 120, *, delay: float = 0.0, **fields) -> list[ClipResult]:
        made = []
        for clip in range(num_clips):
            directions, onsets = stopping_motion(skeleton, clip, num_frames, delay)
            made.append(ClipResult(f"clip{clip}", f"talk{clip // 3}", directions, FPS, onsets, **fields))
        return made

    return perform

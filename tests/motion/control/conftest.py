"""Motion to control: everything moves, smoothly, about the mean pose."""

from collections.abc import Callable

import numpy as np
import pytest

from ha2g_jax.motion.control.parts import (
    FINGER,
    FOREARM,
    HAND,
    HEAD,
    TRUNK,
    UPPER_ARM,
    apply_rotations,
    bones_of,
    parts,
    turns,
)
from ha2g_jax.motion.rotations import from_vector
from ha2g_jax.skeleton import Skeleton, normalize

FPS = 15
_RADIANS = {TRUNK: 0.04, HEAD: 0.12, UPPER_ARM: 0.2, FOREARM: 0.35, HAND: 0.3, FINGER: 0.2}


@pytest.fixture
def gestures() -> Callable[..., np.ndarray]:
    """A function that gives (T, bones, 3) directions of a skeleton for some seconds."""

    def perform(skeleton: Skeleton, seconds: float = 12, fps: float = FPS, seed: int = 0) -> np.ndarray:
        rng = np.random.default_rng(seed)
        time = np.arange(round(seconds * fps))[:, None, None] / fps
        rotations = {}
        for part in parts(skeleton):
            for bones in {part.bones, *((bone,) for bone in part.bones)}:
                pace, phase = rng.uniform(0.4, 1.4, (2, 3)), rng.uniform(0, 6, (2, 3))
                size = _RADIANS[part.kind] * (0.2 if len(part.bones) > 1 and len(bones) == 1 else 1)
                rotations[bones] = from_vector(size * np.sin(2 * np.pi * pace * time + phase).sum(axis=1))
        mean = normalize(skeleton.mean_directions.astype(np.float64))
        ordered = np.stack([rotations[turn.bones] for turn in turns(parts(skeleton))], axis=1)
        poses = apply_rotations(mean, ordered, parts(skeleton))
        return poses[:, np.argsort(bones_of(parts(skeleton)))].astype(np.float32)

    return perform

"""The legacy rules to the letter: a plain loop written from them, stored values, and their faults."""

import math

import numpy as np
import pytest

from ha2g_jax.metrics.legacy import legacy_bc
from ha2g_jax.skeleton import Skeleton, load_skeleton

ONSETS = [
    np.array([0.032, 0.416, 0.96, 1.632]),
    np.array([0.256, 0.704, 1.184, 1.216, 2.144]),
    np.array([1.024]),
    np.array([0.16, 0.512, 2.208]),
]
GOLDEN = {  # (skeleton, variant, threshold): score of `windows` with ONSETS
    ("ted_expressive", "paper", 0.03): 0.6870251983275354,
    ("ted_expressive", "paper", 4.0): 0.6818116031993359,
    ("ted_expressive", "fixed", 0.03): 0.5832824765821524,
    ("ted_expressive", "fixed", 0.2): 0.5099840880025389,
    ("ted_gesture", "paper", 0.03): 0.8286482482806204,
    ("ted_gesture", "paper", 4.0): 0.8286482482806204,
    ("ted_gesture", "fixed", 0.03): 0.6844805157665563,
    ("ted_gesture", "fixed", 1.2): 0.7519597077817414,
}


def windows(skeleton: Skeleton, num: int = 4) -> np.ndarray:
    """(num, 34, bones, 3) restored vectors of no unit length that move by closed formulas; the third stands still."""
    time = np.arange(34)[None, :, None, None]
    bone = np.arange(skeleton.num_bones)[None, None, :, None]
    axis = np.arange(3)[None, None, None]
    clip = np.arange(num)[:, None, None, None]
    speed = 0.35 + 0.11 * clip + 0.02 * ((bone + axis) % 5)
    sway = 0.05 * np.sin(speed * time + bone + 2.1 * axis + clip) + 0.02 * np.sin(0.9 * time + 1.7 * bone * axis)
    return skeleton.mean_directions.astype(np.float64)[None, None] + np.where(
        clip == 2, 0.01 * np.cos(bone * axis + axis), sway
    )


def plain(skeleton: Skeleton, clips: np.ndarray, onsets: list[np.ndarray], variant: str, threshold: float) -> float:
    """Rules 1 to 8, one number at a time."""
    total = count = 0
    for clip, heard in zip(clips.tolist(), onsets, strict=True):
        angles = []
        for frame in clip:
            vectors = frame
            if variant == "paper":
                means = skeleton.mean_directions.tolist()
                vectors = [[x - m for x, m in zip(*pair, strict=True)] for pair in zip(frame, means, strict=True)]
            normals = [np.cross(vectors[first], vectors[second]).tolist() for first, second in skeleton.palms]
            units = [[x / math.hypot(*vector) for x in vector] for vector in vectors + normals]
            dots = [sum(x * y for x, y in zip(units[a], units[b], strict=True)) for a, b in skeleton.angle_pairs]
            angles.append([math.acos(max(-1.0, min(1.0, dot))) / math.pi for dot in dots])
        rate = [0.0]
        for t in range(1, 34):
            steps = [abs(now - then) for now, then in zip(angles[t], angles[t - 1], strict=True)]
            rate.append(sum(x / c for x, c in zip(steps, skeleton.angle_change.tolist(), strict=True)) / len(steps))
        beats = []
        for t in range(2, 33):
            is_lowest = rate[t] < rate[t - 1] and rate[t] < rate[t + 1]
            if is_lowest and (rate[t - 1] - rate[t] >= threshold or rate[t + 1] - rate[t] >= threshold):
                beats.append(t / 15)
        if not beats:
            continue
        for onset in heard.tolist():
            total += math.exp(-(min(abs(onset - beat) for beat in beats) ** 2) / (2 * 0.1**2))
        count += len(heard)
    return total / count


@pytest.mark.parametrize(("name", "variant", "threshold"), GOLDEN)
def test_stored_cases_value_for_value(name, variant, threshold):
    skeleton = load_skeleton(name)
    clips = windows(skeleton)
    golden = GOLDEN[name, variant, threshold]
    assert plain(skeleton, clips, ONSETS, variant, threshold) == pytest.approx(golden, abs=1e-12)
    assert legacy_bc(skeleton, clips, ONSETS, variant=variant, threshold=threshold) == pytest.approx(golden, abs=1e-12)


def test_onsets_are_pooled_and_a_motionless_clip_is_passed_over():
    skeleton = load_skeleton("ted_expressive")
    clips = windows(skeleton)
    parts = [legacy_bc(skeleton, clips[[i]], [ONSETS[i]]) for i in (0, 1, 3)]
    pooled = np.average(parts, weights=[len(ONSETS[i]) for i in (0, 1, 3)])
    assert legacy_bc(skeleton, clips, ONSETS) == pytest.approx(pooled, abs=1e-12)
    assert len(set(parts)) == 3
    for variant in ("paper", "fixed"):
        assert math.isnan(legacy_bc(skeleton, clips[[2]], [ONSETS[2]], variant=variant))
        assert math.isnan(legacy_bc(skeleton, clips[[0]], [np.zeros(0)], variant=variant))

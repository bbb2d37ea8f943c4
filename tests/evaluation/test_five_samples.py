"""Five motions for each speech, in folders or by numbers: multimodality has its known value."""

import dataclasses
import functools

import numpy as np
import pytest
from evaluation.conftest import LinearFeatures

from ha2g_jax.evaluation import scoring
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.evaluation.scoring import evaluate_folders
from ha2g_jax.motion.motion import Motion

CLIPS, SAMPLES, FRAMES = 3, 5, 80
ANGLE = 0.05  # radians between two samples that follow each other
LATENT_DIM = 4


@dataclasses.dataclass
class AngleFeatures(LinearFeatures):
    """All values of a latent are the angle of the first bone in the plane x, y, in the first frame."""

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        angles = np.arctan2(windows[:, 0, 0, 1], windows[:, 0, 0, 0]).astype(np.float64)
        return np.repeat(angles[:, None], LATENT_DIM, axis=1)


def rotated(skeleton, clip: int, angle: float) -> Motion:
    """A motion whose first bone is rotated in the plane x, y, by another angle in each clip."""
    swing = 0.2 * np.sin(np.arange(FRAMES) / 9 + clip)[:, None, None]
    directions = np.tile(skeleton.mean_directions, (FRAMES, 1, 1)) + swing
    directions[:, 0] = [np.cos(clip / 5 + angle), np.sin(clip / 5 + angle), 0]
    return Motion.from_directions(skeleton, directions, 15)


@pytest.fixture
def score(skeleton, tmp_path, monkeypatch):
    """A function from the angles of the samples and the names of their files to the score of multimodality."""
    monkeypatch.setattr(scoring, "_features", lambda path: AngleFeatures(skeleton))
    monkeypatch.setattr(scoring, "evaluate", functools.partial(evaluate, draws=10))

    def score(angles, layout):
        for clip in range(CLIPS):
            for number, angle in enumerate([0.0, *angles]):
                name = layout.format(number=number, clip=f"talk{clip}") if number else f"talk{clip}"
                path = tmp_path / ("motion" if number else "true") / f"{name}.npz"
                path.parent.mkdir(parents=True, exist_ok=True)
                rotated(skeleton, clip, angle).save(path)
        results = evaluate_folders(tmp_path / "motion", tmp_path / "true", autoencoder=tmp_path)
        [section] = results["sections"].values()
        return section["rows"]["motion"]["multimodality"]

    return score


LAYOUTS = ["{clip}.{number}", "sample_{number}/{clip}"]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_samples_at_equal_distances_have_the_mean_of_their_distances(score, layout):
    """Of ten pairs of five, the mean difference of the numbers is 2; with L1 each value of the latent counts."""
    found = score([number * ANGLE for number in range(SAMPLES)], layout)
    for end in ("value", "low", "high"):  # all clips have the same
        assert found[end] == pytest.approx(2 * ANGLE * LATENT_DIM, rel=1e-4)


def test_one_sample_of_five_that_differs_is_in_four_of_ten_pairs(score):
    assert score([0, 0, ANGLE, 0, 0], LAYOUTS[0])["value"] == pytest.approx(0.4 * ANGLE * LATENT_DIM, rel=1e-4)

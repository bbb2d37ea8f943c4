"""Hand shapes, style and chance levels with known answers."""

import numpy as np
import pytest

from ha2g_jax import anatomy
from ha2g_jax.metrics import causes, reconstruction

NAMES = list(anatomy.HAND_SHAPES)
SHAPES = np.array(list(anatomy.HAND_SHAPES.values()))


def shape_at(flexions: np.ndarray, time: float) -> str:
    """Return the name of the shape that hands (T, hands, 5) at 15 frames per second show at a time."""
    return NAMES[causes.hand_shape(causes.shown_flexions(flexions, time, 15), SHAPES)]


def test_a_shape_counts_only_at_its_moment():
    flexions = np.tile(SHAPES[NAMES.index("open")], (60, 1, 1))
    flexions[30:36] = SHAPES[NAMES.index("fist")]
    assert [shape_at(flexions, time) for time in (1.0, 2.1, 3.0)] == ["open", "fist", "open"]


def test_a_moment_past_the_end_sees_the_last_pose():
    flexions = np.tile(SHAPES[NAMES.index("open")], (15, 1, 1))
    flexions[-1] = SHAPES[NAMES.index("fist")]
    assert shape_at(flexions, 5.0) == "fist"


def test_fingers_that_go_a_part_of_the_way_are_seen():
    """Their nearest shape is that of a resting hand; their correlation is that of fingers that go all the way."""
    rest, true = np.full(5, 0.44), SHAPES[np.arange(40) % len(SHAPES)]
    for share in (0.1, 1.0):
        shown = rest + share * (true - rest)
        assert causes.finger_correlation(np.stack([shown, true], axis=1)) == pytest.approx(1)
    weak = rest + 0.1 * (true - rest)
    assert len({causes.hand_shape(each[None], SHAPES) for each in weak}) == 1
    random = np.random.default_rng(0).permutation(weak)
    assert abs(causes.finger_correlation(np.stack([random, true], axis=1))) < 0.3
    still = np.stack([np.broadcast_to(rest, true.shape), true], axis=1)
    assert np.isnan(causes.finger_correlation(still))


def test_expected_match_is_the_mean_over_shuffles():
    rng = np.random.default_rng(0)
    predicted, true = rng.integers(0, 3, 50), rng.integers(1, 5, 50)
    shuffled = np.mean([np.mean(rng.permutation(predicted) == true) for _ in range(4000)])
    assert causes.expected_match(predicted, true) == pytest.approx(shuffled, abs=0.01)


def test_movement_of_a_swinging_right_hand():
    wrists = np.zeros((31, 2, 3))
    wrists[:, 1, 0] = np.arange(31) * 0.02
    assert causes.movement(wrists, 15) == pytest.approx((0.3, 1.0))
    assert causes.movement(np.zeros((31, 2, 3)), 15) == (0, 0)


def test_correlation_is_pearsons():
    pairs = np.random.default_rng(0).normal(size=(20, 2))
    assert reconstruction.correlation(pairs) == pytest.approx(np.corrcoef(pairs[:, 0], pairs[:, 1])[0, 1])
    assert np.isnan(reconstruction.correlation(np.ones((5, 2))))

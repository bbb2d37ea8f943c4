"""States come and go without seams, within their time, and leave the motion of speech as it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.metrics.beats.strokes import wrist_positions
from ha2g_jax.motion.control import rest_pose
from ha2g_jax.motion.states import EASE, STATES, Ease, RunningStates
from ha2g_jax.skeleton import SKELETONS, load_skeleton

FPS, BOTH_ARMS = 15, np.ones(2)


def states_of(skeleton, changes: dict[int, str], weights: np.ndarray, arms=BOTH_ARMS) -> np.ndarray:
    """Frames of the rest pose with states that change at frames, and weights (T,) of speech."""
    states, pose, frames = RunningStates(skeleton, FPS, 0), rest_pose(skeleton), []
    for number, weight in enumerate(weights.tolist()):
        states.state = changes.get(number, states.state)
        frames.append(states.apply(pose, number, weight, 0.0, is_addressed=False, arms=arms))
    return np.stack(frames)


@pytest.mark.parametrize("name", SKELETONS)
@settings(max_examples=15, deadline=None)
@given(st.dictionaries(st.integers(0, 90), st.sampled_from(STATES)))
def test_transitions_at_any_moments_are_smooth(name, changes):
    wrists = wrist_positions(load_skeleton(name), states_of(load_skeleton(name), changes, np.zeros(100)))
    assert FPS * np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max() < 3
    assert FPS**2 * np.linalg.norm(np.diff(wrists, 2, axis=0), axis=-1).max() < 25


def test_speech_stays_as_it_is_and_ends_a_thought():
    skeleton = load_skeleton("ted_expressive")
    weights = np.concatenate([np.zeros(20), np.linspace(0, 1, 8), np.ones(10), np.linspace(1, 0, 8), np.zeros(20)])
    frames, idle = (states_of(skeleton, changes, weights) for changes in ({3: "think"}, {}))
    rest = np.broadcast_to(rest_pose(skeleton), frames.shape)
    np.testing.assert_array_equal(frames[27:38], rest[27:38])
    assert np.abs(frames[40:] - rest[40:]).max(axis=(1, 2)).min() > 0
    raised = np.abs(wrist_positions(skeleton, frames) - wrist_positions(skeleton, idle)).max(axis=(1, 2))
    assert raised[2] == 0 and raised[9:20].min() > 0.2 and raised[27:].max() == 0


def test_arms_that_rest_are_not_raised():
    skeleton = load_skeleton("ted_expressive")
    frames = states_of(skeleton, {0: "think"}, np.zeros(30), arms=np.zeros(2))
    wrists = wrist_positions(skeleton, frames)
    assert np.linalg.norm(wrists - wrist_positions(skeleton, rest_pose(skeleton)[None]), axis=-1).max() < 0.03


@given(st.lists(st.tuples(st.integers(1, 12), st.floats(-1, 1)), min_size=1, max_size=6))
def test_an_ease_arrives_in_its_time_and_does_not_jump(steps):
    ease, found = Ease(np.zeros(1), 6), [0.0]
    for frames, target in steps:
        found += [float(ease.step(np.array([target]))[0]) for _ in range(frames)]
        assert frames < 6 or found[-1] == target
    assert np.abs(found).max() < 1.5 and np.abs(np.diff(found, 2)).max(initial=0) < 0.5


def test_a_state_has_a_name():
    assert EASE == 0.4
    with pytest.raises(UserError, match=r"the state is 'sleep'; expected one of: auto, idle, listen, think"):
        RunningStates(load_skeleton("ted_expressive"), FPS, 0).state = "sleep"

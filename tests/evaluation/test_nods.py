"""Nods of a motion are found where they are, and those that are due follow from the words."""

import numpy as np
import pytest

from ha2g_jax.evaluation.nods import due_nods, nod_times
from ha2g_jax.features.text import Word
from ha2g_jax.motion.control import rest_pose
from ha2g_jax.motion.states import RunningStates, nod_depths
from ha2g_jax.skeleton import SKELETONS, load_skeleton


def test_a_nod_is_due_after_each_phrase_of_a_second():
    spans = [(0, 0.6), (0.7, 1.2), (1.6, 2.2), (2.6, 3.5), (3.75, 4.0)]
    words = [Word("word", *span) for span in spans]
    np.testing.assert_allclose(due_nods(words), [1.9, 4.7])
    assert len(due_nods([])) == 0


@pytest.mark.parametrize(("name", "fps"), [(SKELETONS[0], 15), (SKELETONS[1], 30)])
def test_nods_of_someone_who_listens_are_found_and_others_are_none(name, fps):
    skeleton, ends = load_skeleton(name), [2.0, 3.35, 7.1]
    frames = np.arange(25 * fps)
    depths = nod_depths(ends, frames, fps)
    states, pose = RunningStates(skeleton, fps, 0), rest_pose(skeleton)
    both = np.ones(2)
    motion = [
        states.apply(pose, k, 0.0, float(depths[k]), is_addressed=k < 10 * fps, arms=both) for k in frames.tolist()
    ]
    np.testing.assert_allclose(nod_times(skeleton, np.stack(motion), fps), np.array(ends) + 0.7, atol=1 / fps)

"""Speakers of a Talk corpus are drawn each from a seed of its own."""

import numpy as np
import pytest

from ha2g_jax.data.talk.speakers import SYNTHESISERS, draw_speakers


@pytest.mark.parametrize("synthesiser", SYNTHESISERS)
def test_unseen_styles_lie_between_seen_ones(synthesiser):
    cast = draw_speakers(20, 4, 5, synthesiser)
    seen = np.array([speaker.style for speaker in cast[:20]])
    for speaker in cast[20:]:
        style = np.array(speaker.style)
        gaps = np.linalg.norm(seen - style, axis=1)
        first, second = np.meshgrid(gaps, gaps)
        between = first + second - np.linalg.norm(seen[:, None] - seen[None], axis=-1)
        np.fill_diagonal(between, np.inf)
        assert between.min() < 1e-9
        assert gaps.min() > 0.1

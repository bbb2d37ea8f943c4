"""Speakers of a Talk corpus are drawn each from a seed of its own, and their portraits show the style."""

import numpy as np
import pytest

from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import speakers
from ha2g_jax.data.talk.flite import FLITE_VOICES, HELD_OUT_VOICES, FliteVoice
from ha2g_jax.data.talk.grammar import OTHER_LANGUAGES
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


def test_languages_and_voices_that_training_does_not_hear():
    cast = draw_speakers(40, 8, 0, "both")
    people = {speaker.name: speaker.voice.name for speaker in cast if isinstance(speaker.voice, FliteVoice)}
    foreign = {speaker.name for speaker in cast if speaker.language != "en"}
    unseen = {speaker.name for speaker in cast[40:]}
    assert len(people) == 16 and len(foreign) == 10 and not foreign & (unseen | people.keys())
    assert {people[name] for name in people.keys() & unseen} == {*HELD_OUT_VOICES}
    assert {people[name] for name in people.keys() - unseen} == {*FLITE_VOICES}
    assert not {"de", "fr", "cmn"} & {*OTHER_LANGUAGES}


POSE = skeletons.load_skeleton("ted_expressive").mean_pose


def test_portrait_is_a_picture_of_a_fixed_look():
    image = speakers.portrait(POSE, speakers.Style())
    assert image.shape == (224, 224, 3)
    assert image.dtype == np.uint8
    assert (image == speakers.portrait(POSE, speakers.Style())).all()


@pytest.mark.parametrize("field", speakers.Style._fields)
def test_every_number_of_the_style_is_visible_at_64_pixels(field):
    low, high = (speakers.portrait(POSE, speakers.Style(**{field: value}), 64).astype(int) for value in (-1.0, 1.0))
    assert np.abs(high - low).mean() > 1.5

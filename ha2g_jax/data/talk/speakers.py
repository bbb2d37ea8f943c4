"""Speakers of a Talk corpus: voices of a speech synthesiser, and styles of gesture."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.data.talk import flite
from ha2g_jax.data.talk.style import Style, sample_style
from ha2g_jax.features import espeak as speech

DEFAULT_SPEAKERS, DEFAULT_SEED, DEFAULT_SYNTHESISER = 48, 0, "espeak-ng"

_UNSEEN = 1 / 6  # of the speakers
_SEEDS = 0  # first number of spawn keys, so that no speaker has the seed of a recording


class Synthesiser(NamedTuple):
    """A speech synthesiser.

    Attributes:
        sample_voice: function that draws a voice from a generator of random draws.
        say: function of (sentence in the markup of `grammar`, voice) that speaks the sentence.
        licence: licence of a corpus with this speech.
    """

    sample_voice: Callable[[np.random.Generator], Any]
    say: Callable[[str, Any], speech.Utterance]
    licence: str


SYNTHESISERS = {
    "espeak-ng": Synthesiser(
        speech.sample_voice, speech.say, "Synthetic speech and motion; free of third-party rights"
    ),
    "flite": Synthesiser(
        flite.sample_flite_voice,
        flite.say,
        "Synthetic motion, and speech of voices of Carnegie Mellon University, free to use",
    ),
}


class Speaker(NamedTuple):
    """A synthetic speaker.

    Attributes:
        name: name of the speaker in the corpus.
        voice: voice that speaks the sentences.
        style: style of the gestures.
    """

    name: str
    voice: speech.Voice | flite.FliteVoice
    style: Style


def default_styles() -> dict[str, Style]:
    """Return the style of each speaker of the default Talk corpus by name, those of training first."""
    unseen = num_unseen(DEFAULT_SPEAKERS)
    speakers = draw_speakers(DEFAULT_SPEAKERS - unseen, unseen, DEFAULT_SEED, DEFAULT_SYNTHESISER)
    return {speaker.name: speaker.style for speaker in speakers}


def num_unseen(num_speakers: int) -> int:
    """Return how many of the speakers are in the split of unseen ones alone."""
    return max(1, round(num_speakers * _UNSEEN))


def draw_speakers(seen: int, unseen: int, seed: int, synthesiser: str) -> list[Speaker]:
    """Draw the speakers of training, then the unseen ones, each from a seed of its own.

    Args:
        seen: number of speakers of training.
        unseen: number of unseen speakers, whose styles lie between two styles of training.
        seed: seed of the corpus.
        synthesiser: one of `SYNTHESISERS`.
    """
    speakers: list[Speaker] = []
    for number in range(seen + unseen):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SEEDS, number)))
        voice, style = SYNTHESISERS[synthesiser].sample_voice(rng), sample_style(rng)
        if number >= seen:
            first, second = (np.array(speakers[index].style) for index in rng.choice(seen, 2, replace=seen < 2))
            style = Style(*(first + rng.uniform(0.3, 0.7) * (second - first)).tolist())
        speakers.append(Speaker(f"speaker-{number:02d}", voice, style))
    return speakers

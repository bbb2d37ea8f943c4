"""Speakers of a Talk corpus: gesture styles, appearances that show the style, and voices of a speech synthesiser."""

import itertools
from typing import NamedTuple

import numpy as np

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import flite, grammar
from ha2g_jax.features import espeak as speech

_SKELETON = "ted_expressive"

# The two ends of each scale that a number of the style moves along.
_SHIRTS = ((40, 92, 170), (196, 62, 52))  # amplitude: calm blue to lively red
_HAIR = ((46, 34, 32), (214, 176, 96))  # mixing: dark to fair
_SKINS = ((122, 82, 60), (246, 214, 188))  # curl: dark to light
_BACKGROUNDS = ((206, 228, 212), (238, 214, 206))  # latency: green to rose
_BUILDS = (0.86, 1.16)  # elbow: slim to broad
_HAIR_LENGTHS = (0.0, 1.0)  # handedness: short for the left hand to long for the right

DEFAULT_SPEAKERS, DEFAULT_SEED, DEFAULT_SYNTHESISER = 48, 0, "espeak-ng"

_UNSEEN = 1 / 6  # fraction of the speakers
_OTHER_LANGUAGE = (1, 4, 7)  # indices among twelve training speakers; none of them has a voice of Flite
_SEEDS = 0  # first number of spawn keys, so that no speaker has the seed of a recording


class Style(NamedTuple):
    """Six numbers in [-1, 1] that change how a speaker moves, but not when or why; 0 is the population average.

    Attributes:
        mixing: weight of the three causes; high is more beats, low is larger word gestures and head movement.
        amplitude: size of all movement.
        handedness: which hand does more, -1 left, 1 right.
        latency: delay of the gestures after the speech.
        elbow: elbow swivel and rest pose, -1 close to the body and low, 1 wide and high.
        curl: finger curl at rest.
    """

    mixing: float = 0.0
    amplitude: float = 0.0
    handedness: float = 0.0
    latency: float = 0.0
    elbow: float = 0.0
    curl: float = 0.0

    @property
    def dominant(self) -> int:
        """Index of the hand that does more, 0 left or 1 right."""
        return int(self.handedness >= 0)


def sample_style(rng: np.random.Generator) -> Style:
    """Draw a style: uniform in [-1, 1], but two of three speakers are right-handed and none is ambidextrous."""
    style = Style(*(float(value) for value in rng.uniform(-1, 1, len(Style._fields))))
    side = 1.0 if rng.random() < 2 / 3 else -1.0
    return style._replace(handedness=side * (0.3 + 0.7 * abs(style.handedness)))


def look_of(style: Style) -> figure.Look:
    """Return the look of a speaker; each number of the style changes one large feature of the image."""
    return figure.Look(
        skin=_colour(_SKINS, style.curl),
        hair=_colour(_HAIR, style.mixing),
        shirt=_colour(_SHIRTS, style.amplitude),
        background=_colour(_BACKGROUNDS, style.latency),
        build=_between(_BUILDS, style.elbow),
        hair_length=_between(_HAIR_LENGTHS, style.handedness),
    )


def portrait(positions: np.ndarray, style: Style, size: int = 224) -> np.ndarray:
    """Draw a speaker in a pose (43, 3) in metres, as an image (size, size, 3) uint8."""
    return figure.draw_figure(positions, skeletons.load_skeleton(_SKELETON), look_of(style), size, size)


def _between(ends: tuple[float, float], value: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * (value + 1) / 2


def _colour(ends: tuple[figure.Colour, figure.Colour], value: float) -> figure.Colour:
    red, green, blue = (round(_between(pair, value)) for pair in zip(*ends, strict=True))
    return red, green, blue


# Synthesisers of speech, and the licence of a corpus that they speak.
SYNTHESISERS = {
    "espeak-ng": "Synthetic speech and motion; free of third-party rights",
    "flite": "Synthetic motion, and speech of voices of Carnegie Mellon University, free to use",
    "both": "Synthetic speech and motion, partly of voices of Carnegie Mellon University, free to use",
}
Voice = speech.Voice | flite.FliteVoice


class Speaker(NamedTuple):
    """A synthetic speaker: its name in the corpus, its voice, the style of its gestures, and its language."""

    name: str
    voice: Voice
    style: Style
    language: str


def say(markup: str, voice: Voice) -> speech.Utterance:
    """Speak one text in the markup of `grammar` with the synthesiser of the voice.

    Raises:
        UserError: the synthesiser is not installed.
    """
    return flite.say(markup, voice) if isinstance(voice, flite.FliteVoice) else speech.say(markup, voice)


def sample_voice(rng: np.random.Generator, language: str) -> speech.Voice:
    """Draw a random voice of espeak-ng that speaks a language of `grammar`."""
    voice = speech.sample_voice(rng)
    return voice if language == grammar.ENGLISH else voice._replace(language=language)


def default_styles() -> dict[str, Style]:
    """Return the style of each speaker of the default Talk corpus by name, those of training first."""
    unseen = num_unseen(DEFAULT_SPEAKERS)
    speakers = draw_speakers(DEFAULT_SPEAKERS - unseen, unseen, DEFAULT_SEED, DEFAULT_SYNTHESISER)
    return {speaker.name: speaker.style for speaker in speakers}


def num_unseen(num_speakers: int) -> int:
    """Return how many of the speakers are only in the split of unseen ones."""
    return max(1, round(num_speakers * _UNSEEN))


def draw_speakers(seen: int, unseen: int, seed: int, synthesiser: str) -> list[Speaker]:
    """Draw the speakers of training, then the unseen ones, whose styles lie between two styles of training.

    Each has its own seed. With "both" synthesisers, Flite speaks for a third of the speakers. A quarter of the training
    speakers have a voice of espeak-ng and speak a language other than English.
    """
    speakers: list[Speaker] = []
    languages = itertools.cycle(grammar.OTHER_LANGUAGES)
    for number in range(seen + unseen):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SEEDS, number)))
        is_flite = synthesiser == "flite" or (synthesiser == "both" and number % 3 == 2)
        is_other = not is_flite and number < seen and number % 12 in _OTHER_LANGUAGE
        language = next(languages) if is_other else grammar.ENGLISH
        names = flite.FLITE_VOICES if number < seen else flite.HELD_OUT_VOICES
        name = names[number // 3 % len(names)]
        voice = flite.sample_flite_voice(rng, name) if is_flite else sample_voice(rng, language)
        style = sample_style(rng)
        if number >= seen:
            first, second = (np.array(speakers[index].style) for index in rng.choice(seen, 2, replace=seen < 2))
            style = Style(*(first + rng.uniform(0.3, 0.7) * (second - first)).tolist())
        speakers.append(Speaker(f"speaker-{number:02d}", voice, style, language))
    return speakers

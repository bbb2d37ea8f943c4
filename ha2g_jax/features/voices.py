"""Voices of the speakers of the Talk corpus."""

from typing import NamedTuple

import numpy as np

LANGUAGES = ("en-us", "en-us", "en-us", "en-us-nyc", "en", "en-029", "en-gb-x-rp", "en-gb-x-gbclan", "en-gb-scotland")
MALE_VARIANTS = (
    *("m1", "m2", "m3", "m4", "m5", "m6", "m7", "m8", "adam", "david", "edward", "robert", "paul", "Gene"),
    *("Alex", "Andy", "Lee", "Michael", "benjamin", "john", "max", "miguel", "quincy", "victor", "klatt", "klatt4"),
)
FEMALE_VARIANTS = (
    *("f1", "f2", "f3", "f4", "f5", "steph", "linda", "belinda", "Annie", "anika"),
    *("Alicia", "Andrea", "aunty", "grandma", "shelby", "steph2"),
)


class Voice(NamedTuple):
    """A speaker's voice in the terms of espeak-ng.

    Attributes:
        language: accent, espeak-ng's name of a variety of English, such as "en-us".
        variant: timbre, one of espeak-ng's voice variants.
        pitch: base pitch, 0 to 100; 50 is the default of the variant.
        pitch_range: liveliness of the intonation, 0 (monotone) to 100.
        rate: words per minute, not counting pauses.
    """

    language: str
    variant: str
    pitch: int
    pitch_range: int
    rate: int


def sample_voice(rng: np.random.Generator) -> Voice:
    """Draw a random voice; female and male voices are equally likely.

    Args:
        rng: generator of the random draws.
    """
    is_male = rng.random() < 0.5
    return Voice(
        language=str(rng.choice(LANGUAGES)),
        variant=str(rng.choice(MALE_VARIANTS if is_male else FEMALE_VARIANTS)),
        # The female variants are tuned high already.
        pitch=int(rng.integers(15, 81) if is_male else rng.integers(10, 56)),
        pitch_range=int(rng.integers(40, 100)),
        rate=int(rng.integers(135, 211)),
    )


FLITE_VOICES = ("awb", "rms", "slt")  # a Scottish man, a man and a woman of the United States


class FliteVoice(NamedTuple):
    """A speaker's voice in the terms of Flite.

    Attributes:
        name: one of `FLITE_VOICES`, whose sounds come from recordings of a person.
        pitch: ratio of the pitch to that of the person; that of "rms" follows the formants alone.
        rate: ratio of the rate of speech to that of the person.
        formants: ratio of the formants to those of the person; a shorter vocal tract has higher ones.
    """

    name: str
    pitch: float
    rate: float
    formants: float


def sample_flite_voice(rng: np.random.Generator) -> FliteVoice:
    """Draw a random voice of Flite.

    Args:
        rng: generator of the random draws.
    """
    formants = rng.uniform(0.86, 1.16)
    return FliteVoice(
        name=str(rng.choice(FLITE_VOICES)),
        pitch=float(formants * rng.uniform(0.85, 1.2)),  # people with a shorter vocal tract have a higher pitch
        rate=float(rng.uniform(0.8, 1.2)),
        formants=float(formants),
    )

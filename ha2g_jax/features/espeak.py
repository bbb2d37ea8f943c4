"""Speech with known word times: espeak-ng from the `espeakng-loader` wheel, called in this process through ctypes."""

import _ctypes
import contextlib
import ctypes
import pathlib
import re
import sys
from collections.abc import Iterator
from typing import NamedTuple

import espeakng_loader
import numpy as np
import soxr

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word

# Names as in espeak-ng/speak_lib.h.
_AUDIO_OUTPUT_SYNCHRONOUS = 2
_INITIALIZE_PHONEME_EVENTS_DONT_EXIT = 0x0001 | 0x8000
_CHARS_UTF8_SSML = 1 | 0x10
_POS_CHARACTER = 1
_RATE, _VOLUME, _PITCH, _RANGE = 1, 2, 3, 4
# In percent; leaves headroom for emphasis, since espeak-ng clips.
_BASE_VOLUME = 30
_EVENT_LIST_TERMINATED, _EVENT_WORD, _EVENT_PHONEME = 0, 1, 7
_GLOTTAL_STOPS = (b"_!", b"_|")  # within words; the other phonemes that begin with _ are pauses

LANGUAGES = ("en-us", "en-us", "en-us", "en-us-nyc", "en", "en-029", "en-gb-x-rp", "en-gb-x-gbclan", "en-gb-scotland")
MALE_VARIANTS = (
    *("m1", "m2", "m3", "m4", "m5", "m6", "m7", "m8", "adam", "david", "edward", "robert", "paul", "Gene"),
    *("Alex", "Andy", "Lee", "Michael", "benjamin", "john", "max", "miguel", "quincy", "victor", "klatt", "klatt4"),
    *("Denis", "Diogo", "Gene2", "Henrique", "Jacky", "Mario", "Nguyen", "Reed", "boris", "ed", "edward2", "grandpa"),
    *("gustave", "iven3", "kaukovalta", "klatt3", "klatt5", "klatt6", "marcelo", "michel", "mike2", "norbert"),
    *("pablo", "pedro", "rob", "sandro", "travis"),
)
FEMALE_VARIANTS = (
    *("f1", "f2", "f3", "f4", "f5", "steph", "linda", "belinda", "Annie", "anika"),
    *("Alicia", "Andrea", "aunty", "grandma", "shelby", "steph2", "steph3"),
)

_LETTER = r"(?:[^\W_]|[\u0900-\u0963])"  # \w has no vowel signs of Devanagari
_TOKEN = re.compile(rf"<[^>]*>|(?P<word>{_LETTER}+(?:['’-]{_LETTER}+)*)")


class Voice(NamedTuple):
    """The parameters of a voice of espeak-ng.

    Attributes:
        language: espeak-ng's name of a language or of a variety of English, such as "en-us".
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
    """Draw a random voice that speaks English; female and male voices are equally likely."""
    is_male = rng.random() < 0.5
    return Voice(
        language=str(rng.choice(LANGUAGES)),
        variant=str(rng.choice(MALE_VARIANTS if is_male else FEMALE_VARIANTS)),
        # The female variants have a high pitch already.
        pitch=int(rng.integers(10, 91) if is_male else rng.integers(5, 66)),
        pitch_range=int(rng.integers(20, 100)),
        rate=int(rng.integers(105, 261)),
    )


class Utterance(NamedTuple):
    """Speech (samples,) float32 in [-1, 1] at 16 kHz, and its words in order, in lower case, with times in seconds."""

    audio: np.ndarray
    words: tuple[Word, ...]


class _Event(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("name", ctypes.c_char * 8),
    ]


_Callback = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event))


def say(markup: str, voice: Voice) -> Utterance:
    """Speak one text; the same text and voice give the same bytes in any process and any order.

    Not thread-safe: espeak-ng keeps its state in global variables. The text is plain words, or SSML
    (`<emphasis level="strong">`, `<prosody rate="90%">`, `<break time="200ms"/>`).

    Raises:
        UserError: espeak-ng cannot be loaded.
    """
    ssml = f"<speak>{markup}</speak>"
    chunks: list[np.ndarray] = []
    onsets: list[tuple[int, int]] = []  # (character of the SSML, sample)
    pauses: list[int] = []

    @_Callback
    def collect(samples, count, events):  # type: ignore[no-untyped-def]
        if samples and count > 0:
            chunks.append(np.ctypeslib.as_array(samples, (count,)).copy())
        index = 0
        while events[index].type != _EVENT_LIST_TERMINATED:
            event = events[index]
            if event.type == _EVENT_WORD:
                onsets.append((event.text_position - 1, event.sample))
            elif event.type != _EVENT_PHONEME or (event.name.startswith(b"_") and event.name not in _GLOTTAL_STOPS):
                pauses.append(event.sample)
            index += 1
        return 0

    with fresh_library() as (library, native_rate):
        if library.espeak_SetVoiceByName(f"{voice.language}+{voice.variant}".encode()):
            raise ValueError(f"espeak-ng has no voice {voice.language}+{voice.variant}")
        settings = {_RATE: voice.rate, _VOLUME: _BASE_VOLUME, _PITCH: voice.pitch, _RANGE: voice.pitch_range}
        for parameter, value in settings.items():
            library.espeak_SetParameter(parameter, value, 0)
        library.espeak_SetSynthCallback(collect)
        text = ssml.encode()
        arguments = (ctypes.c_size_t(len(text) + 1), ctypes.c_uint(0), _POS_CHARACTER, ctypes.c_uint(0))
        if library.espeak_Synth(ctypes.c_char_p(text), *arguments, ctypes.c_uint(_CHARS_UTF8_SSML), None, None):
            raise RuntimeError("espeak-ng refused the text")

    samples = np.concatenate([np.zeros(0, np.int16), *chunks])
    words = _place_words(ssml, onsets, sorted({*pauses, len(samples)}), native_rate)
    return Utterance(soxr.resample(samples.astype(np.float32) / 2**15, native_rate, SAMPLE_RATE), words)


@contextlib.contextmanager
def fresh_library() -> Iterator[tuple[ctypes.CDLL, int]]:
    """Load espeak-ng anew, and unload it at the end; yields the library and its sample rate in hertz.

    espeak-ng keeps the phase of the voice, its flutter and its echo in static variables from one utterance to the
    next. Only unloading the library resets them (4 ms) and makes the samples independent of earlier utterances.

    Raises:
        UserError: the library or its voices cannot be loaded.
    """
    try:
        library = ctypes.CDLL(espeakng_loader.get_library_path())
    except OSError as error:
        raise UserError(f"espeak-ng cannot be loaded ({error}); reinstall it: pip install espeakng-loader") from error
    try:
        folder = pathlib.Path(espeakng_loader.get_data_path())
        rate = library.espeak_Initialize(
            _AUDIO_OUTPUT_SYNCHRONOUS, 0, str(folder).encode(), _INITIALIZE_PHONEME_EVENTS_DONT_EXIT
        )
        if rate <= 0:
            raise UserError(
                f"espeak-ng cannot read its voices in {folder} (a path of at most 150 characters works); "
                "reinstall it, in a folder with a shorter name: pip install espeakng-loader"
            )
        library.espeak_ng_SetRandSeed(ctypes.c_long(0))  # otherwise breath noise depends on the time of day
        yield library, rate
        library.espeak_Terminate()
    finally:
        close = _ctypes.FreeLibrary if sys.platform == "win32" else _ctypes.dlclose
        close(library._handle)


def _place_words(ssml: str, onsets: list[tuple[int, int]], pauses: list[int], rate: int) -> tuple[Word, ...]:
    """Return words with their times; the span of an entry of several words ("of the") is divided by their letters."""
    sample_at = dict(reversed(onsets))
    groups: list[tuple[int, list[str]]] = []
    for match in _TOKEN.finditer(ssml):
        if match["word"] is None:
            continue
        if match.start("word") in sample_at:
            groups.append((sample_at[match.start("word")], []))
        elif not groups:
            groups.append((onsets[0][1] if onsets else 0, []))
        groups[-1][1].append(match["word"].lower())

    boundaries = sorted({*pauses, *(start for start, _ in groups)})
    words = []
    for start, texts in groups:
        end = next((boundary for boundary in boundaries if boundary > start), start)
        edges = start + (end - start) * np.cumsum([0, *map(len, texts)]) / sum(map(len, texts))
        words += [Word(text, a / rate, b / rate) for text, a, b in zip(texts, edges[:-1].tolist(), edges[1:].tolist())]
    return tuple(words)

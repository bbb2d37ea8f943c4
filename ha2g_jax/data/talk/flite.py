"""Speech with known word times by Flite, whose voices were made from recordings of people, called through ctypes.

Flite is a library of the system: `apt install libflite1` on Debian and Ubuntu. Its licence and that of the voices are
permissive.
"""

import ctypes
import functools
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import soxr

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.espeak import Utterance
from ha2g_jax.features.text import Word

# A Scottish man and a woman of the United States; and a man of the United States, who only unseen speakers have.
FLITE_VOICES, HELD_OUT_VOICES = ("awb", "slt"), ("rms",)
_LEVEL = 0.3  # level of a word that is not emphasised, so that emphasis does not clip
_RAMP = 0.02  # seconds over which the loudness changes from word to word
_WORD = re.compile(r"([^\W_]+(?:['’-][^\W_]+)*)([.,]?)")
_START, _END = (
    b"R:SylStructure.daughter1.daughter1.R:Segment.p.end",
    b"R:SylStructure.daughtern.daughtern.R:Segment.end",
)


class FliteVoice(NamedTuple):
    """The parameters of a voice of Flite: a name such as "slt", whose sounds come from recordings of a person.

    Pitch, rate of speech and formants are ratios to those of the person; the pitch of "rms" follows only the formants.
    """

    name: str
    pitch: float
    rate: float
    formants: float


def sample_flite_voice(rng: np.random.Generator, name: str) -> FliteVoice:
    """Draw a random voice made from the recordings of one of the people."""
    formants = rng.uniform(0.86, 1.16)
    return FliteVoice(
        name=name,
        pitch=float(formants * rng.uniform(0.85, 1.2)),  # people with a shorter vocal tract have a higher pitch
        rate=float(rng.uniform(0.7, 1.45)),
        formants=float(formants),
    )


class _Wave(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_char_p),
        ("sample_rate", ctypes.c_int),
        ("num_samples", ctypes.c_int),
        ("num_channels", ctypes.c_int),
        ("samples", ctypes.POINTER(ctypes.c_short)),
    ]


class _Token(NamedTuple):
    """A word of the markup with its emphasis: ratios to the word without markup."""

    text: str
    mark: str
    volume: float
    pitch: float


class _Chunk(NamedTuple):
    """Words between two breaks, which Flite speaks as one utterance, and the seconds of silence before them."""

    tokens: list[_Token]
    pitch: float
    rate: float
    silence: float


def say(markup: str, voice: FliteVoice) -> Utterance:
    """Speak one text; the same text and voice give the same bytes in any process and any order on one system.

    The text has the SSML of `grammar`: `<prosody volume= pitch= rate=>` with changes in percent, and
    `<break time="200ms"/>`. An emphasised word is louder and, because Flite cannot set the pitch of single words,
    longer instead of higher. The voice "rms" ignores the pitch of phrases, too.

    Raises:
        UserError: Flite or the voice is not installed.
    """
    pieces, words, time = [np.zeros(0, np.float32)], [], 0.0
    for chunk in _chunks(markup):
        pieces.append(np.zeros(round(chunk.silence * SAMPLE_RATE), np.float32))
        time += len(pieces[-1]) / SAMPLE_RATE
        audio, spans = _speak(chunk, voice)
        words += [
            Word(token.text.lower(), time + start, time + end)
            for token, (start, end) in zip(chunk.tokens, spans.tolist(), strict=True)
        ]
        pieces.append(audio)
        time += len(audio) / SAMPLE_RATE
    return Utterance(np.concatenate(pieces), tuple(words))


def _chunks(markup: str) -> list[_Chunk]:
    chunks: list[_Chunk] = []
    silence = 0.0

    def read(element: ElementTree.Element, outer: tuple[float, float, float]) -> None:
        nonlocal silence
        volume, pitch, rate = (_ratio(element.get(name)) for name in ("volume", "pitch", "rate"))
        inner = outer[0] * volume, outer[1] * pitch, outer[2] * rate
        phrase = inner if "rate" in element.attrib else outer  # the other elements are emphasised words

        def add(text: str | None, ratios: Sequence[float]) -> None:
            nonlocal silence
            for word, mark in _WORD.findall(text or ""):
                if silence or not chunks or chunks[-1][1:3] != phrase[1:]:
                    chunks.append(_Chunk([], phrase[1], phrase[2], silence))
                    silence = 0.0
                chunks[-1].tokens.append(_Token(word, mark, ratios[0], ratios[1] / phrase[1]))

        add(element.text, inner)
        for child in element:
            if child.tag == "break":
                silence += float(child.attrib["time"].removesuffix("ms")) / 1000
            else:
                read(child, phrase)
            add(child.tail, phrase)

    read(ElementTree.fromstring(f"<speak>{markup}</speak>"), (1.0, 1.0, 1.0))
    return chunks


def _ratio(change: str | None) -> float:
    """Return the ratio that "+20%", "-20%" or, of rates, "120%" stands for."""
    if change is None:
        return 1.0
    percent = float(change.removesuffix("%"))
    return (100 + percent if change[0] in "+-" else percent) / 100


def _speak(chunk: _Chunk, voice: FliteVoice) -> tuple[np.ndarray, np.ndarray]:
    """Speak a chunk: (samples,) float32 from the first to the last word, and (words, 2) start and end in seconds."""
    library, libc = _library(), ctypes.CDLL(None)
    libc.srand(0)  # the noise of the voices uses the random numbers of C
    utterance = library.new_utterance()
    try:
        relation = library.utt_relation_create(utterance, b"Token")
        for index, token in enumerate(chunk.tokens):
            item = library.relation_append(relation, None)
            texts = {b"name": token.text, b"punc": token.mark, b"whitespace": " ", b"prepunctuation": ""}
            for name, text in texts.items():
                library.item_set_string(item, name, text.encode())
            library.item_set_int(item, b"index", index)
            library.item_set_float(item, b"local_duration_stretch", max(token.pitch, 1.0))
        library.utt_init(utterance, _voice(voice.name))
        features = ctypes.cast(utterance, ctypes.POINTER(ctypes.c_void_p))[0]  # first field of cst_utterance
        # Below, the samples are interpreted at another rate, which scales formants, pitch and rate of speech.
        library.feat_set_float(features, b"duration_stretch", voice.formants / (voice.rate * chunk.rate))
        library.feat_set_float(features, b"f0_shift", voice.pitch * chunk.pitch / voice.formants)
        if not library.utt_synth_tokens(utterance):
            raise RuntimeError("Flite refused the text")
        wave = library.utt_wave(utterance).contents
        samples = np.ctypeslib.as_array(wave.samples, (wave.num_samples,)).astype(np.float32) / 2**15
        spans = _spans(library, utterance, len(chunk.tokens))
        samples = samples * _loudness(chunk.tokens, spans, wave.sample_rate, len(samples))
        samples = samples[round(spans[0, 0] * wave.sample_rate) : round(spans[-1, 1] * wave.sample_rate)]
        audio = soxr.resample(samples, wave.sample_rate * voice.formants, SAMPLE_RATE)
        return audio, (spans - spans[0, 0]) / voice.formants
    finally:
        library.delete_utterance(utterance)


def _spans(library: Any, utterance: int, count: int) -> np.ndarray:
    """Return start and end of each token in seconds; a token such as "it's" has several words."""
    spans = np.stack([np.full(count, np.inf), np.zeros(count)], axis=-1)
    for item in _items(library, utterance, b"Word"):
        token = library.item_feat_int(library.item_parent(library.item_as(item, b"Token")), b"index")
        start, end = (library.ffeature_float(item, path) for path in (_START, _END))
        spans[token] = min(spans[token, 0], start), max(spans[token, 1], end)
    return spans


def _items(library: Any, utterance: int, relation: bytes) -> Iterator[int]:
    item = library.relation_head(library.utt_relation(utterance, relation))
    while item:
        yield item
        item = library.item_next(item)


def _loudness(tokens: Sequence[_Token], spans: np.ndarray, rate: int, count: int) -> np.ndarray:
    """Return the factor of each sample, which changes linearly around the borders of words."""
    volumes = np.repeat([token.volume for token in tokens], 2)
    ramp = np.minimum(_RAMP / 2, (spans[:, 1] - spans[:, 0]) / 4)[:, None]
    times = (spans + ramp * [1, -1]).ravel()
    return (_LEVEL * np.interp(np.arange(count) / rate, times, volumes)).astype(np.float32)


@functools.cache
def _library() -> Any:
    """Load Flite and declare its functions, those of flite.h, cst_utterance.h and cst_item.h."""
    library = _load("libflite.so.1")
    pointer, text, number = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_float
    functions: dict[str, tuple[Any, ...]] = {
        "new_utterance": (pointer,),
        "delete_utterance": (None, pointer),
        "utt_init": (pointer, pointer, pointer),
        "utt_synth_tokens": (pointer, pointer),
        "utt_wave": (ctypes.POINTER(_Wave), pointer),
        "utt_relation": (pointer, pointer, text),
        "utt_relation_create": (pointer, pointer, text),
        "relation_append": (pointer, pointer, pointer),
        "relation_head": (pointer, pointer),
        "item_next": (pointer, pointer),
        "item_as": (pointer, pointer, text),
        "item_parent": (pointer, pointer),
        "item_set_string": (None, pointer, text, text),
        "item_set_int": (None, pointer, text, ctypes.c_int),
        "item_set_float": (None, pointer, text, number),
        "item_feat_int": (ctypes.c_int, pointer, text),
        "ffeature_float": (number, pointer, text),
        "feat_set_float": (None, pointer, text, number),
    }
    for name, (result, *arguments) in functions.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    library.flite_init()
    return library


@functools.cache
def _voice(name: str) -> int:
    register = getattr(_load(f"libflite_cmu_us_{name}.so.1"), f"register_cmu_us_{name}")
    register.restype, register.argtypes = ctypes.c_void_p, (ctypes.c_char_p,)
    return register(None)


def _load(name: str) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise UserError(
            f"Flite is not installed ({error}); install it, on Debian and Ubuntu by `apt install libflite1`, or leave "
            "out --synthesiser"
        ) from error

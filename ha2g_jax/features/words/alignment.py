"""Words of a recording from a plain text, aligned by pocketsphinx, or from the sound alone, recognised by Whisper.

A text is aligned in pieces of at most 30 s.

1. The audio is cut at quiet moments and recognised with a language model made only from the text (after Moreno et al.,
   "A recursive algorithm for the forced alignment of very long audio segments", 1998). Runs of three words or more
   that recognition and text have in common are anchors.
2. Words between anchors get provisional times: the gap is divided by letters, on a clock that stops in silence. Words
   that do not fit in the gap were not spoken, and are left out.
3. Pieces of at most 30 s, cut at the longest pauses between neighbouring anchors, are aligned by forced alignment.
"""

import ctypes
import difflib
import itertools
import logging
import pathlib
import tempfile
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import threadpoolctl

from ha2g_jax.errors import UserError, require
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.espeak import fresh_library
from ha2g_jax.features.text import Word
from ha2g_jax.features.words.timing import Stretch, fill_gaps, split_words, spread, without_overlap
from ha2g_jax.limits import MAX_WORDS

if TYPE_CHECKING:
    from faster_whisper import WhisperModel
    from pocketsphinx import Decoder

MAX_PIECE_SECONDS = 30.0
_MIN_ANCHOR = 3
_MAX_LETTERS = 100  # in a word, far more than the longest of English
# Time of the neighbours that may belong to a word that was not recognised.
_SLACK_SECONDS = 0.3
# Minimum fraction of recognised words; below it the text is probably not that of the recording.
_MIN_RECOGNISED = 0.3
_logger = logging.getLogger(__name__)

FRAME_SECONDS = 0.01
_FRAME = round(FRAME_SECONDS * SAMPLE_RATE)
# Speech lies within this many decibels of the loudest hundredth.
_SPEECH_DB = 35.0
# The clock moves slowly in silence, so that it is invertible.
_SILENCE_SPEED = 0.02

_VOICE = b"en-us"
_CHARS_UTF8 = 1
_SEPARATOR = "_"
# Phonemes of espeak-ng's American English, without marks of stress, in the phones of the CMU dictionary.
_PHONES = {
    **{"p": "P", "b": "B", "t": "T", "t#": "T", "t2": "T", "?": "T", "d": "D", "k": "K", "g": "G", "x": "K"},
    **{"f": "F", "v": "V", "T": "TH", "D": "DH", "s": "S", "z": "Z", "S": "SH", "Z": "ZH", "h": "HH"},
    **{"tS": "CH", "dZ": "JH", "m": "M", "n": "N", "n-": "AH N", "N": "NG", "l": "L", "r": "R", "r-": "R"},
    **{"w": "W", "j": "Y", ";": "Y", "@": "AH", "@-": "AH", "a#": "AH", "V": "AH", "@L": "AH L", "3": "ER", "3:": "ER"},
    **{"I": "IH", "I#": "IH", "I2": "IH", "i": "IY", "i:": "IY", "i@": "IY AH", "i@3": "IH R", "E": "EH", "e@": "EH R"},
    **{"a": "AE", "aa": "AE", "A:": "AA", "0": "AA", "A@": "AA R", "O:": "AO", "O2": "AO", "O@": "AO R", "o@": "AO R"},
    **{"U": "UH", "U@": "UH R", "u:": "UW", "eI": "EY", "aI": "AY", "aI@": "AY AH", "aI3": "AY ER", "OI": "OY"},
    **{"oU": "OW", "aU": "AW"},
}
_STRESS = "',%=|"


class _Placed(NamedTuple):
    """A word with its provisional time, and whether it was recognised there."""

    word: Word
    is_anchor: bool


def align(audio: np.ndarray, text: str) -> tuple[Word, ...]:
    """Find the times at which the words of an English text are spoken in a recording (samples,) float32 at 16 kHz.

    Numbers may be written in digits. The words of a piece that pocketsphinx cannot align keep their provisional times,
    with a warning in the log; words that do not fit anywhere are left out.

    Raises:
        UserError: pocketsphinx is not installed, or the text has no words or too many.
    """
    texts = split_words(text)
    if not texts:
        raise UserError("the transcript has no words; expected the text of the recording")
    if len(texts) > MAX_WORDS or max(map(len, texts)) > _MAX_LETTERS:
        raise UserError(
            f"the transcript has {len(texts)} words, the longest of {max(map(len, texts))} characters; expected at "
            f"most {MAX_WORDS} words of {_MAX_LETTERS} characters: give the text of this recording alone"
        )
    decoder = _load(texts)
    placed = _place(audio, texts, _recognise(decoder, audio, texts))
    words: list[Word] = []
    for start, end, piece in _pieces(placed, len(audio) / SAMPLE_RATE):
        aligned = _force(decoder, audio, start, end, [one.word.text for one in piece])
        if aligned is None and piece:
            _logger.warning("%d words from %.1f to %.1f s cannot be aligned; spread by letters", len(piece), start, end)
        words += [one.word for one in piece] if aligned is None else aligned
    return without_overlap(words)


def _load(texts: Sequence[str]) -> "Decoder":
    """Load a decoder with only the words of the text, so that it starts 40 times as fast."""
    pocketsphinx = require("pocketsphinx", "import", by="aligning a text (a transcript without times)")
    known = _known_pronunciations(texts, pathlib.Path(pocketsphinx.get_model_path("en-us/cmudict-en-us.dict")))
    with tempfile.TemporaryDirectory() as folder:
        dictionary = pathlib.Path(folder, "words.dict")
        dictionary.write_text("".join(line for lines in known.values() for line in lines), encoding="utf-8")
        decoder = pocketsphinx.Decoder(lm=None, dict=str(dictionary), loglevel="FATAL")
    for word, phones in guess_pronunciations(sorted({*texts} - {*known})).items():
        decoder.add_word(word, phones, update=False)
    return decoder


def _recognise(decoder: "Decoder", audio: np.ndarray, texts: Sequence[str]) -> list[Word]:
    """Recognise words with a language model of the text alone, in order of time."""
    from pocketsphinx.lm import ArpaBoLM

    model = ArpaBoLM(text=" ".join(texts), add_start=True)
    model.compute()
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "text.lm")
        with path.open("w", encoding="utf-8") as file:
            model.write(file)
        decoder.add_lm_file("text", str(path))
    decoder.activate_search("text")
    pieces = cut_at_quiet(audio, MAX_PIECE_SECONDS)
    return [word for start, end in pieces for word in _decode(decoder, audio, start, end)]


def _decode(decoder: "Decoder", audio: np.ndarray, start: float, end: float) -> list[Word]:
    """Return the words that the decoder's active search finds between two times."""
    samples = np.clip(audio[round(start * SAMPLE_RATE) : round(end * SAMPLE_RATE)], -1, 1)
    if not len(samples):
        return []
    decoder.start_utt()
    decoder.process_raw((samples * 32767).astype("<i2").tobytes(), full_utt=True)
    decoder.end_utt()
    # Silences and noises are in brackets; alternative pronunciations of a word end with their number.
    spoken = (segment for segment in decoder.seg() or () if segment.word[0] not in "<[")
    return [
        Word(
            segment.word.partition("(")[0],
            start + segment.start_frame * FRAME_SECONDS,
            start + (segment.end_frame + 1) * FRAME_SECONDS,
        )
        for segment in spoken
    ]


def _place(audio: np.ndarray, texts: Sequence[str], recognised: Sequence[Word]) -> list[_Placed]:
    """Return provisional times: the recognised ones for anchors, and a share of the gap for each word between."""
    clock = voiced_clock(audio)
    matcher = difflib.SequenceMatcher(None, texts, [word.text for word in recognised])
    times = {
        block.a + offset: recognised[block.b + offset]
        for block in matcher.get_matching_blocks()
        if block.size >= min(_MIN_ANCHOR, len(texts))
        for offset in range(block.size)
    }
    if len(times) < _MIN_RECOGNISED * len(texts):
        _logger.warning(
            "%d of %d words were recognised; check that it is the text of this recording", len(times), len(texts)
        )
    stretches = [
        Stretch(text, clock.to_voiced(times[index].start), clock.to_voiced(times[index].end))
        if index in times
        else Stretch(text, None, None)
        for index, text in enumerate(texts)
    ]
    filled = fill_gaps(stretches, 0.0, float(clock.readings[-1]), slack=_SLACK_SECONDS)
    if len(filled) < len(texts):
        _logger.warning("%d of %d words fit nowhere in the recording; left out", len(texts) - len(filled), len(texts))
    anchors = {id(stretch) for index, stretch in enumerate(stretches) if index in times}
    return [
        _Placed(Word(one.text, clock.to_time(one.start or 0.0), clock.to_time(one.end or 0.0)), id(one) in anchors)
        for one in filled
    ]


def _pieces(placed: Sequence[_Placed], duration: float) -> list[tuple[float, float, list[_Placed]]]:
    """Cut the recording into pieces of at most 30 s and return (start, end, words) of each.

    Only a pause between two anchors that are neighbours in the text is sure to lie between the same words in the audio.
    The longest such pause within 30 s is taken; if there is none, the piece is longer.
    """
    cuts = [
        (after.word.start - before.word.end, (before.word.end + after.word.start) / 2, index)
        for index, (before, after) in enumerate(itertools.pairwise(placed), start=1)
        if before.is_anchor and after.is_anchor
    ]
    pieces, start, first = [], 0.0, 0
    while duration - start > MAX_PIECE_SECONDS:
        ahead = [cut for cut in cuts if cut[2] > first]
        reachable = [cut for cut in ahead if cut[1] - start <= MAX_PIECE_SECONDS] or ahead[:1]
        if not reachable:
            break
        _, end, index = max(reachable)
        pieces.append((start, end, list(placed[first:index])))
        start, first = end, index
    return [*pieces, (start, duration, list(placed[first:]))]


def _force(decoder: "Decoder", audio: np.ndarray, start: float, end: float, texts: Sequence[str]) -> list[Word] | None:
    """Align words between two times by forced alignment; None if that fails."""
    if not texts or end - start > MAX_PIECE_SECONDS:
        return None
    try:
        decoder.set_align_text(" ".join(texts))
        words = _decode(decoder, audio, start, end)
    except RuntimeError:  # pocketsphinx raises this for every failure
        return None
    return words if [word.text for word in words] == list(texts) else None


class VoicedClock(NamedTuple):
    """A clock that almost stops in silence."""

    times: np.ndarray  # (frames + 1,) times in the recording, in seconds
    readings: np.ndarray  # (frames + 1,) seconds of speech up to each time, strictly increasing

    def to_voiced(self, time: float) -> float:
        return float(np.interp(time, self.times, self.readings))

    def to_time(self, reading: float) -> float:
        return float(np.interp(reading, self.readings, self.times))


def loudness(audio: np.ndarray) -> np.ndarray:
    """Return the level in decibels of every 10 ms, (frames,), smoothed over 50 ms; there is at least one frame."""
    frames = max(1, len(audio) // _FRAME)
    padded = np.zeros(frames * _FRAME)
    padded[: len(audio)] = audio[: frames * _FRAME]
    power = np.square(padded.reshape(frames, _FRAME)).mean(axis=1)
    smooth = np.convolve(np.pad(power, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    return 10 * np.log10(smooth + 1e-10)


def voiced_clock(audio: np.ndarray) -> VoicedClock:
    level = loudness(audio)
    speed = np.where(level > np.quantile(level, 0.99) - _SPEECH_DB, 1.0, _SILENCE_SPEED)
    readings = np.concatenate([[0.0], np.cumsum(speed) * FRAME_SECONDS])
    return VoicedClock(np.arange(len(readings)) * FRAME_SECONDS, readings)


def cut_at_quiet(audio: np.ndarray, max_seconds: float) -> list[tuple[float, float]]:
    """Return (start, end) in seconds of pieces of a recording, each of which ends at the quietest moment of its second
    half; together they cover the recording.
    """
    level = loudness(audio)
    longest = round(max_seconds / FRAME_SECONDS)
    duration, start, pieces = len(audio) / SAMPLE_RATE, 0, []
    while duration - start * FRAME_SECONDS > max_seconds:
        middle = start + longest // 2
        end = middle + int(np.argmin(level[middle : start + longest]))
        pieces.append((start * FRAME_SECONDS, end * FRAME_SECONDS))
        start = end
    return [*pieces, (start * FRAME_SECONDS, duration)]


def _known_pronunciations(words: Iterable[str], dictionary: pathlib.Path) -> dict[str, list[str]]:
    """Return the lines `word PHONE PHONE ...` of words in a CMU dictionary by word; further pronunciations of a word
    follow as `word(2) ...`.
    """
    wanted, found = set(words), {}
    with dictionary.open(encoding="utf-8") as file:
        for line in file:
            word = line.split(None, 1)[0].partition("(")[0]
            if word in wanted:
                found.setdefault(word, []).append(line)
    return found


def guess_pronunciations(words: Iterable[str]) -> dict[str, str]:
    """Return American English pronunciations by espeak-ng of words of any spelling: phones of the CMU set, separated
    by spaces, by word; a single vowel if espeak-ng gives no phoneme.
    """
    with fresh_library() as (library, _):
        library.espeak_SetVoiceByName(_VOICE)
        translate = library.espeak_TextToPhonemes
        translate.restype = ctypes.c_char_p
        translate.argtypes = [ctypes.POINTER(ctypes.c_char_p), ctypes.c_int, ctypes.c_int]
        return {word: _to_phones(_phonemes(word, translate)) for word in words}


def _phonemes(word: str, translate) -> str:  # type: ignore[no-untyped-def]
    # Each call advances the pointer by a clause, and sets it to zero at the end.
    buffer = ctypes.create_string_buffer(word.encode())
    rest = ctypes.c_char_p(ctypes.addressof(buffer))
    clauses = []
    while rest.value:
        clauses.append(translate(ctypes.byref(rest), _CHARS_UTF8, ord(_SEPARATOR) << 8).decode())
    return " ".join(clauses)


def _to_phones(phonemes: str) -> str:
    symbols = (symbol.strip(_STRESS) for symbol in phonemes.replace(" ", _SEPARATOR).split(_SEPARATOR))
    return " ".join(_PHONES[symbol] for symbol in symbols if symbol in _PHONES) or "AH"


def recognise(audio: np.ndarray, *, model: str) -> tuple[Word, ...]:
    """Recognise the words of a recording (samples,) float32 at 16 kHz by Whisper, in order of time.

    Whisper's own times are wrong by up to half a second. English words are aligned again by `align`; for other
    languages pocketsphinx has no model, and Whisper's times are kept.

    Args:
        model: name of a Whisper model, which is downloaded once, or a folder of one in CTranslate2's format.

    Raises:
        UserError: faster-whisper or pocketsphinx is not installed, or the model cannot be loaded.
    """
    whisper = _load_whisper(model)
    # For reproducible words in any process: at temperature 0 nothing is drawn at random, and the number of threads,
    # which changes the last bits of the spectrogram and sometimes a word, is always one. Without conditioning on the
    # previous text, a repetition cannot go on after its half minute.
    with threadpoolctl.threadpool_limits(1, "blas"):
        segments, info = whisper.transcribe(
            audio,
            word_timestamps=True,
            temperature=0.0,
            condition_on_previous_text=False,
            vad_filter=True,
        )
    words = without_overlap(
        Word(text, start, end)
        for segment in segments
        for word in segment.words or ()
        for text, start, end in spread(split_words(word.word), float(word.start), float(max(word.start, word.end)))
    )
    if info.language != "en" or not words:
        return words
    return align(audio, " ".join(word.text for word in words))


def _load_whisper(model: str) -> "WhisperModel":
    whisper = require("faster_whisper", "import", by="recognising words (a recording without a transcript)")
    folder = pathlib.Path(model)
    missing = [name for name in ("model.bin", "tokenizer.json") if not (folder / name).is_file()]
    if folder.is_dir() and missing:
        raise UserError(
            f"{folder} has no Whisper model in CTranslate2's format ({', '.join(missing)} missing); "
            "give the folder that ct2-transformers-converter made, with the tokenizer"
        )
    try:
        return whisper.WhisperModel(model, device="cpu", compute_type="int8", cpu_threads=1)
    except Exception as error:  # the libraries raise plain Exception, among others
        reason = " ".join(str(error).split())[:100]
        where = "in that folder" if folder.is_dir() else "on the Hugging Face Hub and in its cache (HF_HOME)"
        raise UserError(
            f"Whisper model {model!r} cannot be loaded ({reason}); searched {where}: "
            "connect once to download it, or give a folder with model.bin, config.json, tokenizer.json and vocabulary"
        ) from error

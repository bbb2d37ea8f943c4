"""Alignment of a text with its audio by pocketsphinx, in pieces of at most 30 s.

1. The audio is cut at quiet moments and recognised with a language model made of the text alone (after Moreno et al.,
   "A recursive algorithm for the forced alignment of very long audio segments", 1998). Runs of three words or more
   that recognition and text have in common are anchors.
2. Words between anchors get provisional times: the gap is divided by letters, on a clock that stops in silence. Words
   that do not fit in the gap were not spoken, and are left out.
3. Pieces of at most 30 s, cut at the longest pauses between neighbouring anchors, are aligned by forced alignment.
"""

import difflib
import itertools
import logging
import pathlib
import tempfile
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.features.words import pronunciation, timing, voicing
from ha2g_jax.features.words.spelling import split_words
from ha2g_jax.features.words.timing import Stretch
from ha2g_jax.limits import MAX_WORDS

if TYPE_CHECKING:
    from pocketsphinx import Decoder

MAX_PIECE_SECONDS = 30.0

_MIN_ANCHOR = 3
_MAX_LETTERS = 100  # in a word, far more than the longest of English
# Time of the neighbours that may belong to a word that was not recognised.
_SLACK_SECONDS = 0.3
# Minimum fraction of recognised words; below it the text is probably not that of the recording.
_MIN_RECOGNISED = 0.3

_logger = logging.getLogger(__name__)


class _Placed(NamedTuple):
    """A word with its provisional time, and whether it was recognised there."""

    word: Word
    is_anchor: bool


def align(audio: np.ndarray, text: str) -> tuple[Word, ...]:
    """Find the times at which the words of an English text are spoken.

    The words of a piece that pocketsphinx cannot align keep their provisional times, with a warning in the log.

    Args:
        audio: (samples,) float32 at 16 kHz.
        text: spoken text in order; numbers may be written in digits.

    Returns:
        The words in order of time, without those that do not fit anywhere.

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
    return timing.without_overlap(words)


def _load(texts: Sequence[str]) -> "Decoder":
    """Load a decoder with only the words of the text, which makes it start 40 times as fast."""
    try:
        from pocketsphinx import Decoder, get_model_path
    except ImportError as error:
        raise UserError(
            "aligning a text needs pocketsphinx: pip install 'ha2g-jax[speech]'; or give a transcript with times"
        ) from error
    known = pronunciation.known_pronunciations(texts, pathlib.Path(get_model_path("en-us/cmudict-en-us.dict")))
    with tempfile.TemporaryDirectory() as folder:
        dictionary = pathlib.Path(folder, "words.dict")
        dictionary.write_text("".join(line for lines in known.values() for line in lines), encoding="utf-8")
        decoder = Decoder(lm=None, dict=str(dictionary), loglevel="FATAL")
    for word, phones in pronunciation.guess_pronunciations(sorted({*texts} - {*known})).items():
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
    pieces = voicing.cut_at_quiet(audio, MAX_PIECE_SECONDS)
    return [word for start, end in pieces for word in _decode(decoder, audio, start, end)]


def _decode(decoder: "Decoder", audio: np.ndarray, start: float, end: float) -> list[Word]:
    """Return the words that the decoder's active search finds between two times."""
    samples = np.clip(audio[round(start * SAMPLE_RATE) : round(end * SAMPLE_RATE)], -1, 1)
    if not len(samples):
        return []
    decoder.start_utt()
    decoder.process_raw((samples * 32767).astype("<i2").tobytes(), full_utt=True)
    decoder.end_utt()
    # Silences and noises are in brackets; another pronunciation of a word is followed by its number.
    spoken = (segment for segment in decoder.seg() or () if segment.word[0] not in "<[")
    return [
        Word(
            segment.word.partition("(")[0],
            start + segment.start_frame * voicing.FRAME_SECONDS,
            start + (segment.end_frame + 1) * voicing.FRAME_SECONDS,
        )
        for segment in spoken
    ]


def _place(audio: np.ndarray, texts: Sequence[str], recognised: Sequence[Word]) -> list[_Placed]:
    """Return provisional times: the recognised ones for anchors, and a part of the gap for the words between."""
    clock = voicing.voiced_clock(audio)
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
    filled = timing.fill_gaps(stretches, 0.0, float(clock.readings[-1]), slack=_SLACK_SECONDS)
    if len(filled) < len(texts):
        _logger.warning("%d of %d words fit nowhere in the recording; left out", len(texts) - len(filled), len(texts))
    anchors = {id(stretch) for index, stretch in enumerate(stretches) if index in times}
    return [
        _Placed(Word(one.text, clock.to_time(one.start or 0.0), clock.to_time(one.end or 0.0)), id(one) in anchors)
        for one in filled
    ]


def _pieces(placed: Sequence[_Placed], duration: float) -> list[tuple[float, float, list[_Placed]]]:
    """Cut the recording into pieces of at most 30 s and return (start, end, words) of each.

    Only a pause between two anchors that are neighbours in the text surely lies between the same words in the audio.
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

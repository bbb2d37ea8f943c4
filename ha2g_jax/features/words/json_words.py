"""Parser of the JSON of speech recognisers and aligners: Whisper, whisperX, faster-whisper, Gentle; and of Seamless."""

import json
import math
import pathlib
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.features.words.timing import Stretch, fill_gaps
from ha2g_jax.features.words.unspoken import without_brackets
from ha2g_jax.files import reading
from ha2g_jax.files.reading import shown


def parse_json(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse the words of a Gentle, Whisper or whisperX file.

    Args:
        text: contents of the file.
        path: path of the file, to name it in an error message.

    Returns:
        One stretch per word, or one per segment for segments without words.

    Raises:
        UserError: the text is not JSON, or not the output of one of these tools.
    """
    try:
        content = reading.parse_json(text)
        # Seamless Interaction has the segments of whisperX under a name of its own.
        segments = content.get("segments") or content.get("metadata:transcript")
        words = content.get("words", content.get("word_segments"))
        # OpenAI's service returns segments without words, and a separate list of words.
        if segments and (not words or any(segment.get("words") for segment in segments)):
            return [stretch for segment in segments for stretch in _segment(segment)]
        if words and any("case" in word for word in words):
            return fill_gaps([_gentle_word(word) for word in words], 0.0, None)
        if words:
            return fill_gaps([_word(word) for word in words], 0.0, None, slack=math.inf)
    except json.JSONDecodeError as error:
        raise UserError(f"{shown(path)} is damaged JSON ({error}); export the transcript again, whole") from error
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        found = f"{type(error).__name__}: {reading.reason(error)[:80]}"
        raise UserError(
            f"{shown(path)} is not JSON of Gentle, Whisper or whisperX ({found}); export it again"
        ) from error
    raise UserError(
        f"{shown(path)} is JSON without `segments` or `words`; expected the output of Gentle, Whisper or whisperX"
    )


def _segment(segment: dict[str, Any]) -> list[Stretch]:
    """Return the words of a Whisper segment, or its text as one stretch if it has none.

    whisperX gives no times for words that its aligner cannot spell, such as numbers. They were spoken nevertheless, so
    they get the gap between their neighbours.
    """
    start, end = _seconds(segment.get("start")), _seconds(segment.get("end"))
    words = [_word(word) for word in segment.get("words") or []]
    if any(word.start is not None for word in words):
        return fill_gaps(words, start, end, slack=math.inf)
    return [Stretch(_spoken(segment["text"] if "text" in segment else segment["transcript"]), start, end)]


def _word(word: dict[str, Any]) -> Stretch:
    # openai-whisper, faster-whisper and whisperX have "word", older whisperX and some exports "text".
    text = word["word"] if "word" in word else word["text"]
    return Stretch(_spoken(text), _seconds(word.get("start")), _seconds(word.get("end")))


def _gentle_word(word: dict[str, Any]) -> Stretch:
    """Return a word of Gentle.

    A word of the case `not-found-in-audio` has no times. If it was spoken, it fits in the gap between its neighbours;
    if it is superfluous in the transcript, it does not. `fill_gaps` distinguishes the two cases.
    """
    if word.get("case", "success") == "not-found-in-audio":
        return Stretch(_text(word["word"]), None, None)
    return Stretch(_text(word["word"]), _seconds(word.get("start")), _seconds(word.get("end")))


def _spoken(text: object) -> str:
    """Return a text without the sounds that are not words, as Whisper and captions write them."""
    return without_brackets(_text(text).replace("\n", " "), "[(", " ").replace("♪", " ")


def _text(value: object) -> str:
    """Return a text of JSON; a number is a word, too, and half a pair of surrogates is no letter."""
    if not isinstance(value, str | int | float) or isinstance(value, bool):
        raise TypeError(f"a {type(value).__name__} instead of a text")
    return str(value).encode("utf-8", "replace").decode("utf-8")


def _seconds(value: object) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"the time {str(value)[:40]!r} is not a number")
    return float(value)

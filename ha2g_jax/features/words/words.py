"""The words of a recording, from a transcript, a plain text or speech recognition."""

import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.features.words import alignment, contents, readers, recognition, timing


def words_of(audio: np.ndarray, path: pathlib.Path | None, *, recognise: str | None) -> tuple[Word, ...]:
    """Return the words of a recording: read from a transcript, aligned from a plain text, or recognised.

    Args:
        audio: (samples,) float32 at 16 kHz.
        path: path of a transcript that `readers.read_words` reads, or of a .txt file without times, or None.
        recognise: name or folder of the Whisper model that is used if `path` is None; None for no recognition.

    Returns:
        Words within the recording, in seconds from its start.

    Raises:
        UserError: there is neither a transcript nor a model, or one of them fails.
    """
    if path is None:
        if recognise is None:
            raise UserError(
                "the recording has no transcript beside it; give one (.TextGrid .json .srt .vtt .tsv .txt) or the name "
                "of a Whisper model that recognises the words, such as tiny.en"
            )
        words = recognition.recognise(audio, model=recognise)
    elif path.suffix.lower() == ".txt":
        words = alignment.align(audio, contents.read_text(path))
    else:
        words = readers.read_words(path)
    return timing.inside(words, len(audio) / SAMPLE_RATE)

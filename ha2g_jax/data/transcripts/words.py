"""The words of one recording, from the best source there is."""

import pathlib

import numpy as np

from ha2g_jax.data.transcripts import alignment, contents, readers, recognition, timing
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word


def words_of(audio: np.ndarray, path: pathlib.Path | None, *, recognise: str | None) -> tuple[Word, ...]:
    """The words of a recording: read from a transcript, aligned from a plain text, or recognised.

    Args:
        audio: (samples,) float32 at 16 kHz.
        path: a transcript that `readers.read_words` reads, a .txt without times, or None.
        recognise: name or folder of a Whisper model that is used without a transcript; None for none.

    Returns:
        Words within the recording, in seconds from its start.

    Raises:
        UserError: there is neither a transcript nor a model, or one of them fails.
    """
    if path is None:
        if recognise is None:
            raise UserError(
                "the recording has no transcript beside it; give one (.TextGrid .json .srt .vtt .tsv .txt) or the name "
                "of a Whisper model to recognise the words with, such as tiny.en"
            )
        words = recognition.recognise(audio, model=recognise)
    elif path.suffix.lower() == ".txt":
        words = alignment.align(audio, contents.read_text(path))
    else:
        words = readers.read_words(path)
    return timing.inside(words, len(audio) / SAMPLE_RATE)

"""Speech recognition by Whisper (faster-whisper, on the CPU), with English words aligned again by pocketsphinx."""

import pathlib
from typing import TYPE_CHECKING

import numpy as np
import threadpoolctl

from ha2g_jax.errors import UserError, require
from ha2g_jax.features.text import Word
from ha2g_jax.features.words.alignment import align
from ha2g_jax.features.words.timing import split_words, spread, without_overlap

if TYPE_CHECKING:
    from faster_whisper import WhisperModel


def recognise(audio: np.ndarray, *, model: str = "tiny.en", language: str | None = None) -> tuple[Word, ...]:
    """Recognise the words of a recording by Whisper.

    Whisper's own times are wrong by up to half a second. English words are aligned again by `align`; for
    other languages pocketsphinx has no model, and Whisper's times are kept.

    Args:
        audio: (samples,) float32 at 16 kHz.
        model: name of a Whisper model, which is downloaded once, or a folder of one in CTranslate2's format.
        language: language code such as "en"; recognised from the first 30 s by default.

    Returns:
        The words in order of time, empty if nobody speaks.

    Raises:
        UserError: faster-whisper or pocketsphinx is not installed, or the model cannot be loaded.
    """
    whisper = _load(model)
    # For reproducible words in any process: at temperature 0 nothing is drawn at random, and the number of threads,
    # which changes the last bits of the spectrogram and sometimes a word, is always one. Without conditioning on the
    # previous text, a repetition cannot go on after its half minute.
    with threadpoolctl.threadpool_limits(1, "blas"):
        segments, info = whisper.transcribe(
            audio,
            language=language,
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


def _load(model: str) -> "WhisperModel":
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

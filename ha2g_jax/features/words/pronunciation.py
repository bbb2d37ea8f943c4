"""Pronunciations in the phones of pocketsphinx' English model, from its dictionary or else from espeak-ng."""

import ctypes
import pathlib
from collections.abc import Iterable

from ha2g_jax.features import espeak as speech

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


def known_pronunciations(words: Iterable[str], dictionary: pathlib.Path) -> dict[str, list[str]]:
    """Look up words in a CMU dictionary; a word may have several pronunciations.

    Args:
        words: words in lower case.
        dictionary: file of lines `word PHONE PHONE ...`, with further pronunciations as `word(2) ...`.

    Returns:
        The lines of each word that the dictionary has, by word.
    """
    wanted, found = set(words), {}
    with dictionary.open(encoding="utf-8") as file:
        for line in file:
            word = line.split(None, 1)[0].partition("(")[0]
            if word in wanted:
                found.setdefault(word, []).append(line)
    return found


def guess_pronunciations(words: Iterable[str]) -> dict[str, str]:
    """Guess the American English pronunciation of words, numbers and letters with espeak-ng.

    Args:
        words: words of any spelling.

    Returns:
        Phones of the CMU set, separated by spaces, by word; a single vowel if espeak-ng gives no phoneme.

    Raises:
        UserError: espeak-ng cannot be loaded.
    """
    with speech.fresh_library() as (library, _):
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

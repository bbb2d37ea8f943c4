"""Division of text into words: lower case letters, digits and apostrophes of any language."""

import re
import unicodedata

_APOSTROPHES = str.maketrans(dict.fromkeys("’‘ʼ＇`", "'"))
_THOUSANDS = re.compile(r"(?<=[0-9]),(?=[0-9]{3}(?![0-9]))")
_NOT_OF_WORDS = re.compile(r"[^a-z0-9']")
# Characters that join letters of Persian and Indian scripts within a word.
_JOINERS = "\u200c\u200d"
_MANY = 100  # marks on one letter


def split_words(text: str) -> list[str]:
    """Split a text into words as the corpus spells them.

    Letters (with their marks), digits and apostrophes within a word are kept, in lower case; everything else separates
    words, so that "twenty-one" is two words. A comma in a number is dropped: "1,000" is "1000".

    Args:
        text: any text, without brackets and tags.

    Returns:
        The words, none empty.
    """
    if len(text) > _MANY and not text.isascii():
        text = _with_few_marks(text)
    text = _THOUSANDS.sub("", unicodedata.normalize("NFC", text).lower().translate(_APOSTROPHES))
    if text.isascii():
        text = _NOT_OF_WORDS.sub(" ", text)
    else:
        text = "".join(character if _belongs(character) else " " for character in text)
    words = (word.strip("'" + _JOINERS) for word in text.split())
    return [word for word in words if any(character.isalnum() for character in word)]


def _with_few_marks(text: str) -> str:
    """Cut runs of marks that belong to one letter; sorting a run takes time in the square of its length."""
    marks = "".join(character for character in set(text) if unicodedata.combining(character))
    return re.sub(f"([{marks}]{{{_MANY}}})[{marks}]+", r"\1", text) if marks else text


def _belongs(character: str) -> bool:
    # Vowel signs of Indian scripts are marks, neither letters nor digits.
    return character.isalnum() or character in _JOINERS or character == "'" or unicodedata.category(character)[0] == "M"


def num_letters(word: str) -> int:
    """Count the letters and digits of a word, by which time is divided among words; at least 1."""
    return max(1, sum(character.isalnum() for character in word))

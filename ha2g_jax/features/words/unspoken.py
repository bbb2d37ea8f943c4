"""Removal of brackets from text, in one pass whatever the text."""

import re

_CLOSING = {"{": "}", "[": "]", "(": ")", "<": ">"}
_MAX_INSIDE = 200  # letters


def without_brackets(text: str, openings: str, instead: str) -> str:
    """Replace each bracket with at most 200 letters in it, all on one line.

    A regular expression would try 200 letters for each opening bracket, which takes minutes for a file full of them.

    Args:
        text: any text.
        openings: opening brackets to look for, some of `{[(<`.
        instead: text that takes the place of a bracket.

    Returns:
        The text without the brackets.
    """
    kept, position = [], 0
    for opening in re.finditer(f"[{re.escape(openings)}]", text):
        start = opening.start()
        if start < position:
            continue
        end = text.find(_CLOSING[opening[0]], start + 1, start + _MAX_INSIDE + 2)
        if end < 0 or text.find("\n", start, end) >= 0:
            continue
        kept.append(text[position:start])
        position = end + 1
    return instead.join([*kept, text[position:]])

"""Fonts for texts in pictures."""

import functools

import numpy as np
from PIL import ImageFont

# Fonts of Linux, macOS and Windows that have the letters of many languages.
_FONTS = (
    *("DejaVuSans.ttf", "NotoSans-Regular.ttf", "NotoSansCJK-Regular.ttc"),
    *("Arial Unicode.ttf", "arial.ttf", "msyh.ttc", "msgothic.ttc"),
)
_NO_LETTER = "\uffff"  # drawn as the box that stands for letters that a font lacks


def font_for(text: str, size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return a font of a size in pixels that has the letters of a text: Pillow's own, which has those of English, or
    the first of this computer. If none has all of them, it is Pillow's own, which draws boxes in their place.
    """
    name = None if text.isascii() else _find(frozenset(text))
    return ImageFont.load_default(size) if name is None else ImageFont.truetype(name, size)


@functools.cache
def _find(letters: frozenset[str]) -> str | None:
    for name in _FONTS:
        try:
            font = ImageFont.truetype(name)
        except OSError:  # this computer does not have it
            continue
        box = _pixels(font, _NO_LETTER)
        if not any(np.array_equal(_pixels(font, letter), box) for letter in letters):
            return name
    return None


def _pixels(font: ImageFont.FreeTypeFont, text: str) -> np.ndarray:
    return np.asarray(font.getmask(text))

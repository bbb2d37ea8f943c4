"""Texts in pictures are legible in any language that a font of this computer has."""

import pathlib

import numpy as np
import pytest
from PIL import ImageFont

from ha2g_jax.figure import lettering


def pixels(text: str) -> tuple[int, ...]:
    return tuple(np.asarray(lettering.font_for(text, 20).getmask(text)))


def is_dejavu(text: str) -> bool:
    font = lettering.font_for(text, 20)
    return isinstance(font, ImageFont.FreeTypeFont) and font.getname()[0] == "DejaVu Sans"


@pytest.fixture
def dejavu(monkeypatch):
    """A computer that has one font, with Latin, Greek and Cyrillic letters."""
    matplotlib = pytest.importorskip("matplotlib")
    path = pathlib.Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    monkeypatch.setattr(lettering, "_FONTS", ("none.ttf", str(path)))
    lettering._find.cache_clear()
    yield
    lettering._find.cache_clear()


def test_letters_that_pillows_font_lacks_are_drawn(dejavu):
    assert len({pixels(word) for word in ("привет", "будьте", "größer", "größen")}) == 4
    assert [is_dejavu(word) for word in ("größer", "hello", "语")] == [True, False, False]

"""Texts in pictures are legible in any language that a font of this computer has."""

import pathlib

import pytest

from ha2g_jax.figure import lettering


def pixels(text: str) -> bytes:
    return bytes(lettering.font_for(text, 20).getmask(text))


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
    names = [lettering.font_for(word, 20).getname()[0] for word in ("größer", "hello", "语")]
    assert names[0] == "DejaVu Sans" and "DejaVu Sans" not in names[1:]

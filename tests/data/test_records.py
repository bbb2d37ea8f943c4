"""A clip survives its bytes; damaged bytes are a user's error, never a traceback from a decoder."""

import dataclasses

import numpy as np
import pytest
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.data.records import Clip, Stroke, decode_clip, encode_clip
from ha2g_jax.features.text import Word


@pytest.fixture
def clip() -> Clip:
    rng = np.random.default_rng(0)
    return Clip(
        id="a-0",
        speaker="ann",
        audio=rng.uniform(-0.9, 0.9, 8000).astype(np.float32),
        words=(Word("hello", 0.1, 0.3), Word("naïve", 0.3, 0.45)),
        positions=rng.normal(size=(8, 43, 3)).astype(np.float32),
        reference_images=np.full((2, 224, 224, 3), (30, 120, 200), np.uint8),
        recording_start=1.5,
        window_starts=(0, 10),
        strokes=(Stroke(0.2, 0.1, 0.4, "semantic", "left", 1.25, "one"),),
        style=(0.5, -1.0),
        recording="a",
        confidence=rng.uniform(size=(8, 43)).astype(np.float32),
    )


def test_round_trip(clip):
    """Motion, words and truth come back exactly, sound to 16 bits, images to the precision of JPEG."""
    read = decode_clip(encode_clip(clip))
    for field in dataclasses.fields(Clip):
        if field.name not in ("audio", "positions", "reference_images", "confidence"):
            assert getattr(read, field.name) == getattr(clip, field.name), field.name
    assert read.audio.dtype == np.float32
    np.testing.assert_allclose(read.audio, clip.audio, atol=2**-15)
    np.testing.assert_array_equal(read.positions, clip.positions)
    np.testing.assert_array_equal(read.confidence, clip.confidence)
    assert isinstance(read.strokes[0], Stroke)
    assert isinstance(read.words[0], Word)
    assert read.reference_images is not None and clip.reference_images is not None
    assert np.abs(read.reference_images.astype(int) - clip.reference_images).max() <= 3


def test_bytes_are_stable(clip):
    """What is decoded encodes to the same bytes, so copies of a corpus have equal hashes."""
    clip = dataclasses.replace(clip, reference_images=None)
    record = encode_clip(clip)
    assert encode_clip(decode_clip(record)) == record


def test_positions_keep_their_precision(clip):
    precise = dataclasses.replace(clip, positions=np.full((2, 43, 3), 1 / 3))
    assert decode_clip(encode_clip(precise)).positions.dtype == np.float64
    np.testing.assert_array_equal(decode_clip(encode_clip(precise)).positions, precise.positions)


@FUZZ
@given(data=st.data())
def test_any_damage_is_read_or_one_line(clip, data):
    with one_line():
        decode_clip(data.draw(damaged_bytes(encode_clip(clip))))

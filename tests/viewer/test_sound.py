"""The sound of a page is the sound that was given, and not a sample late."""

import io

import av
import numpy as np
import pytest

from ha2g_jax.viewer import packing


def decode(content):
    with av.open(io.BytesIO(content), "r") as container:
        frames = [frame.to_ndarray()[0] for frame in container.decode(audio=0)]
        return np.concatenate(frames), container.streams.audio[0].codec_context.sample_rate


@pytest.mark.parametrize(("rate", "new_rate"), [(16000, 16000), (44100, 44100), (8000, 16000)])
def test_nothing_is_added_before_the_sound(rate, new_rate):
    time = np.arange(int(1.7 * rate)) / rate
    audio = (0.5 * np.sin(2 * np.pi * 300 * time) * (np.abs(time - 1) < 0.1)).astype(np.float32)
    decoded, decoded_rate = decode(packing.encode_sound(audio, rate))
    assert decoded_rate == new_rate
    assert len(decoded) / new_rate == pytest.approx(1.7, abs=0.05)
    loud = np.flatnonzero(np.abs(decoded) > 0.15) / new_rate
    assert loud[0] == pytest.approx(0.9, abs=0.004)
    assert loud[-1] == pytest.approx(1.1, abs=0.004)


def test_the_same_sound_gives_the_same_bytes():
    audio = np.random.default_rng(0).normal(0, 0.1, 20_000).astype(np.float32)
    assert packing.encode_sound(audio, 16000) == packing.encode_sound(audio, 16000)

"""What is packed can be unpacked, to less than the eye sees."""

import base64
import io
import zlib

import av
import numpy as np
import pytest
from fixtures.motions import swaying

from ha2g_jax.skeleton import normalize
from ha2g_jax.viewer import packing
from ha2g_jax.viewer.packing import LEVELS, PEAK_RATE, octahedral, pack_motion, peaks

# From the axes of each skeleton's data to y up, facing +z, the person's left at +x.
AXES = {"ted_expressive": [1, -1, -1], "ted_gesture": [-1, -1, 1]}


def unfold(codes):
    """The inverse of `octahedral`, by the paper's formula."""
    square = codes / (LEVELS / 2) - 1
    depth = 1 - np.abs(square).sum(axis=-1)
    folded = (1 - np.abs(square[..., ::-1])) * np.where(square < 0, -1, 1)
    front = np.where(depth[..., None] < 0, folded, square)
    return normalize(np.concatenate([front, depth[..., None]], axis=-1))


def degrees_between(a, b):
    return np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def test_a_direction_is_kept_to_less_than_a_tenth_of_a_degree():
    random = np.random.default_rng(0).normal(size=(20_000, 3))
    corners = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
    directions = normalize(np.concatenate([random, corners, corners + 1e-9]))
    codes = octahedral(directions)
    assert codes.min() >= 0
    assert codes.max() <= LEVELS
    assert degrees_between(unfold(codes), directions).max() < 0.07


@pytest.mark.parametrize("name", AXES)
def test_a_motion_is_unpacked_in_the_axes_of_the_page(name):
    motion = swaying(name, frames=40)
    packed = pack_motion(motion)
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["directions"])), np.uint8).reshape(2, -1)
    zigzag = planes[0] + 256 * planes[1].astype(int)
    steps = np.where(zigzag % 2, -(zigzag + 1) // 2, zigzag // 2).reshape(-1, 40)
    codes = np.cumsum(steps, axis=1).T.reshape(40, -1, 2)
    assert degrees_between(unfold(codes), motion.directions * AXES[name]).max() < 0.07
    assert packed["joints"] == list(motion.joint_names)
    assert packed["lengths"] == pytest.approx(motion.skeleton.lengths, abs=1e-5)


def test_a_minute_takes_few_bytes():
    packed = pack_motion(swaying(frames=900))
    assert len(packed["directions"]) < 900 * 42 * 2 * 1.25 * 4 / 3  # bytes a number, in base64


def test_peaks_lie_where_the_sound_is():
    audio = np.zeros(16_000 * 2 + 5, np.float32)
    audio[16_000:16_010] = -0.25  # at one second
    heights = np.frombuffer(zlib.decompress(base64.b64decode(peaks(audio, 16_000))), np.uint8)
    assert len(heights) == 2 * PEAK_RATE + 1
    assert np.flatnonzero(heights).tolist() == [PEAK_RATE]
    assert heights.max() == 255


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

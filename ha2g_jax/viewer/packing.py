"""Compact encoding of motion and sound for a page."""

import base64
import io
import zlib
from typing import Any

import av
import numpy as np
import soxr

from ha2g_jax.motion.armature import export_axes
from ha2g_jax.motion.formats import video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import Skeleton, normalize

PEAK_RATE = 50  # peaks of the waveform per second
# 12 bits per octahedral coordinate: the error of a direction is at most 0.07 degrees, of a fingertip below 1 mm.
LEVELS = 4095
_RATES = (16000, 22050, 24000, 32000, 44100, 48000)  # sample rates of MP3
_BIT_RATE = 32000


def pack_motion(motion: Motion) -> dict[str, Any]:
    """Encode a motion for a page, with y up and the person facing +z.

    Returns:
        JSON values: "fps", "frames" (their number), "joints" (names), "bones" (parent, child), "lengths" in metres and
        "directions". The directions are octahedral coordinates (see `octahedral`), one row over time for each, as
        zigzag-encoded differences from frame to frame, all low bytes before all high bytes.
    """
    skeleton = motion.skeleton
    codes = octahedral(normalize(motion.directions * export_axes(skeleton)))
    rows = codes.reshape(len(codes), -1).T
    steps = np.diff(rows, axis=1, prepend=0)
    zigzag = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u2")
    planes = zigzag.reshape(-1, 1).view(np.uint8).T
    return {
        "fps": motion.fps,
        "frames": motion.num_frames,
        **describe_skeleton(skeleton),
        "directions": deflated(planes.tobytes()),
    }


def describe_skeleton(skeleton: Skeleton) -> dict[str, Any]:
    """Return JSON values: "joints" (names), "bones" (parent, child) and "lengths" in metres."""
    return {
        "joints": list(skeleton.joints),
        "bones": [list(bone) for bone in skeleton.bones],
        "lengths": [round(float(length), 5) for length in skeleton.lengths],
    }


def octahedral(directions: np.ndarray) -> np.ndarray:
    """Encode unit vectors (..., 3) as points (..., 2) of a square, int32 in [0, 4095].

    The square is the octahedron |x| + |y| + |z| = 1 with its back folded outwards, see Cigolle et al., A Survey of
    Efficient Representations for Independent Unit Vectors, JCGT 3(2), 2014.
    """
    on_faces = directions / np.sum(np.abs(directions), axis=-1, keepdims=True)
    front, depth = on_faces[..., :2], on_faces[..., 2:]
    folded = (1 - np.abs(front[..., ::-1])) * np.where(front < 0, -1, 1)
    square = np.where(depth < 0, folded, front)
    return np.rint((square + 1) * (LEVELS / 2)).astype(np.int32)


def peaks(audio: np.ndarray, sample_rate: int) -> str:
    """Encode the largest absolute sample in each 20 ms by `deflated`, one byte each, 255 for the largest of all."""
    num_peaks = -(-len(audio) * PEAK_RATE // sample_rate)
    edges = np.arange(num_peaks) * sample_rate // PEAK_RATE
    loudest = np.maximum.reduceat(np.abs(audio), edges)
    return deflated(np.rint(loudest / max(float(loudest.max()), 1e-6) * 255).astype(np.uint8).tobytes())


def deflated(content: bytes) -> str:
    """Compress bytes to base64 text, which the page decompresses."""
    return base64.b64encode(zlib.compress(content, 9)).decode()


def encode_sound(audio: np.ndarray, sample_rate: int) -> bytes:
    """Encode mono sound as an MP3 file, which every browser plays, at an eighth of the size of the samples.

    Its header has the number of samples that the encoder puts before the sound, so that players skip them. The same
    sound gives the same bytes.
    """
    if sample_rate not in _RATES:
        audio = soxr.resample(audio, sample_rate, _RATES[0], quality="HQ")
        sample_rate = _RATES[0]
    file = io.BytesIO()
    with av.open(file, "w", format="mp3", options={"fflags": "+bitexact", "id3v2_version": "0"}) as container:
        stream = container.add_stream("libmp3lame", rate=sample_rate, layout="mono")
        stream.bit_rate = _BIT_RATE
        for packets in video.encode_sound(stream, audio, sample_rate):
            container.mux(packets)
    return file.getvalue()

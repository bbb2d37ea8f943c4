"""Motion and sound as few bytes for a page: numbers that change little from frame to frame, deflated, in base64."""

import base64
import zlib
from typing import Any

import numpy as np

from ha2g_jax.motion.armature import export_axes
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import normalize

PEAK_RATE = 50  # peaks of the waveform a second
# 12 bits an octahedral coordinate: a direction is off by at most 0.07 degrees, a fingertip by under a millimetre.
LEVELS = 4095


def pack_motion(motion: Motion) -> dict[str, Any]:
    """What the page needs of a motion, with y up and the person facing +z.

    Args:
        motion: in the axes of the TED data.

    Returns:
        JSON values: "fps", "frames", "joints" (names), "bones" (parent, child), "lengths" in metres and "directions":
        octahedral coordinates (see `octahedral`), each a row over time, as differences from frame to frame in
        zigzag order, low bytes before high bytes.
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
        "joints": list(skeleton.joints),
        "bones": [list(bone) for bone in skeleton.bones],
        "lengths": [round(float(length), 5) for length in skeleton.lengths],
        "directions": deflated(planes.tobytes()),
    }


def octahedral(directions: np.ndarray) -> np.ndarray:
    """Return unit vectors as points of a square: the octahedron |x| + |y| + |z| = 1, its back folded over its front.

    From Cigolle et al., A Survey of Efficient Representations for Independent Unit Vectors, JCGT 3(2), 2014.

    Args:
        directions: (..., 3) unit vectors.

    Returns:
        (..., 2) int32 in [0, 4095].
    """
    on_faces = directions / np.sum(np.abs(directions), axis=-1, keepdims=True)
    front, depth = on_faces[..., :2], on_faces[..., 2:]
    folded = (1 - np.abs(front[..., ::-1])) * np.where(front < 0, -1, 1)
    square = np.where(depth < 0, folded, front)
    return np.rint((square + 1) * (LEVELS / 2)).astype(np.int32)


def peaks(audio: np.ndarray, sample_rate: int) -> str:
    """Return the loudest sample of each fiftieth of a second, one byte each, 255 the loudest of all; packed."""
    num_peaks = -(-len(audio) * PEAK_RATE // sample_rate)
    edges = np.arange(num_peaks) * sample_rate // PEAK_RATE
    loudest = np.maximum.reduceat(np.abs(audio), edges)
    return deflated(np.rint(loudest / max(float(loudest.max()), 1e-6) * 255).astype(np.uint8).tobytes())


def deflated(content: bytes) -> str:
    """Return bytes as text that the page inflates."""
    return base64.b64encode(zlib.compress(content, 9)).decode()

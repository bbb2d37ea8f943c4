"""Compact encoding of motion and sound for a page."""

import base64
import dataclasses
import functools
import io
import zlib
from typing import Any

import av
import numpy as np
import soxr

from ha2g_jax.figure import CAMERAS, SHIRTS
from ha2g_jax.figure.shapes import to_hex
from ha2g_jax.motion.armature import export_axes, figure_armature, rest_positions
from ha2g_jax.motion.formats import video
from ha2g_jax.motion.formats.body_mesh import COLOURS, body_mesh
from ha2g_jax.motion.formats.surfaces import Surface
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.smoothing import smoothstep
from ha2g_jax.skeleton import Skeleton, load_skeleton, normalize

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


def pack_body(skeleton: Skeleton) -> dict[str, Any]:
    """Encode the body of a `.glb` for a page, at rest with its spine at the origin.

    Returns:
        JSON values: "joints" of the armature and "hips", each a name, the index of its parent and its place in metres;
        "parts", each with the name and colour of a material, its numbers of points and faces; "points" in tenths of a
        millimetre, a row over all points for each axis, as differences, int16; "bindings", four joints of each point,
        and then, in as many further rows, its four weights of 0 to 255, uint8; "faces", the three points of each,
        counted from the first of the part, as differences, int16; "shirts", the colours of figures side by side;
        "view", the smallest that is shown.
    """
    return _pack_body(skeleton.name, tuple(np.round(np.asarray(skeleton.lengths, float), 5).tolist()))


@functools.lru_cache(maxsize=16)
def _pack_body(name: str, lengths: tuple[float, ...]) -> dict[str, Any]:
    armature = figure_armature(dataclasses.replace(load_skeleton(name), lengths=np.array(lengths)))
    _, places = rest_positions(armature)
    surfaces = {colour: _with_hips(surface) for colour, surface in body_mesh(armature).items()}
    bindings = [surface.bindings for surface in surfaces.values()]
    weights = [np.rint(255 * weights).astype(np.uint8) for _, weights in bindings]
    points = np.rint(1e4 * np.concatenate([surface.points for surface in surfaces.values()])).T
    faces = np.concatenate([surface.faces.reshape(-1) for surface in surfaces.values()])
    return {
        "joints": [*zip(armature.joints, armature.parents, places.round(5).tolist()), ("hips", 0, [0.0, 0.0, 0.0])],
        "parts": [
            [colour, to_hex(COLOURS[colour][0]), len(part.points), len(part.faces)] for colour, part in surfaces.items()
        ],
        "points": deflated(np.diff(points, axis=1, prepend=0).astype("<i2").tobytes()),
        "bindings": deflated(
            np.concatenate([*(joints for joints, _ in bindings), *weights]).astype(np.uint8).tobytes()
        ),
        "faces": deflated(np.diff(faces, prepend=0).astype("<i2").tobytes()),
        "shirts": [to_hex(shirt) for shirt in SHIRTS],
        "view": list(CAMERAS["body"]),
    }


def _with_hips(surface: Surface) -> Surface:
    """Divide the points that move with the spine, joint 0, between it and the hips, a joint that leans half as much."""
    below = surface.influence[:, :1] * smoothstep(-surface.points[:, 1:2], 0.0, 0.3)
    spine, others = surface.influence[:, :1] - below, surface.influence[:, 1:]
    return surface._replace(influence=np.concatenate([spine, others, below], axis=1))


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

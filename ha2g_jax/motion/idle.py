"""Idle movement of a resting figure: it breathes and sways a little, and now and then shifts and looks elsewhere.

The movement is a function of the seed and of the number of the frame, so that a stream may compute a frame again. It is
made from noise and never repeats. The sizes of breath and sway were measured in calm moments of two recordings of a
person who stands and waits.
"""

import functools

import numpy as np

from ha2g_jax.features import noise
from ha2g_jax.motion.control.parts import HEAD, SIDES, TRUNK, UPPER_ARM, arm_parts, bones_of, bones_of_kind
from ha2g_jax.motion.rotations import from_vector, rotate, unit
from ha2g_jax.motion.smoothing import minimum_jerk
from ha2g_jax.skeleton import Skeleton

_SLOWNESS = 1.5  # factor that slows the noise, which thus changes within three seconds
_BREATHS = 0.25  # per second
_BREATH_DEGREES = 0.7  # angle by which the shoulders rise and fall
_BREATH_PHASE, _BREATH_DEPTH = 0.7, 0.25  # standard deviations of the phase in radians, and of the depth

# Standard deviations in degrees about the axes x (lean), y (turn) and z (tilt), of the body, of the head on it, and of
# each arm.
_BODY, _HEAD, _ARM = (0.5, 1.2, 0.5), (0.8, 1.5, 0.5), (0.7, 0.4, 0.4)

# Shifts: seconds between two of them, seconds of each, and degrees about the axes, for the trunk, the head, and each
# arm with the forearm relative to it.
_TRUNK_SHIFT = 9.0, 2.0, (0.0, 1.5, 1.5)
_GAZE_SHIFT = 3.5, 0.5, (4.0, 10.0, 2.0)
_ARM_SHIFT = 6.0, 2.5, (2.4, 0.0, 2.0), (4.0, 5.0, 0.0)
_FARTHEST = 1.6  # standard deviations of a shift
_FIRST_CHANNEL, _MOST_CHANNELS = 1024, 16  # first channel of the noise, and channels for each kind of shift


def idle(skeleton: Skeleton, pose: np.ndarray, seed: int, frames: np.ndarray, fps: float) -> np.ndarray:
    """Return a pose, (bones, 3) unit vectors, with breath and sway at frames with numbers (T,), (T, bones, 3)."""
    turns = _turns(skeleton)
    num_slow = 1 + len(turns)
    values = noise.track(seed, frames, _SLOWNESS * fps, 2 * num_slow)[:, :num_slow].astype(np.float64)
    shift, depth, sway = values[:, 0], values[:, 1], values[:, 2:]
    phase = 2 * np.pi * _BREATHS / fps * np.asarray(frames) + _BREATH_PHASE * shift
    breath = (1 + _BREATH_DEPTH * depth) * np.sin(phase)
    return rotate(from_vector(np.tensordot(np.column_stack([breath, sway]), turns, 1)), pose)


def shifts(skeleton: Skeleton, seed: int, frames: np.ndarray, fps: float) -> np.ndarray:
    """Return the rotation vectors in radians, (T, bones, 3), by which a figure has shifted at frames (T,).

    In each span of some seconds, trunk, head and each arm move once to a new position, at some time within it.
    """
    total = np.zeros((len(frames), skeleton.num_bones, 3))
    for number, (span, seconds, turns) in enumerate(_shifts(skeleton)):
        spans = np.asarray(frames) / (span * fps)
        before = np.floor(spans)
        points = (before[:, None, None] - [[1], [0]]).astype(np.int32).astype(np.uint32)
        channels = np.uint32(_FIRST_CHANNEL + _MOST_CHANNELS * number) + np.arange(len(turns) + 1, dtype=np.uint32)
        drawn = noise.normal(np.array([seed], np.uint32), points, channels)  # (T, 2, turns + 1)
        start = (1 - seconds / span) * (drawn[:, 1, -1] * 16 % 1)  # the last channel gives the time
        weight = minimum_jerk(np.clip((spans - before - start) * span / seconds, 0, 1))[:, None]
        places = np.clip(drawn[..., :-1], -_FARTHEST, _FARTHEST)
        total += np.tensordot(places[:, 0] + weight * (places[:, 1] - places[:, 0]), turns, 1)
    return total


@functools.cache
def _shifts(skeleton: Skeleton) -> list[tuple[float, float, np.ndarray]]:
    """Return the seconds between shifts, of a shift, and its rotation vectors (turns, bones, 3), for each kind."""
    trunk, head = (bones_of_kind(skeleton, kind) for kind in (TRUNK, HEAD))
    kinds = []
    for bones, (span, seconds, degrees) in ((trunk, _TRUNK_SHIFT), (head, _GAZE_SHIFT)):
        kinds.append((span, seconds, [(bones, degrees)]))
    for side in SIDES:
        span, seconds, *degrees = _ARM_SHIFT
        arm = arm_parts(skeleton, side)
        fore = tuple(part for part in arm if part.kind != UPPER_ARM)
        kinds.append((span, seconds, list(zip((bones_of(arm), bones_of(fore)), degrees, strict=True))))
    return [(span, seconds, _about_axes(skeleton, moved)) for span, seconds, moved in kinds]


@functools.cache
def _turns(skeleton: Skeleton) -> np.ndarray:
    """Return the rotation vectors (13, bones, 3) of a breath, and of body, head and arms about each axis."""
    breath = np.zeros((skeleton.num_bones, 3))
    for side in SIDES:
        bone = skeleton.bone(f"{side}_shoulder")
        breath[bone] = _BREATH_DEGREES * unit(np.cross(skeleton.mean_directions[bone], [0, -1, 0]))
    arms = [(bones_of(arm_parts(skeleton, side)), _ARM) for side in SIDES]
    moved = [(slice(None), _BODY), (bones_of_kind(skeleton, HEAD), _HEAD), *arms]
    return np.concatenate([np.deg2rad(breath)[None], _about_axes(skeleton, moved)])


def _about_axes(skeleton: Skeleton, moved: list) -> np.ndarray:
    """Return the rotation vectors in radians, (3 n, bones, 3), of n pairs of bones and of degrees about each axis."""
    turns = np.zeros((len(moved), 3, skeleton.num_bones, 3))
    for turn, (bones, degrees) in zip(turns, moved, strict=True):
        for axis in range(3):
            turn[axis, bones, axis] = np.deg2rad(degrees[axis])
    return turns.reshape(-1, skeleton.num_bones, 3)

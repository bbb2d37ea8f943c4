"""Idle movement of a figure that rests: it breathes and sways a little.

The movement is a function of the seed and of the number of the frame, so that a stream may compute a frame again. It
follows noise and repeats nothing. Its size is that of a person who stands and waits, of whom two recordings were
measured, in calm moments.
"""

import functools

import numpy as np

from ha2g_jax.features import noise
from ha2g_jax.motion.control.parts import HEAD, SIDES, arm_parts, bones_of, parts
from ha2g_jax.motion.rotations import from_vector, rotate, unit
from ha2g_jax.skeleton import Skeleton

_SLOWNESS = 1.5  # of the noise, which so changes within three seconds
_BREATHS = 0.25  # per second
_BREATH_DEGREES = 0.7  # by which the shoulders rise and fall
_BREATH_PHASE, _BREATH_DEPTH = 0.7, 0.25  # standard deviations of the phase in radians, and of the depth

# Standard deviations in degrees about the axes x (lean), y (turn) and z (tilt), of the body, of the head on it, and of
# each arm.
_BODY, _HEAD, _ARM = (0.5, 1.2, 0.5), (0.8, 1.5, 0.5), (0.7, 0.4, 0.4)


def idle(skeleton: Skeleton, pose: np.ndarray, seed: int, frames: np.ndarray, fps: float) -> np.ndarray:
    """Return a pose, (bones, 3) unit vectors, as it breathes and sways at frames (T,) of any number, (T, bones, 3)."""
    turns = _turns(skeleton)
    num_slow = 1 + len(turns)
    values = noise.track(seed, frames, _SLOWNESS * fps, 2 * num_slow)[:, :num_slow].astype(np.float64)
    shift, depth, sway = values[:, 0], values[:, 1], values[:, 2:]
    phase = 2 * np.pi * _BREATHS / fps * np.asarray(frames) + _BREATH_PHASE * shift
    breath = (1 + _BREATH_DEPTH * depth) * np.sin(phase)
    return rotate(from_vector(np.tensordot(np.column_stack([breath, sway]), turns, 1)), pose)


@functools.cache
def _turns(skeleton: Skeleton) -> np.ndarray:
    """Return the rotation vectors (13, bones, 3) of a breath, and of body, head and arms about each axis."""
    breath = np.zeros((skeleton.num_bones, 3))
    for side in SIDES:
        bone = skeleton.bone(f"{side}_shoulder")
        breath[bone] = _BREATH_DEGREES * unit(np.cross(skeleton.mean_directions[bone], [0, -1, 0]))
    head = [bone for part in parts(skeleton) if part.kind == HEAD for bone in part.bones]
    moved = [(slice(None), _BODY), (head, _HEAD), *((bones_of(arm_parts(skeleton, side)), _ARM) for side in SIDES)]
    turns = [breath]
    for bones, degrees in moved:
        for axis in range(3):
            turns.append(np.zeros_like(breath))
            turns[-1][bones, axis] = degrees[axis]
    return np.deg2rad(turns)

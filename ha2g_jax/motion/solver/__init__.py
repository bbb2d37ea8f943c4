"""Conversion of direction vectors to joint rotations of the `ha2g` armature, and back (decision D10)."""

import numpy as np

from ha2g_jax.motion import armature as armatures
from ha2g_jax.motion import rotations
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.solver.frames import solve
from ha2g_jax.motion.solver.limits import clamp, without_jumps
from ha2g_jax.skeleton import Skeleton

__all__ = ["animate", "directions_of"]


def animate(motion: Motion, *, limits: bool = True) -> armatures.Animation:
    """Convert a motion to rotations of the joints of the `ha2g` armature.

    Each bone has exactly its direction. The rotation of a bone about its own length (its twist) is not in the
    direction; it is estimated from the bones around it: that of the trunk from the shoulders, of the head from the
    face, of the upper arm from the bend of the elbow, of the forearm from the palm, of a finger from its bend. Where
    these do not show it, as at a straight arm, the twist is held over time.

    Args:
        motion: motion of any skeleton.
        limits: whether to keep joints within the range of a human body.

    Returns:
        An animation whose root does not move; the signs of its quaternions are continuous over time.

    Raises:
        UserError: the motion is not valid, see `Motion.check`.
    """
    motion.check()
    skeleton = motion.skeleton
    armature = armatures.ha2g_armature(skeleton)
    directions = rotations.unit(motion.directions) * armatures.export_axes(skeleton)
    local = solve(skeleton, armature, directions, motion.fps)
    if limits:
        local = without_jumps(local, clamp(armature, local))
    local = rotations.continuous(rotations.unit(local))
    return armatures.Animation(armature, local, np.zeros((len(local), 3)), motion.fps, motion.meta)


def directions_of(animation: armatures.Animation, skeleton: Skeleton) -> np.ndarray:
    """Convert an animation of the `ha2g` armature to direction vectors, the inverse of `animate`.

    Args:
        animation: animation of the `ha2g` armature.
        skeleton: skeleton of the direction vectors.

    Returns:
        (T, bones, 3) unit vectors in the axes of the skeleton.
    """
    rotated, _ = armatures.world(animation)
    joints = [animation.armature.joint(name) for name in armatures.carriers(skeleton)]
    rest = armatures.rest_directions(skeleton)
    return rotations.rotate(rotated[:, joints], rest) * armatures.export_axes(skeleton)

"""Direction vectors -> joint rotations of the `ha2g` armature, and the way back (decision D10)."""

import numpy as np

from ha2g_jax.motion import armature as armatures
from ha2g_jax.motion import rotations
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.solver.checks import MAX_FRAMES, check
from ha2g_jax.motion.solver.frames import solve
from ha2g_jax.motion.solver.limits import clamp, without_jumps
from ha2g_jax.skeleton import Skeleton

__all__ = ["MAX_FRAMES", "animate", "check", "directions_of"]


def animate(motion: Motion, *, limits: bool = True) -> armatures.Animation:
    """The rotations of every joint of the `ha2g` armature.

    Each bone has its direction exactly. How it is turned about itself is not in the direction; it is read from the
    bones around it: the trunk from the shoulders, the head from the face, the upper arm from the bend of the elbow, the
    forearm from the palm, a finger from its bend. Where these show nothing, as at a straight arm, the twist is held.

    Args:
        motion: of any skeleton.
        limits: whether joints that turn further than those of a body are held at the end of their range.

    Returns:
        An animation whose root stays where it is; the signs of its quaternions do not jump from frame to frame.

    Raises:
        UserError: see `check`.
    """
    check(motion)
    skeleton = motion.skeleton
    armature = armatures.ha2g_armature(skeleton)
    directions = rotations.unit(motion.directions) * armatures.export_axes(skeleton)
    local = solve(skeleton, armature, directions, motion.fps)
    if limits:
        local = without_jumps(local, clamp(armature, local))
    local = rotations.continuous(rotations.unit(local))
    return armatures.Animation(armature, local, np.zeros((len(local), 3)), motion.fps, motion.meta)


def directions_of(animation: armatures.Animation, skeleton: Skeleton) -> np.ndarray:
    """(T, bones, 3) direction vectors of an animation of the `ha2g` armature, in the axes of the skeleton."""
    turned, _ = armatures.world(animation)
    joints = [animation.armature.joint(name) for name in armatures.carriers(skeleton)]
    rest = armatures.rest_directions(skeleton)
    return rotations.rotate(turned[:, joints], rest) * armatures.export_axes(skeleton)

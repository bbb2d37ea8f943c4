"""Conversion of direction vectors to joint rotations of the `ha2g` armature, and back (decision D10)."""

import numpy as np

from ha2g_jax.motion import armature as armatures
from ha2g_jax.motion import rotations
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.solver.bounds import clamp, without_jumps
from ha2g_jax.motion.solver.frames import pointed, solve
from ha2g_jax.motion.solver.twist import FrameByFrame, Twists
from ha2g_jax.skeleton import Skeleton

__all__ = ["Solver", "animate", "directions_of"]


def animate(motion: Motion, *, limits: bool = True) -> armatures.Animation:
    """Convert a motion to rotations of the joints of the `ha2g` armature.

    Each bone has exactly its direction. The rotation of a bone about its own length (its twist) is not in the
    direction; it is estimated from the bones around it: that of the trunk from the shoulders, of the head from the
    face, of the upper arm from the bend of the elbow, of the forearm from the palm, of a finger from its bend. Where
    these do not show it, as at a straight arm, the twist is held over time.

    Args:
        limits: whether to keep twists and hands within the range of a human body; directions are exact all the same.

    Returns:
        An animation whose root does not move; with pelvis and legs (`Motion.lower`) the root is the pelvis, which does.
        The signs of its quaternions are continuous over time.

    Raises:
        UserError: the motion is not valid, see `Motion.check`.
    """
    motion.check()
    skeleton = motion.skeleton
    armature = armatures.ha2g_armature(skeleton)
    directions = rotations.unit(motion.directions) * armatures.export_axes(skeleton)
    local = solve(skeleton, armature, directions, Twists(motion.fps))
    if limits:
        local = pointed(skeleton, armature, directions, local, without_jumps(local, clamp(armature, local)))
    local = rotations.continuous(rotations.unit(local))
    animation = armatures.Animation(armature, local, np.zeros((len(local), 3)), motion.fps, motion.meta)
    return animation if motion.lower is None else armatures.add_lower_body(animation, motion.lower)


class Solver:
    """The conversion of `animate` for frames that arrive one after the other; a frame does not depend on later ones.

    A frame is converted like the last frame of a motion that ends with it. `animate` also uses later frames where a
    twist is not clearly visible.
    """

    def __init__(self, skeleton: Skeleton, fps: float) -> None:
        self.armature = armatures.ha2g_armature(skeleton)
        self._skeleton, self._fps = skeleton, fps
        self._axes = armatures.export_axes(skeleton)
        self._twists = FrameByFrame(fps)
        self._last: np.ndarray | None = None  # (3, J, 4) of the last frame: free, within the limits, returned

    def animate(self, directions: np.ndarray) -> armatures.Animation:
        """Convert the next frames, (n, bones, 3) unit vectors; the signs of the quaternions continue those before."""
        directions = rotations.unit(directions) * self._axes
        free = solve(self._skeleton, self.armature, directions, self._twists)
        kept = clamp(self.armature, free)
        if self._last is None:
            kept, before = without_jumps(free, kept), None
        else:
            free_before, kept_before, before = self._last
            kept = without_jumps(np.stack([free_before, *free]), np.stack([kept_before, *kept]))[1:]
        local = pointed(self._skeleton, self.armature, directions, free, kept)
        local = rotations.continuous(rotations.unit(local), before)
        self._last = np.stack([free[-1], kept[-1], local[-1]])
        return armatures.Animation(self.armature, local, np.zeros((len(local), 3)), self._fps, {})


def directions_of(animation: armatures.Animation, skeleton: Skeleton) -> np.ndarray:
    """Convert an animation of the `ha2g` armature to (T, bones, 3) unit vectors, the inverse of `animate`."""
    rotated, _ = armatures.world(animation)
    joints = [animation.armature.joint(name) for name in armatures.carriers(skeleton)]
    rest = armatures.rest_directions(skeleton)
    return rotations.rotate(rotated[:, joints], rest) * armatures.export_axes(skeleton)

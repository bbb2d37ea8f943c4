"""Rotations of the joints of the `ha2g` armature that give each bone its direction."""

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import LEFT, UP, Armature, carriers, rest_directions
from ha2g_jax.motion.solver.arms import Vectors, arm_frames
from ha2g_jax.motion.solver.fitting import fit
from ha2g_jax.motion.solver.twist import apply_twist, observe, transport
from ha2g_jax.skeleton import Skeleton

_FACE = ("nose", "head", "left_eye", "right_eye", "left_ear", "right_ear")
_AHEAD = 2e-5  # weight of facing ahead; a twist that is clearly visible has weight 1


def solve(skeleton: Skeleton, armature: Armature, directions: np.ndarray, fps: float) -> np.ndarray:
    """Compute rotations of the joints of an armature relative to their parents.

    The twist of trunk, head, arms, hands and knuckles is estimated from the bones around them; all other bones only
    swing.

    Args:
        skeleton: skeleton of the directions.
        armature: `ha2g_armature` of the skeleton, with J joints.
        directions: (T, bones, 3) unit vectors in the axes of the armature.
        fps: frames per second.

    Returns:
        (T, J, 4) rotations.
    """
    names = [skeleton.joints[child] for _, child in skeleton.bones]
    seen = {name: directions[:, bone] for bone, name in enumerate(names)}
    rest = dict(zip(names, rest_directions(skeleton), strict=True))
    carried = dict(zip(carriers(skeleton), names, strict=True))
    frames = {"spine": trunk_frame(seen, fps)}
    frames |= head_frames(skeleton, seen, rest, frames["spine"], fps)
    for side in ("left", "right"):
        frames |= arm_frames(side, seen, rest, frames["spine"], fps)
    local = np.empty((len(directions), len(armature.joints), 4))
    rotated = np.empty_like(local)
    for joint, (name, parent) in enumerate(zip(armature.joints, armature.parents, strict=True)):
        above = rotated[:, parent] if joint else rotations.IDENTITY
        if name in frames:
            local[:, joint] = rotations.multiply(rotations.conjugate(above), frames[name])
        elif name in carried:
            bone = carried[name]
            direction = rotations.rotate(rotations.conjugate(above), seen[bone])
            local[:, joint] = rotations.between(rest[bone], direction)
        else:
            local[:, joint] = rotations.IDENTITY
        rotated[:, joint] = rotations.multiply(above, local[:, joint])
    return local


def trunk_frame(seen: Vectors, fps: float) -> np.ndarray:
    """Compute rotations (T, 4) of the trunk: upright along the spine, facing as the shoulders do.

    Args:
        seen: (T, 3) unit vectors of the bones, by the name of the joint at their end.
        fps: frames per second.
    """
    upright = np.tile(rotations.IDENTITY, (len(seen["neck"]), 1))
    frames = transport(upright, UP, seen["neck"])
    shoulders = seen["left_shoulder"] - seen["right_shoulder"]
    observations = observe(frames, UP, LEFT, shoulders, np.sum(shoulders**2, axis=-1) / 4)
    return apply_twist(
        frames, UP, observations + observe(frames, UP, LEFT, np.broadcast_to(LEFT, shoulders.shape), _AHEAD), fps
    )


def head_frames(skeleton: Skeleton, seen: Vectors, rest: Vectors, trunk: np.ndarray, fps: float) -> Vectors:
    """Compute rotations (T, 4) of the joint that rotates the head, by its name, with the twist of the face.

    Args:
        skeleton: skeleton of the directions.
        seen: (T, 3) unit vectors of the bones, by the name of the joint at their end.
        rest: (3,) unit vectors of the same bones at rest.
        trunk: (T, 4) rotations of the trunk.
        fps: frames per second.
    """
    axis = rest["nose"]
    frames = transport(trunk, axis, seen["nose"])
    face = [name for name in _FACE if name in rest]
    fitted, certainty = fit([seen[name] for name in face], [rest[name] for name in face])
    observations = observe(frames, axis, LEFT, rotations.rotate(fitted, LEFT), certainty**2)
    observations = observations + observe(frames, axis, LEFT, rotations.rotate(trunk, LEFT), _AHEAD)
    return {carriers(skeleton)[skeleton.bone("nose")]: apply_twist(frames, axis, observations, fps)}

"""How each joint of the `ha2g` armature is turned, so that each bone has its direction."""

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import LEFT, UP, Armature, carriers, rest_directions
from ha2g_jax.motion.solver.arms import Vectors, arm_frames
from ha2g_jax.motion.solver.fitting import fit
from ha2g_jax.motion.solver.twist import carry, follow, sight
from ha2g_jax.skeleton import Skeleton

_FACE = ("nose", "head", "left_eye", "right_eye", "left_ear", "right_ear")
_AHEAD = 2e-5  # weight of facing ahead, beside 1 for what is seen


def solve(skeleton: Skeleton, armature: Armature, directions: np.ndarray, fps: float) -> np.ndarray:
    """Rotations of the armature's joints relative to their parents.

    Trunk, head, arms, hands and knuckles have a twist that is seen in the bones around them; all other bones swing.

    Args:
        skeleton: of the directions.
        armature: of the skeleton.
        directions: (T, bones, 3) unit vectors in the armature's axes.
        fps: frames per second.

    Returns:
        (T, J, 4).
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
    turned = np.empty_like(local)
    for joint, (name, parent) in enumerate(zip(armature.joints, armature.parents, strict=True)):
        above = turned[:, parent] if joint else rotations.IDENTITY
        if name in frames:
            local[:, joint] = rotations.multiply(rotations.conjugate(above), frames[name])
        elif name in carried:
            bone = carried[name]
            way = rotations.rotate(rotations.conjugate(above), seen[bone])
            local[:, joint] = rotations.between(rest[bone], way)
        else:
            local[:, joint] = rotations.IDENTITY
        turned[:, joint] = rotations.multiply(above, local[:, joint])
    return local


def trunk_frame(seen: Vectors, fps: float) -> np.ndarray:
    """(T, 4): upright along the spine, facing as the shoulders do."""
    upright = np.tile(rotations.IDENTITY, (len(seen["neck"]), 1))
    frames = carry(upright, UP, seen["neck"])
    shoulders = seen["left_shoulder"] - seen["right_shoulder"]
    sights = sight(frames, UP, LEFT, shoulders, np.sum(shoulders**2, axis=-1) / 4)
    return follow(frames, UP, sights + sight(frames, UP, LEFT, np.broadcast_to(LEFT, shoulders.shape), _AHEAD), fps)


def head_frames(skeleton: Skeleton, seen: Vectors, rest: Vectors, trunk: np.ndarray, fps: float) -> Vectors:
    """(T, 4) of the joint that carries the nose, by its name: turned about the nose's bone as the face is."""
    axis = rest["nose"]
    frames = carry(trunk, axis, seen["nose"])
    face = [name for name in _FACE if name in rest]
    fitted, surety = fit([seen[name] for name in face], [rest[name] for name in face])
    sights = sight(frames, axis, LEFT, rotations.rotate(fitted, LEFT), surety**2)
    sights = sights + sight(frames, axis, LEFT, rotations.rotate(trunk, LEFT), _AHEAD)
    return {carriers(skeleton)[skeleton.bone("nose")]: follow(frames, axis, sights, fps)}

"""Rotations of the joints of the `ha2g` armature that give each bone its direction."""

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import LEFT, UP, Armature, carriers, generations, rest_directions
from ha2g_jax.motion.solver.arms import Vectors, arm_frames
from ha2g_jax.motion.solver.fitting import fit
from ha2g_jax.motion.solver.twist import Twists, apply_twist, observe
from ha2g_jax.skeleton import Skeleton

_FACE = ("nose", "head", "left_eye", "right_eye", "left_ear", "right_ear")
_AHEAD = 2e-5  # weight of facing ahead; a twist that is clearly visible has weight 1


def solve(skeleton: Skeleton, armature: Armature, directions: np.ndarray, twists: Twists) -> np.ndarray:
    """Compute rotations of the joints of an armature relative to their parents.

    The twist of trunk, head, arms, hands and knuckles is estimated from the bones around them; all other bones only
    swing.

    Args:
        skeleton: skeleton of the directions.
        armature: `ha2g_armature` of the skeleton, with J joints.
        directions: (T, bones, 3) unit vectors in the axes of the armature.
        twists: estimates of the twists over time.

    Returns:
        (T, J, 4) rotations.
    """
    names = [skeleton.joints[child] for _, child in skeleton.bones]
    seen = {name: directions[:, bone] for bone, name in enumerate(names)}
    rest_vectors = rest_directions(skeleton)
    rest = dict(zip(names, rest_vectors, strict=True))
    frames = {"spine": trunk_frame(seen, twists)}
    frames |= head_frames(skeleton, seen, rest, frames["spine"], twists)
    for side in ("left", "right"):
        frames |= arm_frames(side, seen, rest, frames["spine"], twists)
    carried = {name: bone for bone, name in enumerate(carriers(skeleton)) if name not in frames}
    local = np.tile(rotations.IDENTITY, (len(directions), len(armature.joints), 1))
    rotated = local.copy()
    for joints, parents in generations(armature.parents):
        above = rotated[:, parents] if parents[0] >= 0 else rotated[:, joints]
        back = rotations.conjugate(above)
        group = [armature.joints[joint] for joint in joints]
        if bones := [carried[name] for name in group if name in carried]:
            places = [place for place, name in enumerate(group) if name in carried]
            swung = rotations.rotate(back[:, places], directions[:, bones])
            local[:, joints[places]] = rotations.between(rest_vectors[bones], swung)
        for place, name in enumerate(group):
            if name in frames:
                local[:, joints[place]] = rotations.multiply(back[:, place], frames[name])
        rotated[:, joints] = rotations.multiply(above, local[:, joints])
    return local


def trunk_frame(seen: Vectors, twists: Twists) -> np.ndarray:
    """Compute rotations (T, 4) of the trunk: upright along the spine, facing as the shoulders do.

    Args:
        seen: (T, 3) unit vectors of the bones, by the name of the joint at their end.
        twists: estimates of the twists over time.
    """
    upright = np.tile(rotations.IDENTITY, (len(seen["neck"]), 1))
    frames = twists.transport("spine", upright, UP, seen["neck"])
    shoulders = seen["left_shoulder"] - seen["right_shoulder"]
    observations = observe(frames, UP, LEFT, shoulders, np.sum(shoulders**2, axis=-1) / 4)
    observations = observations + observe(frames, UP, LEFT, np.broadcast_to(LEFT, shoulders.shape), _AHEAD)
    return apply_twist(frames, UP, twists.smooth("spine", observations))


def head_frames(skeleton: Skeleton, seen: Vectors, rest: Vectors, trunk: np.ndarray, twists: Twists) -> Vectors:
    """Compute rotations (T, 4) of the joint that rotates the head, by its name, with the twist of the face.

    Args:
        skeleton: skeleton of the directions.
        seen: (T, 3) unit vectors of the bones, by the name of the joint at their end.
        rest: (3,) unit vectors of the same bones at rest.
        trunk: (T, 4) rotations of the trunk.
        twists: estimates of the twists over time.
    """
    joint, axis = carriers(skeleton)[skeleton.bone("nose")], rest["nose"]
    frames = twists.transport(joint, trunk, axis, seen["nose"])
    face = [name for name in _FACE if name in rest]
    fitted, certainty = fit([seen[name] for name in face], [rest[name] for name in face])
    observations = observe(frames, axis, LEFT, rotations.rotate(fitted, LEFT), certainty**2)
    observations = observations + observe(frames, axis, LEFT, rotations.rotate(trunk, LEFT), _AHEAD)
    return {joint: apply_twist(frames, axis, twists.smooth(joint, observations))}

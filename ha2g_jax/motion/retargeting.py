"""Transfer of an animation of the `ha2g` armature to another rig."""

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, world
from ha2g_jax.motion.rigs import OTHER_NAMES, Rig, rest_positions


def retarget(animation: Animation, rig: Rig) -> Animation:
    """Transfer an animation of the `ha2g` armature to another rig.

    Joints that carry a `ha2g` joint take its rotation in the world. Bones between joints that have the places of
    `ha2g` joints point in the same directions as there. So the positions of those joints relative to the chest are
    the same where the rig takes the motion's bone lengths, except for the knuckles of rigs without bones in the palm,
    whose hand is rigid, and for joints below a bone of the table's own length. The joints of the spine divide the
    rotation of the chest, so that the chest moves a little. Hips and legs stay in the rest pose and stand on the
    ground, y = 0.

    Args:
        animation: animation of the `ha2g` armature.
        rig: rig to transfer it to; for "ha2g" the result is the animation itself.

    Returns:
        Animation of an armature that has the name of the rig.
    """
    if rig.name == animation.armature.name:
        return animation
    places, to_rest, rest = _rest_pose(animation.armature, rig)
    parents = tuple(joint.parent for joint in rig.joints)
    armature = _armature(rig, places, rest)
    sources, _ = world(animation)
    found = [_source(animation.armature, joint.carries) for joint in rig.joints]
    rotated = np.empty((animation.num_frames, len(rig.joints), 4))
    local = np.empty_like(rotated)
    # The rotation of the nearest joint above with weight 1, from which a smaller weight is counted.
    whole: list[np.ndarray] = []
    for index, (joint, parent, source) in enumerate(zip(rig.joints, parents, found)):
        above = whole[parent] if parent >= 0 else rotations.IDENTITY
        if source is None:
            whole.append(above)
            local[:, index] = armature.rest[index]
        else:
            full = sources[:, source]
            rotation = full if joint.weight == 1 else rotations.slerp(above, full, np.array(joint.weight))
            whole.append(rotation if joint.weight == 1 else np.broadcast_to(above, full.shape))
            target = rotations.multiply(rotation, rotations.multiply(rotations.conjugate(to_rest[index]), rest[index]))
            local[:, index] = _relative(rotated[:, parent], target) if parent >= 0 else target
        rotated[:, index] = rotations.multiply(rotated[:, parent], local[:, index]) if parent >= 0 else local[:, index]
    local = rotations.continuous(rotations.unit(local))
    return Animation(armature, local, places[0] + animation.translation, animation.fps, animation.meta)


def _rest_pose(armature: Armature, rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rig's rest pose: (J, 3) positions, (J, 4) rotations from the T-pose, and (J, 4) orientations."""
    _, ours = rest_positions(armature)
    straight = _t_pose(armature, ours, rig)
    children = [next((i for i, joint in enumerate(rig.joints) if joint.parent == k), k) for k in range(len(rig.joints))]
    to_rest = np.tile(rotations.IDENTITY, (len(rig.joints), 1))
    at_rest = np.zeros((len(rig.joints), 3))
    for index, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            to_rest[index] = to_rest[joint.parent]
        if joint.t_pose is not None:
            to_rest[index] = rotations.multiply(joint.rest, rotations.conjugate(joint.t_pose))
        elif joint.direction is not None:
            bone = rotations.rotate(to_rest[index], straight[children[index]] - straight[index])
            if np.linalg.norm(bone) > 0:
                to_rest[index] = rotations.multiply(rotations.between(bone, joint.direction), to_rest[index])
        if joint.parent < 0:
            at_rest[index] = straight[index]
        elif rig.has_own_lengths:
            at_rest[index] = at_rest[joint.parent] + joint.offset
        else:
            bone = rotations.rotate(to_rest[joint.parent], straight[index] - straight[joint.parent])
            at_rest[index] = at_rest[joint.parent] + bone
    return at_rest, to_rest, np.array([joint.rest for joint in rig.joints])


def _t_pose(armature: Armature, ours: np.ndarray, rig: Rig) -> np.ndarray:
    """Return (J, 3) positions of the rig's joints in the T-pose, with the motion's lengths where it has the joints."""
    straight = np.zeros((len(rig.joints), 3))
    shift = None
    for index, joint in enumerate(rig.joints):
        above = straight[joint.parent] if joint.parent >= 0 else np.zeros(3)
        straight[index] = above + joint.offset
        if joint.place in armature.joints:
            place = ours[armature.joint(joint.place)]
            shift = straight[index] - place if shift is None else shift
            straight[index] = place + shift
    return straight


def _armature(rig: Rig, at_rest: np.ndarray, rest: np.ndarray) -> Armature:
    """Return the armature of a rig from (J, 3) positions and (J, 4) orientations at rest."""
    offsets, local = np.zeros_like(at_rest), rest.copy()
    for index, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            back = rotations.conjugate(rest[joint.parent])
            offsets[index] = rotations.rotate(back, at_rest[index] - at_rest[joint.parent])
            local[index] = rotations.multiply(back, rest[index])
    names = tuple(joint.name for joint in rig.joints)
    return Armature(rig.name, names, tuple(joint.parent for joint in rig.joints), offsets, local)


def _source(armature: Armature, name: str | None) -> int | None:
    """Return the index of the joint that rotates as the `ha2g` joint `name`, or None without such a joint."""
    name = OTHER_NAMES.get(name or "", name) if OTHER_NAMES.get(name or "") in armature.joints else name
    return armature.joint(name) if name in armature.joints else None


def _relative(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    return rotations.multiply(rotations.conjugate(parent), child)

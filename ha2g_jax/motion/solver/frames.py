"""Rotations of the joints of the `ha2g` armature that give each bone its direction.

The twist of a bone follows from the bend of the next bone, that of the forearm from the palm. At rest all bones of an
arm lie along it with the palm down, so that an elbow bends forward, a finger down, and the thumb lies in front. FORWARD
is the mark from which the twist of the arm is observed, and -UP that of the fingers.
"""

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import FOUR_FINGERS, LEFT, UP, Armature, carriers, generations, rest_directions
from ha2g_jax.motion.smoothing import smoothstep
from ha2g_jax.motion.solver.twist import Twists, apply_twist, observe, swing
from ha2g_jax.skeleton import Skeleton

FORWARD = np.array([0.0, 0.0, 1.0])

Vectors = dict[str, np.ndarray]

# A joint bent at right angles has weight 1. The weight of a bend is the fourth power of its sine, because the plane of
# a slight bend is uncertain.
_HANGING = 2e-5
_STRAIGHT = 3e-3

# A bend below the first sine may be a straight elbow that noise bends backward; one above the second is a real bend.
_SLIGHT = (0.34, 0.57)

# The twist of a forearm is 0 at the elbow and that of the hand at the wrist. As one bone it takes half of it, as in
# Unity (HumanDescription.lowerArmTwist is 0.5). The elbow has a little more weight than the hand, so that a hand
# twisted by 180 degrees gives a twist of 0, and not of 90 degrees to either side.
_ELBOW_WEIGHT = 1.1

_FACE = ("nose", "head", "left_eye", "right_eye", "left_ear", "right_ear")
_AHEAD = 2e-5  # weight of facing ahead; a twist that is clearly visible has weight 1


def _arm_frames(side: str, seen: Vectors, rest: Vectors, trunk: np.ndarray, twists: Twists) -> Vectors:
    """Compute rotations (T, 4) of an arm from its bones, seen (T, 3) and at rest, by the joint at their end."""
    out = LEFT if side == "left" else -LEFT
    upper, fore = seen[f"{side}_elbow"], seen[f"{side}_wrist"]
    shoulder = _upper_arm(f"{side}_shoulder", trunk, out, upper, fore, twists)
    neutral = _bend_elbow(shoulder, out, fore)
    if f"{side}_index_1" not in rest:
        return {f"{side}_shoulder": shoulder, f"{side}_elbow": neutral}
    bones = [f"{side}_{finger}_1" for finger in FOUR_FINGERS]
    palm, certainty = _fit(bones, seen, rest)
    hand = _hand(f"{side}_wrist", neutral, out, palm, certainty, twists)
    elbow = _forearm(f"{side}_elbow", neutral, out, fore, hand, twists)
    frames = {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": hand}
    for finger in FOUR_FINGERS:
        first, second = seen[f"{side}_{finger}_2"], seen[f"{side}_{finger}_3"]
        knuckle = f"{side}_{finger}_1"
        frames[knuckle] = _knuckle(knuckle, hand, out, first, second, twists)
    return frames


def _fit(bones: list[str], seen: Vectors, rest: Vectors) -> tuple[np.ndarray, np.ndarray]:
    return rotations.fit(np.stack([seen[bone] for bone in bones], axis=1), np.stack([rest[bone] for bone in bones]))


def _upper_arm(
    joint: str, trunk: np.ndarray, out: np.ndarray, upper: np.ndarray, fore: np.ndarray, twists: Twists
) -> np.ndarray:
    """Rotate the upper arm so that the elbow bends forward; a straight arm as if raised from beside the trunk."""
    frames = twists.transport(joint, trunk, out, upper)
    hanging = rotations.multiply(trunk, rotations.between(out, -UP))
    front = rotations.rotate(swing(hanging, out, upper), FORWARD)
    bend, sine = _bend(upper, fore)
    is_slight = 1 - smoothstep(sine, *_SLIGHT)
    is_backward = smoothstep(-np.sum(bend * front, axis=-1), -0.3, 0.2)
    seen = observe(frames, out, FORWARD, bend, sine**4 * (1 - is_slight * is_backward))
    seen = seen + observe(frames, out, FORWARD, front, _HANGING)
    return apply_twist(frames, out, twists.smooth(joint, seen))


def _bend_elbow(shoulder: np.ndarray, out: np.ndarray, fore: np.ndarray) -> np.ndarray:
    """Rotate the forearm without twist: bend it about the axis of the elbow, then swing it by the small remainder."""
    local = rotations.rotate(rotations.conjugate(shoulder), fore)
    angle = np.arctan2(local @ FORWARD, local @ out)
    bent = rotations.multiply(shoulder, rotations.about(np.cross(out, FORWARD), angle))
    return swing(bent, out, fore)


def _hand(
    joint: str, neutral: np.ndarray, out: np.ndarray, palm: np.ndarray, certainty: np.ndarray, twists: Twists
) -> np.ndarray:
    """Rotate the hand as the palm where its bones are spread, and hold its twist where they are not."""
    frames = swing(neutral, out, rotations.rotate(palm, out))
    seen = observe(frames, out, FORWARD, rotations.rotate(palm, FORWARD), certainty**2)
    return apply_twist(frames, out, twists.smooth(joint, seen + _HANGING))


def _forearm(
    joint: str, neutral: np.ndarray, out: np.ndarray, fore: np.ndarray, hand: np.ndarray, twists: Twists
) -> np.ndarray:
    """Twist the forearm half-way to the hand, whose axis to the thumb stays at right angles to the forearm."""
    thumb = rotations.rotate(hand, FORWARD)
    sine_squared = 1 - np.sum(thumb * fore, axis=-1) ** 2
    seen = (observe(neutral, out, FORWARD, thumb, 1.0) + _ELBOW_WEIGHT) * sine_squared
    return apply_twist(neutral, out, twists.smooth(joint, seen + _HANGING))


def _knuckle(
    joint: str, hand: np.ndarray, out: np.ndarray, first: np.ndarray, second: np.ndarray, twists: Twists
) -> np.ndarray:
    """Rotate the first bone of a finger so that the next joint, a hinge, bends towards the palm."""
    frames = swing(hand, out, first)
    bend, sine = _bend(first, second)
    is_palmward = smoothstep(np.sum(bend * rotations.rotate(frames, -UP), axis=-1), 0.0, 0.5)
    seen = observe(frames, out, -UP, bend, sine**4 * is_palmward)
    return apply_twist(frames, out, twists.smooth(joint, seen + _STRAIGHT))


def _bend(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, 3) unit vectors across the first bone towards the second, and the (T,) sine of the bend."""
    across = second - np.sum(second * first, axis=-1, keepdims=True) * first
    return rotations.unit(across), np.linalg.norm(across, axis=-1)


def solve(skeleton: Skeleton, armature: Armature, directions: np.ndarray, twists: Twists) -> np.ndarray:
    """Compute rotations (T, J, 4) of the joints of the `ha2g_armature` of a skeleton relative to their parents.

    The twist of trunk, head, arms, hands and knuckles is estimated from the bones around them; all other bones only
    swing. The directions (T, bones, 3) are unit vectors in the axes of the armature.
    """
    names = [skeleton.joints[child] for _, child in skeleton.bones]
    seen = {name: directions[:, bone] for bone, name in enumerate(names)}
    rest_vectors = rest_directions(skeleton)
    rest = dict(zip(names, rest_vectors, strict=True))
    frames = {"spine": _trunk_frame(seen, twists)}
    frames |= _head_frames(skeleton, seen, rest, frames["spine"], twists)
    for side in ("left", "right"):
        frames |= _arm_frames(side, seen, rest, frames["spine"], twists)
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


def pointed(
    skeleton: Skeleton, armature: Armature, directions: np.ndarray, free: np.ndarray, kept: np.ndarray
) -> np.ndarray:
    """Swing joints that were clamped so that each bone has its direction again; twists and hands stay as they are.

    Frames in which nothing was clamped, the rotations `kept` (T, J, 4) of the solution `free`, do not change.
    """
    is_changed = (kept != free).any(axis=(1, 2))
    local, along = kept[is_changed], directions[is_changed]
    rotated, rest = np.empty_like(local), rest_directions(skeleton)
    carried = {armature.joint(name): bone for bone, name in enumerate(carriers(skeleton))}
    for joints, parents in generations(armature.parents):
        above = rotated[:, parents] if parents[0] >= 0 else rotations.IDENTITY
        rotated[:, joints] = rotations.multiply(above, local[:, joints])
        turning = [joint for joint in joints.tolist() if joint in carried]
        bones = [carried[joint] for joint in turning]
        rotated[:, turning] = swing(rotated[:, turning], rest[bones], along[:, bones])
        local[:, joints] = rotations.multiply(rotations.conjugate(above), rotated[:, joints])
    result = kept.copy()
    result[is_changed] = local
    return result


def _trunk_frame(seen: Vectors, twists: Twists) -> np.ndarray:
    """Compute rotations (T, 4) of the trunk: upright along the spine, facing as the shoulders do."""
    upright = np.tile(rotations.IDENTITY, (len(seen["neck"]), 1))
    frames = twists.transport("spine", upright, UP, seen["neck"])
    shoulders = seen["left_shoulder"] - seen["right_shoulder"]
    observations = observe(frames, UP, LEFT, shoulders, np.sum(shoulders**2, axis=-1) / 4)
    observations = observations + observe(frames, UP, LEFT, np.broadcast_to(LEFT, shoulders.shape), _AHEAD)
    return apply_twist(frames, UP, twists.smooth("spine", observations))


def _head_frames(skeleton: Skeleton, seen: Vectors, rest: Vectors, trunk: np.ndarray, twists: Twists) -> Vectors:
    """Compute rotations (T, 4) of the joint that rotates the head, by its name, with the twist of the face."""
    joint, axis = carriers(skeleton)[skeleton.bone("nose")], rest["nose"]
    frames = twists.transport(joint, trunk, axis, seen["nose"])
    face = [name for name in _FACE if name in rest]
    fitted, certainty = _fit(face, seen, rest)
    observations = observe(frames, axis, LEFT, rotations.rotate(fitted, LEFT), certainty**2)
    observations = observations + observe(frames, axis, LEFT, rotations.rotate(trunk, LEFT), _AHEAD)
    return {joint: apply_twist(frames, axis, twists.smooth(joint, observations))}

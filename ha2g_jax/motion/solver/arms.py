"""Upper arm, forearm, hand and knuckles: the twist of one bone from the bend of the next, the forearm's from the palm.

All bones lie along the arm at rest, palm down, so that an elbow bends forward, a finger down, and the thumb lies in
front. FORWARD is the mark whose sight tells the twist of the arm, and -UP that of the fingers.
"""

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import FOUR_FINGERS, LEFT, UP
from ha2g_jax.motion.solver.fitting import fit
from ha2g_jax.motion.solver.twist import carry, follow, sight, swing

FORWARD = np.array([0.0, 0.0, 1.0])

Vectors = dict[str, np.ndarray]

# Weights beside 1, that of a joint bent at right angles; a bend's is the fourth power of its sine, because where it is
# slight its plane is uncertain.
_HANGING = 2e-5
_STRAIGHT = 3e-3

# A bend below the first sine may be a straight elbow that noise bends backward; above the second it is none.
_SLIGHT = (0.34, 0.57)

# A forearm turns by nothing at the elbow and by all that the hand does at the wrist. As one bone it turns by half, as
# in Unity (HumanDescription.lowerArmTwist is 0.5). The elbow counts a little more than the hand, so that a hand turned
# right round gives no turn, and not half a turn to either side.
_ELBOW_SHARE = 1.1


def arm_frames(side: str, seen: Vectors, rest: Vectors, trunk: np.ndarray, fps: float) -> Vectors:
    """Rotations (T, 4) in the world of the joints of one arm whose twist shows.

    Args:
        side: "left" or "right".
        seen: (T, 3) unit vectors of the bones by the joint at their end.
        rest: (3,) the same at rest.
        trunk: (T, 4) rotations of the trunk.
        fps: frames per second.

    Returns:
        The rotations by the name of the joint: shoulder, elbow and, where there are fingers, wrist and knuckles.
    """
    out = LEFT if side == "left" else -LEFT
    upper, fore = seen[f"{side}_elbow"], seen[f"{side}_wrist"]
    shoulder = _upper_arm(trunk, out, upper, fore, fps)
    neutral = _bend_elbow(shoulder, out, fore)
    if f"{side}_index_1" not in rest:
        return {f"{side}_shoulder": shoulder, f"{side}_elbow": neutral}
    bones = [f"{side}_{finger}_1" for finger in FOUR_FINGERS]
    palm, surety = fit([seen[bone] for bone in bones], [rest[bone] for bone in bones])
    hand = _hand(neutral, out, palm, surety, fps)
    elbow = _forearm(neutral, out, fore, hand, fps)
    frames = {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": hand}
    for finger in FOUR_FINGERS:
        first, second = seen[f"{side}_{finger}_2"], seen[f"{side}_{finger}_3"]
        frames[f"{side}_{finger}_1"] = _knuckle(hand, out, first, second, fps)
    return frames


def _upper_arm(trunk: np.ndarray, out: np.ndarray, upper: np.ndarray, fore: np.ndarray, fps: float) -> np.ndarray:
    """Turned so that the elbow bends forward; a straight arm like one that was raised from hanging beside the trunk."""
    frames = carry(trunk, out, upper)
    hanging = rotations.multiply(trunk, rotations.between(out, -UP))
    front = rotations.rotate(swing(hanging, out, upper), FORWARD)
    bend, sine = _bend(upper, fore)
    is_slight = 1 - _step(sine, *_SLIGHT)
    is_backward = _step(-np.sum(bend * front, axis=-1), -0.3, 0.2)
    seen = sight(frames, out, FORWARD, bend, sine**4 * (1 - is_slight * is_backward))
    return follow(frames, out, seen + sight(frames, out, FORWARD, front, _HANGING), fps)


def _bend_elbow(shoulder: np.ndarray, out: np.ndarray, fore: np.ndarray) -> np.ndarray:
    """The forearm without a twist of its own: bent about the elbow's axis, and swung the little that is left."""
    local = rotations.rotate(rotations.conjugate(shoulder), fore)
    angle = np.arctan2(local @ FORWARD, local @ out)
    bent = rotations.multiply(shoulder, rotations.about(np.cross(out, FORWARD), angle))
    return swing(bent, out, fore)


def _hand(neutral: np.ndarray, out: np.ndarray, palm: np.ndarray, surety: np.ndarray, fps: float) -> np.ndarray:
    """As the palm, where its bones are spread; its turn about the forearm held where they are not."""
    frames = swing(neutral, out, rotations.rotate(palm, out))
    seen = sight(frames, out, FORWARD, rotations.rotate(palm, FORWARD), surety**2)
    return follow(frames, out, seen + _HANGING, fps)


def _forearm(neutral: np.ndarray, out: np.ndarray, fore: np.ndarray, hand: np.ndarray, fps: float) -> np.ndarray:
    """Turned half-way from the elbow to the hand.

    A hand bends up and down about its axis to the thumb, which stays at right angles to the forearm, and only little to
    the sides: so it is that axis which shows the turn, however far the hand is bent.
    """
    thumb = rotations.rotate(hand, FORWARD)
    sine_squared = 1 - np.sum(thumb * fore, axis=-1) ** 2
    seen = (sight(neutral, out, FORWARD, thumb, 1.0) + _ELBOW_SHARE) * sine_squared
    return follow(neutral, out, seen + _HANGING, fps)


def _knuckle(hand: np.ndarray, out: np.ndarray, first: np.ndarray, second: np.ndarray, fps: float) -> np.ndarray:
    """The first bone of a finger, turned so that the next joint, a hinge, bends towards the palm."""
    frames = swing(hand, out, first)
    bend, sine = _bend(first, second)
    is_palmward = _step(np.sum(bend * rotations.rotate(frames, -UP), axis=-1), 0.0, 0.5)
    seen = sight(frames, out, -UP, bend, sine**4 * is_palmward)
    return follow(frames, out, seen + _STRAIGHT, fps)


def _bend(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) unit vectors across the first bone to where the second bends, and (T,) the sine of the bend."""
    across = second - np.sum(second * first, axis=-1, keepdims=True) * first
    return rotations.unit(across), np.linalg.norm(across, axis=-1)


def _step(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 up to `low`, 1 from `high`, smooth between."""
    share = np.clip((x - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)

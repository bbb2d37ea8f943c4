"""Meshes of the arms of the body: a sleeve from the shoulder to the cuff, palm and fingers."""

import itertools

import numpy as np

from ha2g_jax.motion.formats.surfaces import Surface, loft, tube
from ha2g_jax.motion.rotations import unit

_FOUR = ("index", "middle", "ring", "pinky")
_RADII = {"thumb": 0.0125, "index": 0.0103, "middle": 0.0107, "ring": 0.0102, "pinky": 0.0088}
_TIPS = {"thumb": 0.028, "index": 0.026, "middle": 0.028, "ring": 0.027, "pinky": 0.022}
_AHEAD = np.array([0.0, 0.0, 1.0])
_CUFF = 0.93  # fraction of the forearm that the sleeve covers


class Joints:
    """Positions of joints at rest by name, and the influence (J,) of the joint that rotates as each of them.

    Attributes:
        places: (3,) metres by the name of a `ha2g` joint.
        carriers: index of the joint that rotates as a `ha2g` joint does, by the name of the latter.
        scale: size of the body relative to that of the tables.
    """

    def __init__(self, places: dict[str, np.ndarray], carriers: dict[str, int], count: int, scale: float) -> None:
        self.places, self.carriers, self.scale = places, carriers, scale
        self._rows = np.eye(count)

    def __contains__(self, name: str) -> bool:
        return name in self.places

    def __getitem__(self, name: str) -> np.ndarray:
        return self.places[name]

    def moved_by(self, *names: str) -> np.ndarray:
        """Return (J,) influence that is 1 for the first of the named joints that the armature has, and 0 for others."""
        return self._rows[next(self.carriers[name] for name in names if name in self.carriers)]


def smooth(values: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return a smooth step of values of any shape: 0 up to `start`, 1 from `end` on."""
    fraction = np.clip((np.asarray(values) - start) / (end - start), 0, 1)
    return fraction * fraction * (3 - 2 * fraction)


def mix(first: np.ndarray, second: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Mix influences.

    Args:
        first: (J,) or (n, J) influence where the weight is 0.
        second: (J,) or (n, J) influence where the weight is 1.
        weight: (n,) weights from 0 to 1.

    Returns:
        (n, J) influence.
    """
    return (1 - weight)[:, None] * first + weight[:, None] * second


def arm(joints: Joints, side: str) -> tuple[Surface, list[Surface]]:
    """Build the surfaces of an arm.

    Args:
        joints: joints of the body at rest.
        side: "left" or "right".

    Returns:
        The sleeve, and the surfaces of the skin below it.
    """
    size = joints.scale
    shoulder, elbow, wrist = (joints[f"{side}_{part}"] for part in ("shoulder", "elbow", "wrist"))
    inside = shoulder + 0.075 * size * unit(np.array([-np.sign(shoulder[0]), -0.25, 0.0]))
    corners = np.array([inside, shoulder, elbow, wrist])
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.concatenate([np.linspace(0, lengths[1], 4), np.linspace(lengths[1], lengths[2], 15)[1:]])
    at = np.concatenate([at, np.linspace(lengths[2], lengths[2] + _CUFF * (lengths[3] - lengths[2]), 13)[1:]])
    path = _rounded_path(corners, lengths, at, 0.05 * size)
    where = [0, lengths[1], 0.5 * (lengths[1] + lengths[2]), lengths[2], lengths[2] + 0.3 * (lengths[3] - lengths[2])]
    radii = size * np.interp(at, [*where, lengths[3]], [0.058, 0.059, 0.053, 0.046, 0.045, 0.034])
    influence = mix(
        joints.moved_by(f"{side}_clavicle", "spine"),
        joints.moved_by(f"{side}_shoulder"),
        smooth(at, lengths[1] - 0.05 * size, lengths[1] + 0.06 * size),
    )
    bent = smooth(at, lengths[2] - 0.05 * size, lengths[2] + 0.07 * size)
    influence = (1 - bent)[:, None] * influence + bent[:, None] * joints.moved_by(f"{side}_elbow")
    sleeve = tube(path, radii, influence, _AHEAD, caps=(0.5, 0.0))
    skin = [_wrist(joints, side), _palm(joints, side)]
    if f"{side}_index_1" in joints:
        skin += [_finger(joints, side, finger) for finger in ("thumb", *_FOUR)]
    return sleeve, skin


def _rounded_path(corners: np.ndarray, lengths: np.ndarray, at: np.ndarray, reach: float) -> np.ndarray:
    """Return points (n, 3) at lengths `at` along a polyline, averaged over `reach` metres about each length."""

    def on_line(where: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(where, lengths, corners[:, axis]) for axis in range(3)], axis=-1)

    steps = np.linspace(-0.5, 0.5, 9) * reach
    middle = np.mean([on_line(np.clip(at + step, at[0], lengths[-1])) for step in steps], axis=0)
    middle[[0, -1]] = on_line(at[[0, -1]])
    return middle


def _wrist(joints: Joints, side: str) -> Surface:
    elbow, wrist = joints[f"{side}_elbow"], joints[f"{side}_wrist"]
    fraction = np.array([0.82, 0.88, 0.93, 0.97, 1.0, 1.04])
    path = elbow + fraction[:, None] * (wrist - elbow)
    radii = joints.scale * np.stack([[0.026, 0.025, 0.0235, 0.0225, 0.022, 0.022], [0.029] * 3 + [0.0285] * 3], axis=-1)
    weight = smooth(fraction, 0.93, 1.03)
    influence = mix(joints.moved_by(f"{side}_elbow"), joints.moved_by(f"{side}_wrist"), weight)
    return tube(path, radii, influence, _AHEAD)


def _palm(joints: Joints, side: str) -> Surface:
    """Build the palm from the wrist to the knuckles, or a whole flat hand where the armature has no fingers."""
    size, wrist = joints.scale, joints[f"{side}_wrist"]
    hand = joints.moved_by(f"{side}_wrist")
    if f"{side}_index_1" not in joints:
        along = unit(wrist - joints[f"{side}_elbow"])
        fraction = np.linspace(0, 1, 9)
        path = wrist + size * 0.17 * fraction[:, None] * along
        thick = size * np.interp(fraction, [0, 0.3, 1], [0.021, 0.017, 0.009])
        wide = size * np.interp(fraction, [0, 0.35, 0.6, 1], [0.029, 0.043, 0.042, 0.024])
        across = unit(_AHEAD - (_AHEAD @ along) * along)
        return loft(path, np.cross(along, across), across, np.stack([thick, wide], -1), np.tile(hand, (9, 1)))
    knuckles = np.array([joints[f"{side}_{finger}_1"] for finger in _FOUR])
    across = unit(knuckles[0] - knuckles[-1])
    middle = (knuckles[0] + knuckles[-1]) / 2 * 0.5 + knuckles[1:3].mean(axis=0) * 0.5
    across = unit(across - (across @ unit(middle - wrist)) * unit(middle - wrist))
    fraction = np.linspace(0, 1, 9)
    path = wrist + fraction[:, None] * (middle - wrist)
    half = 0.5 * float(np.linalg.norm(knuckles[0] - knuckles[-1])) + 0.008 * size
    wide = np.interp(fraction, [0, 0.25, 0.6, 1], [0.029 * size, 0.55 * half + 0.012 * size, 0.93 * half, half])
    thick = size * np.interp(fraction, [0, 0.4, 1], [0.022, 0.0185, 0.0125])
    along = unit(middle - wrist)
    sides = 20
    # Near the knuckles a point moves with the bones of the hand beside it.
    fingers = np.array([joints.moved_by(f"{side}_{finger}_0", f"{side}_wrist") for finger in _FOUR])
    at = half * np.sin(2 * np.pi * np.arange(sides) / sides)
    near = np.exp(-((at[:, None] - (knuckles - middle) @ across) ** 2) / (0.018 * size) ** 2)
    beside = (near / near.sum(axis=1, keepdims=True)) @ fingers
    late = smooth(fraction, 0.3, 1.0)[:, None, None]
    influence = (1 - late) * hand + late * beside
    radii = np.stack([thick, wide], axis=-1)
    return loft(path, np.cross(along, across), across, radii, influence, sides=sides, squareness=2.6, caps=(0.5, 0.25))


def _finger(joints: Joints, side: str, finger: str) -> Surface:
    size = joints.scale
    chain = np.array([joints[f"{side}_{finger}_{part}"] for part in (1, 2, 3)])
    wrist = joints[f"{side}_wrist"]
    below = chain[0] - wrist
    root = wrist + 0.35 * below if finger == "thumb" else chain[0] - 0.02 * size * unit(below)
    tip = chain[2] + size * (_TIPS[finger] - _RADII[finger] * 0.7) * unit(chain[2] - chain[1])
    corners = np.array([root, *chain, tip])
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.unique(np.concatenate([np.linspace(a, b, 6) for a, b in itertools.pairwise(lengths)]))
    path = _rounded_path(corners, lengths, at, 0.008 * size)
    shape = [1.55, 1.2, 1.02, 0.92, 0.74] if finger == "thumb" else [1.08, 1.1, 1.0, 0.92, 0.76]
    radii = size * _RADII[finger] * np.interp(at, lengths, shape)
    names = [f"{side}_{finger}_{part}" for part in range(4)]
    rows = [joints.moved_by(names[0], f"{side}_wrist"), *(joints.moved_by(*names[part:0:-1]) for part in (1, 2, 3))]
    influence = np.tile(rows[0], (len(at), 1))
    reach = 0.008 * size
    for row, length in zip(rows[1:], lengths[1:-1]):
        bent = smooth(at, length - reach, length + reach)[:, None]
        influence = (1 - bent) * influence + bent * row
    return tube(path, radii, influence, _AHEAD, sides=12, caps=(0.5, 1.0))

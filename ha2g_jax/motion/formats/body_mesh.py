"""Mesh of the body in a `.glb`: a person in a pullover, made of lofts between the joints of an armature at rest.

Sizes are those of a tall adult whose shoulder joints are 0.418 m apart, as with the mean bone lengths of
TED-Expressive, and are scaled with that distance. Legs are drawn where the armature has them.
"""

import itertools

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.figure import DEFAULT_LOOK
from ha2g_jax.motion import rigs
from ha2g_jax.motion.armature import Armature
from ha2g_jax.motion.formats.surfaces import Surface, ellipsoid, join, loft, tube
from ha2g_jax.motion.rotations import unit
from ha2g_jax.motion.smoothing import smoothstep

_FOUR = ("index", "middle", "ring", "pinky")
_RADII = {"thumb": 0.0125, "index": 0.0103, "middle": 0.0107, "ring": 0.0102, "pinky": 0.0088}
_TIPS = {"thumb": 0.028, "index": 0.026, "middle": 0.028, "ring": 0.027, "pinky": 0.022}
_AHEAD = np.array([0.0, 0.0, 1.0])
_CUFF = 0.93  # fraction of the forearm that the sleeve covers
# Joints that a rig must have for a body, besides neck and head.
_NEEDED = ("spine", *(f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")))
_SHOULDERS = 0.418
_X, _Y, _Z = np.eye(3)

# Pullover: height above the joint of the spine, half-width, half-depth and offset to the front, in metres.
_TORSO = np.array(
    [
        (-0.385, 0.158, 0.108, 0.004),
        (-0.360, 0.170, 0.117, 0.004),
        (-0.290, 0.173, 0.119, 0.003),
        (-0.210, 0.163, 0.111, 0.004),
        (-0.140, 0.157, 0.107, 0.006),
        (-0.060, 0.163, 0.112, 0.008),
        (0.020, 0.176, 0.119, 0.010),
        (0.080, 0.188, 0.120, 0.010),
        (0.130, 0.197, 0.114, 0.008),
        (0.170, 0.201, 0.103, 0.005),
        (0.200, 0.192, 0.091, 0.002),
        (0.222, 0.166, 0.081, -0.001),
        (0.240, 0.130, 0.073, -0.002),
        (0.257, 0.095, 0.067, -0.003),
        (0.275, 0.067, 0.061, 0.000),
        (0.287, 0.060, 0.058, 0.003),
    ]
)
# Head: height above the chin, half-width, half-depth and offset to the front, in metres.
_HEAD = np.array(
    [
        (0.000, 0.022, 0.024, 0.046),
        (0.010, 0.034, 0.038, 0.039),
        (0.028, 0.046, 0.054, 0.029),
        (0.052, 0.056, 0.068, 0.019),
        (0.080, 0.064, 0.080, 0.010),
        (0.108, 0.070, 0.089, 0.004),
        (0.135, 0.0745, 0.095, 0.000),
        (0.162, 0.0755, 0.0975, -0.003),
        (0.188, 0.0725, 0.095, -0.005),
        (0.210, 0.063, 0.084, -0.006),
        (0.226, 0.048, 0.066, -0.007),
        (0.236, 0.031, 0.044, -0.008),
    ]
)
_HEAD_SIZE = 1.14
_CHIN = np.array([0.0, 0.088, 0.036])  # metres from the joint of the neck

_BROW = ((0.016, 0.139, 0.0905), (0.026, 0.1425, 0.0885), (0.037, 0.1425, 0.0835), (0.048, 0.138, 0.0755))
_BROW_THICK = np.array([0.0030, 0.0036, 0.0033, 0.0018])


class Joints:
    """Positions (3,) of joints at rest, indices of those that turn as in `ha2g`, and size relative to the tables."""

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


def mix(first: np.ndarray, second: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Mix influences (J,) or (n, J) by weights (n,) from 0, the first, to 1, the second."""
    return (1 - weight)[:, None] * first + weight[:, None] * second


def arm(joints: Joints, side: str) -> tuple[Surface, list[Surface]]:
    """Build the sleeve of an arm, and the surfaces of the skin below it."""
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
        smoothstep(at, lengths[1] - 0.05 * size, lengths[1] + 0.06 * size),
    )
    bent = smoothstep(at, lengths[2] - 0.05 * size, lengths[2] + 0.07 * size)
    influence = mix(influence, joints.moved_by(f"{side}_elbow"), bent)
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
    weight = smoothstep(fraction, 0.93, 1.03)
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
    late = smoothstep(fraction, 0.3, 1.0)[:, None, None]
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
        influence = mix(influence, row, smoothstep(at, length - reach, length + reach))
    return tube(path, radii, influence, _AHEAD, sides=12, caps=(0.5, 1.0))


def _linear(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    """Convert an sRGB colour of 0 to 255 to the linear colour of glTF."""
    value = np.array(colour) / 255
    red, green, blue = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).round(4).tolist()
    return red, green, blue


# Red, green, blue, roughness of each material.
COLOURS = {
    "shirt": (*_linear(DEFAULT_LOOK.shirt), 0.85),
    "skin": (*_linear(DEFAULT_LOOK.skin), 0.6),
    "hair": (*_linear(DEFAULT_LOOK.hair), 0.7),
    "lips": (*_linear((186, 112, 96)), 0.6),
    "eye_white": (*_linear((246, 246, 244)), 0.3),
    "iris": (*_linear((56, 40, 34)), 0.2),
    "trousers": (*_linear((58, 62, 72)), 0.85),
    "shoes": (*_linear((40, 36, 36)), 0.5),
}


def body_mesh(armature: Armature) -> dict[str, Surface]:
    """Build the surfaces of the body in the rest pose of an armature, in metres from the root.

    Returns:
        The surface of each material of `COLOURS` that is used.

    Raises:
        UserError: the rig lacks a joint that the body needs.
    """
    _, positions = rigs.rest_positions(armature)
    places = {name: positions[index] for name, index in rigs.places(armature).items()}
    carriers = rigs.carriers(armature)
    missing = [f"place {name!r}" for name in ("neck", *_NEEDED) if name not in places]
    missing += [f"carries {name!r} with weight 1" for name in ("head", *_NEEDED) if name not in carriers]
    if missing:
        raise UserError(f"the rig {armature.name} has no joint with {', '.join(missing)}; a body needs one: write .bvh")
    scale = float(np.linalg.norm(places["left_shoulder"] - places["right_shoulder"])) / _SHOULDERS
    joints = Joints(places, carriers, len(armature.joints), scale)
    parts: dict[str, list[Surface]] = {colour: [] for colour in COLOURS}
    parts["shirt"].append(_torso(joints))
    for side in ("left", "right"):
        sleeve, skin = arm(joints, side)
        parts["shirt"].append(sleeve)
        parts["skin"] += skin
        if f"{side}_hip" in joints:
            for colour, surface in _leg(joints, side).items():
                parts[colour].append(surface)
    if "pelvis" in joints:
        parts["trousers"].append(_hips(joints))
    for colour, surfaces in _head(joints).items():
        parts[colour] += surfaces
    return {colour: join(surfaces) for colour, surfaces in parts.items() if surfaces}


def _torso(joints: Joints) -> Surface:
    size, spine = joints.scale, joints["spine"]
    shoulder, neck = (joints[name][1] - spine[1] for name in ("left_shoulder", "neck"))
    # The table's shoulders are 0.196 m and its neck 0.26 m above the spine; between them it stretches.
    known = [-1.0, 0.0, 0.196, 0.26, 0.36]
    heights = np.interp(_TORSO[:, 0], known, [-size, 0, min(shoulder, neck - 0.03 * size), neck, neck + 0.1 * size])
    centres = spine + heights[:, None] * _Y + size * _TORSO[:, 3:] * _Z
    radii, sides = size * _TORSO[:, 1:3], 28
    x = radii[:, :1] * np.cos(2 * np.pi * np.arange(sides) / sides)
    shrugged = smoothstep(np.abs(x) / size, 0.07, 0.19) * smoothstep(_TORSO[:, 0], 0.02, 0.17)[:, None]
    left, right = (joints.moved_by(f"{side}_clavicle", "spine") for side in ("left", "right"))
    clavicles = np.where((x > 0)[..., None], left, right)
    trunk = joints.moved_by("spine")
    if "pelvis" in joints:
        trunk = mix(joints.moved_by("pelvis"), trunk, smoothstep(heights / size, -0.33, -0.02))[:, None]
    influence = (1 - shrugged)[..., None] * trunk + shrugged[..., None] * clavicles
    return loft(centres, _X, _Z, radii, influence, sides=sides, squareness=2.35, caps=(0.25, 0.1))


def _hips(joints: Joints) -> Surface:
    size, pelvis = joints.scale, joints["pelvis"]
    shape = np.array([(-0.14, 0.125, 0.092), (-0.10, 0.158, 0.109), (-0.06, 0.161, 0.109), (0.0, 0.145, 0.095)])
    centres = pelvis + size * shape[:, :1] * _Y
    still = np.tile(joints.moved_by("pelvis"), (len(shape), 1))
    return loft(centres, _X, _Z, size * shape[:, 1:], still, sides=28, squareness=2.35, caps=(0.3, 0.1))


def _leg(joints: Joints, side: str) -> dict[str, Surface]:
    size = joints.scale
    hip, knee, ankle, ball = (joints[f"{side}_{part}"] for part in ("hip", "knee", "ankle", "foot"))
    at = np.linspace(0, 2, 21)  # 0 at the hip, 1 at the knee, 2 at the ankle
    path = np.stack([np.interp(at, [0, 1, 2], [a, b, c]) for a, b, c in zip(hip, knee, ankle)], axis=-1)
    radii = size * np.interp(at, [0, 0.5, 1, 1.4, 2], [0.092, 0.080, 0.062, 0.062, 0.048])
    influence = mix(joints.moved_by(f"{side}_hip"), joints.moved_by(f"{side}_knee"), smoothstep(at, 0.85, 1.15))
    trousers = tube(path, radii, influence, _Z, caps=(0.8, 0.1))
    heel = np.array([ankle[0], ball[1], ankle[2]]) - 0.02 * size * _Z
    toe = ball + 0.055 * size * _Z
    along = np.linspace(0, 1, 9)
    sole = heel + along[:, None] * (toe - heel) + size * np.interp(along, [0, 1], [0.022, 0.004])[:, None] * _Y
    wide = size * np.interp(along, [0, 0.4, 0.75, 1], [0.034, 0.040, 0.046, 0.034])
    tall = size * np.interp(along, [0, 0.3, 0.7, 1], [0.052, 0.052, 0.036, 0.026])
    foot = np.tile(joints.moved_by(f"{side}_ankle"), (len(along), 1))
    shoes = loft(sole, _X, -_Y, np.stack([wide, tall], axis=-1), foot, squareness=2.5, caps=(0.8, 0.8))
    return {"trousers": trousers, "shoes": shoes}


def _head(joints: Joints) -> dict[str, list[Surface]]:
    size, neck = joints.scale, joints["neck"]
    head = joints.moved_by("head")
    weight = smoothstep(np.linspace(0, 1, 8), 0.1, 0.9)
    path = neck + size * np.linspace(0, 1, 8)[:, None] * np.array([0, 0.165, 0.022]) - size * np.array([0, 0.03, 0])
    radii = size * np.stack([np.interp(weight, [0, 1], [0.053, 0.052]), np.interp(weight, [0, 1], [0.052, 0.056])], -1)
    throat = loft(path, _X, _Z, radii, mix(joints.moved_by("spine"), head, weight))
    scale = size * _HEAD_SIZE
    chin = neck + size * _CHIN

    def place(x: float, y: float, z: float) -> np.ndarray:
        return chin + scale * np.array([x, y, z])

    def ball(x: float, y: float, z: float, radii: tuple[float, float, float]) -> Surface:
        return ellipsoid(place(x, y, z), [scale * radius for radius in radii], head)

    centres = chin + scale * (_HEAD[:, :1] * _Y + _HEAD[:, 3:] * _Z)
    still = np.tile(head, (len(centres), 1))
    options = {"sides": 28, "squareness": 2.15, "caps": (0.4, 0.28)}
    face = loft(centres, _X, _Z, scale * _HEAD[:, 1:3], still, **options)  # type: ignore[arg-type]
    parts: dict[str, list[Surface]] = {"skin": [throat, face], "hair": [], "eye_white": [], "iris": [], "lips": []}
    parts["hair"].append(_hair(chin, scale, head))
    nose = np.array([place(0, 0.122, 0.090), place(0, 0.108, 0.097), place(0, 0.093, 0.104), place(0, 0.084, 0.103)])
    parts["skin"].append(
        tube(nose, scale * np.array([0.007, 0.009, 0.012, 0.0125]), still[:4], _Z, sides=12, caps=(1.0, 0.7))
    )
    smile = np.array([place(x, 0.052 + 9 * x * x, 0.0875 - 12 * x * x) for x in np.linspace(-0.022, 0.022, 9)])
    thin = scale * np.interp(np.abs(np.linspace(-1, 1, 9)), [0, 1], [0.0048, 0.0022])
    parts["lips"].append(tube(smile, thin, still[:1].repeat(9, axis=0), _Z, sides=10))
    for sign in (1, -1):
        parts["skin"].append(ball(sign * 0.073, 0.108, -0.008, (0.010, 0.028, 0.017)))
        parts["eye_white"].append(ball(sign * 0.031, 0.121, 0.0775, (0.0150, 0.0088, 0.0085)))
        parts["iris"].append(ball(sign * 0.0305, 0.121, 0.0830, (0.0072, 0.0080, 0.0048)))
        brow = np.array([place(sign * x, y, z) for x, y, z in _BROW])
        parts["hair"].append(tube(brow, scale * _BROW_THICK, still[: len(brow)], _Z, sides=8))
    return parts


def _hair(chin: np.ndarray, scale: float, head: np.ndarray) -> Surface:
    """Build a shell around the head that ends below the skin at the hairline."""
    shape, sides = _HEAD[3:], 36
    centres = chin + scale * (shape[:, :1] * _Y + shape[:, 3:] * _Z)
    shell = loft(centres, _X, _Z, scale * shape[:, 1:3], np.tile(head, (len(shape), 1)), sides=sides, caps=(0.2, 0.30))
    inner = shell.points - chin - scale * np.array([0, 0.13, -0.004])
    height, ahead = (shell.points - chin)[:, 1] / scale, inner[:, 2] / scale
    # The hairline: over the forehead, down before the ears, low at the back.
    line = np.interp(ahead, [-0.09, -0.03, 0.005, 0.03, 0.06, 0.09], [0.062, 0.075, 0.110, 0.150, 0.176, 0.186])
    thick = 0.90 + 0.185 * smoothstep(height - line, -0.012, 0.012)
    points = chin + scale * np.array([0, 0.13, -0.004]) + inner * thick[:, None]
    return Surface(points, shell.normals, shell.faces, shell.influence)

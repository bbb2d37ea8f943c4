"""Mesh of the body in a `.glb` and on pages: the person of `figure`, made of lofts between the joints at rest.

Sizes are those of a tall adult whose shoulder joints are 0.418 m apart, as with the mean bone lengths of
TED-Expressive, and are scaled with that distance. Below the hem there are whole legs if the armature has them, and
otherwise legs down to the knees.
"""

import itertools

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.figure import DEFAULT_LOOK, Colour, person
from ha2g_jax.motion import rigs
from ha2g_jax.motion.armature import FOUR_FINGERS, Armature, rest_positions
from ha2g_jax.motion.formats.surfaces import Surface, ellipsoid, join, loft, tube, with_normals
from ha2g_jax.motion.rotations import unit
from ha2g_jax.motion.smoothing import smoothstep
from ha2g_jax.skeleton import FINGERS

# Joints that a rig must have for a body, besides neck and head.
_NEEDED = ("spine", *(f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")))
_SHOULDERS = 0.418
_X, _Y, _Z = np.eye(3)

# Pullover above the spine: height, half-width, half-depth and offset to the front, in metres, and how far the ring
# is tilted to the front, in degrees. Below are the sections of the figure.
_CHEST = np.array(
    [
        (0.060, 0.176, 0.114, 0.006, 0),
        (0.120, 0.193, 0.118, 0.008, 0),
        (0.165, 0.200, 0.112, 0.007, 0),
        (0.205, 0.194, 0.101, 0.003, 0),
        (0.235, 0.168, 0.089, -0.001, 4),
        (0.258, 0.135, 0.080, -0.002, 10),
        (0.275, 0.105, 0.075, -0.001, 18),
        (0.287, 0.082, 0.073, 0.001, 26),
        (0.293, 0.071, 0.072, 0.004, 32),
        (0.294, 0.0665, 0.070, 0.006, 34),
    ]
)
_TORSO = np.array(
    [(above - below, width, person.THICK * width + 0.004, 0.004, 0) for above, below, width in person.SECTIONS[:0:-1]]
    + _CHEST.tolist()
)
# Head: height, half-width, half-depth and offset to the front, in metres on a head of size 1.
_HEAD = np.array(
    [
        (-0.110, 0.024, 0.034, 0.034),
        (-0.100, 0.040, 0.050, 0.026),
        (-0.085, 0.056, 0.064, 0.018),
        (-0.060, 0.071, 0.078, 0.009),
        (-0.030, 0.081, 0.086, 0.003),
        (0.000, 0.085, 0.090, 0.000),
        (0.030, 0.085, 0.092, -0.004),
        (0.060, 0.077, 0.088, -0.008),
        (0.085, 0.062, 0.076, -0.012),
        (0.102, 0.043, 0.056, -0.014),
        (0.112, 0.022, 0.030, -0.015),
    ]
)
_HEAD_PLACE = np.array([0.0, 0.205, -0.014])  # metres from the neck to the centre of the head
# Hair: height, half-width and half-depth of the shell, and its offset to the front.
_HAIR = np.array(
    [
        (-0.142, 0.080, 0.044, -0.048),
        (-0.132, 0.101, 0.060, -0.048),
        (-0.110, 0.116, 0.076, -0.044),
        (-0.085, 0.118, 0.088, -0.036),
        (-0.055, 0.115, 0.096, -0.028),
        (-0.025, 0.110, 0.102, -0.020),
        (0.000, 0.104, 0.104, -0.014),
        (0.022, 0.103, 0.105, -0.012),
        (0.045, 0.101, 0.103, -0.012),
        (0.068, 0.094, 0.098, -0.012),
        (0.090, 0.082, 0.088, -0.012),
        (0.108, 0.066, 0.073, -0.013),
        (0.122, 0.046, 0.052, -0.014),
        (0.131, 0.025, 0.028, -0.015),
    ]
)
# The hairline, parted at the side: degrees from the front to the person's left, and height.
_SIDE = ((80, 0.005), (88, -0.020), (97, -0.090), (104, -0.142), (180, -0.142))
_FRINGE = ((-62, 0.034), (-40, 0.060), (-14, 0.072), (6, 0.083), (20, 0.088), (32, 0.074), (62, 0.034))
_HAIRLINE = np.array([*((-degrees, height) for degrees, height in _SIDE[::-1]), *_FRINGE, *_SIDE])


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
    inside = joints["neck"] + 0.3 * (shoulder - joints["neck"]) + 0.008 * size * _Y
    corners = np.array([inside, shoulder, elbow, wrist])
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.concatenate([np.linspace(0, lengths[1], 6), np.linspace(lengths[1], lengths[2], 15)[1:]])
    at = np.concatenate([at, np.linspace(lengths[2], lengths[2] + person.CUFF * (lengths[3] - lengths[2]), 13)[1:]])
    path = _rounded_path(corners, lengths, at, 0.05 * size)
    top, joint, hem = person.SLEEVE
    radii = size * np.interp(at, [0, 0.8 * lengths[1], *lengths[1:3], at[-1]], [0.036, 0.055, top, joint, hem])
    influence = mix(
        joints.moved_by(f"{side}_clavicle", "spine"),
        joints.moved_by(f"{side}_shoulder"),
        smoothstep(at, lengths[1] - 0.05 * size, lengths[1] + 0.06 * size),
    )
    bent = smoothstep(at, lengths[2] - 0.05 * size, lengths[2] + 0.07 * size)
    influence = mix(influence, joints.moved_by(f"{side}_elbow"), bent)
    sleeve = tube(path, radii, influence, _Z, caps=(0.5, 0.0))
    skin = [_wrist(joints, side), _palm(joints, side)]
    if f"{side}_index_1" in joints:
        skin += [_finger(joints, side, finger) for finger in FINGERS]
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
    radii = joints.scale * np.interp(fraction, [0.82, 1.0], person.WRIST)
    weight = smoothstep(fraction, 0.93, 1.03)
    influence = mix(joints.moved_by(f"{side}_elbow"), joints.moved_by(f"{side}_wrist"), weight)
    return tube(path, radii, influence, _Z)


def _palm(joints: Joints, side: str) -> Surface:
    """Build the palm from the wrist to the knuckles, or a whole flat hand where the armature has no fingers."""
    size, wrist = joints.scale, joints[f"{side}_wrist"]
    hand = joints.moved_by(f"{side}_wrist")
    if f"{side}_index_1" not in joints:
        along = unit(wrist - joints[f"{side}_elbow"])
        far, radii = size * np.transpose(person.MITTEN)
        across = unit(_Z - (_Z @ along) * along)
        flat = np.stack([0.5 * radii, radii], axis=-1)
        return loft(wrist + far[:, None] * along, np.cross(along, across), across, flat, np.tile(hand, (len(far), 1)))
    knuckles = np.array([joints[f"{side}_{finger}_1"] for finger in FOUR_FINGERS])
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
    fingers = np.array([joints.moved_by(f"{side}_{finger}_0", f"{side}_wrist") for finger in FOUR_FINGERS])
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
    radius = person.FINGER_RADII[FINGERS.index(finger)]
    tip = chain[2] + size * (person.FINGER_TIP - 0.4 * radius) * unit(chain[2] - chain[1])
    corners = np.array([root, *chain, tip])
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.unique(np.concatenate([np.linspace(a, b, 5) for a, b in itertools.pairwise(lengths)]))
    path = _rounded_path(corners, lengths, at, 0.008 * size)
    shape = [1.55, 1.2, 1.06, 0.97, 0.8] if finger == "thumb" else [1.08, 1.08, 1.03, 0.97, 0.8]
    radii = size * radius * np.interp(at, lengths, shape)
    names = [f"{side}_{finger}_{part}" for part in range(4)]
    rows = [joints.moved_by(names[0], f"{side}_wrist"), *(joints.moved_by(*names[part:0:-1]) for part in (1, 2, 3))]
    influence = np.tile(rows[0], (len(at), 1))
    reach = 0.008 * size
    for row, length in zip(rows[1:], lengths[1:-1]):
        influence = mix(influence, row, smoothstep(at, length - reach, length + reach))
    return tube(path, radii, influence, _Z, sides=10, caps=(0.5, 1.0))


# sRGB colour and roughness of each material.
COLOURS: dict[str, tuple[Colour, float]] = {
    "shirt": (DEFAULT_LOOK.shirt, 0.85),
    "skin": (DEFAULT_LOOK.skin, 0.6),
    "hair": (DEFAULT_LOOK.hair, 0.7),
    "lips": (person.lip_colour(DEFAULT_LOOK), 0.6),
    "eye_white": (person.EYES[0], 0.3),
    "iris": (person.EYES[1], 0.2),
    "trousers": (person.TROUSERS, 0.85),
    "shoes": ((40, 36, 36), 0.5),
}


def body_mesh(armature: Armature) -> dict[str, Surface]:
    """Build the surfaces of the body in the rest pose of an armature, in metres from the root.

    Returns:
        The surface of each material of `COLOURS` that is used.

    Raises:
        UserError: the rig lacks a joint that the body needs.
    """
    _, positions = rest_positions(armature)
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
    if "pelvis" not in joints:
        parts["trousers"] += [_thigh(joints, sign) for sign in (1, -1)]
    for colour, surfaces in _head(joints).items():
        parts[colour] += surfaces
    return {colour: join(surfaces) for colour, surfaces in parts.items() if surfaces}


def _torso(joints: Joints) -> Surface:
    size, spine = joints.scale, joints["spine"]
    shoulder, neck = (joints[name][1] - spine[1] for name in ("left_shoulder", "neck"))
    # The table's shoulders are 0.196 m and its neck 0.26 m above the spine; between them it stretches.
    known = [-1.0, 0.0, 0.196, 0.26, 0.36]
    heights = np.interp(_TORSO[:, 0], known, [-size, 0, min(shoulder, neck - 0.03 * size), neck, neck + 0.1 * size])
    centres = spine + heights[:, None] * _Y + size * _TORSO[:, 3:4] * _Z
    # Over hips and legs the pullover is wider.
    hips = smoothstep(-_TORSO[:, :1], 0.16, 0.40) * ("pelvis" in joints)
    radii, sides, tilt = size * _TORSO[:, 1:3] * (1 + 0.14 * hips), 32, np.deg2rad(_TORSO[:, 4:])
    ahead = np.cos(tilt) * _Z - np.sin(tilt) * _Y
    x = radii[:, :1] * np.cos(2 * np.pi * np.arange(sides) / sides)
    shrugged = smoothstep(np.abs(x) / size, 0.07, 0.19) * smoothstep(_TORSO[:, 0], 0.02, 0.17)[:, None]
    left, right = (joints.moved_by(f"{side}_clavicle", "spine") for side in ("left", "right"))
    clavicles = np.where((x > 0)[..., None], left, right)
    trunk = joints.moved_by("spine")
    if "pelvis" in joints:
        trunk = mix(joints.moved_by("pelvis"), trunk, smoothstep(heights / size, -0.33, -0.02))[:, None]
        legs = (joints.moved_by(f"{side}_hip", "pelvis") for side in ("left", "right"))
        swung = 0.6 * smoothstep(np.abs(x) / size, 0.0, 0.12) * smoothstep(-_TORSO[:, :1], 0.36, 0.50)
        trunk = (1 - swung)[..., None] * trunk + swung[..., None] * np.where((x > 0)[..., None], *legs)
    influence = (1 - shrugged)[..., None] * trunk + shrugged[..., None] * clavicles
    return loft(centres, _X, ahead, radii, influence, sides=sides, squareness=2.35, caps=(0.05, -0.3))


def _thigh(joints: Joints, sign: int) -> Surface:
    size, spine = joints.scale, joints["spine"]
    path = spine + size * np.array([(sign * x, y, 0.0) for x, y in np.linspace((0.086, -0.46), (0.077, -1.08), 8)])
    still = np.tile(joints.moved_by("spine"), (len(path), 1))
    return tube(path, size * np.array([0.078, *np.linspace(0.087, 0.08, 7)]), still, _Z, caps=(0.2, 0.2))


def _leg(joints: Joints, side: str) -> dict[str, Surface]:
    size = joints.scale
    hip, knee, ankle, ball = (joints[f"{side}_{part}"] for part in ("hip", "knee", "ankle", "foot"))
    at = np.linspace(0, 2, 21)  # 0 at the hip, 1 at the knee, 2 at the ankle
    path = np.stack([np.interp(at, [0, 1, 2], [a, b, c]) for a, b, c in zip(hip, knee, ankle)], axis=-1)
    radii = size * np.interp(at, [0, 0.5, 1, 1.4, 2], [0.074, 0.079, 0.062, 0.062, 0.048])
    influence = mix(joints.moved_by(f"{side}_hip"), joints.moved_by(f"{side}_knee"), smoothstep(at, 0.85, 1.15))
    trousers = tube(path, radii, influence, _Z, caps=(0.5, 0.1))
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
    centre, scale = neck + size * _HEAD_PLACE, size * person.HEAD_SIZE

    def place(x: float, y: float, z: float) -> np.ndarray:
        return centre + scale * np.array([x, y, z])

    def ball(place: np.ndarray, axes: tuple[float, ...], depth: float) -> Surface:
        return ellipsoid(place, [scale * radius for radius in (*axes, depth)], head)

    height = np.linspace(0, 1, 10)
    low, high = neck + size * np.array([0, -0.015, 0.012]), place(0, -0.055, -0.012)
    throat = tube(
        low + height[:, None] * (high - low),
        size * np.interp(height, [0, 0.4, 1], [person.THROAT[0], *2 * person.THROAT[1:]]),
        mix(joints.moved_by("spine"), head, smoothstep(height, 0.2, 1.0)),
        _Z,
        sides=24,
        caps=(0.5, 0.2),
    )
    still = np.tile(head, (len(_HEAD), 1))
    rings = centre + scale * (_HEAD[:, :1] * _Y + _HEAD[:, 3:] * _Z)
    face = loft(rings, _X, _Z, scale * _HEAD[:, 1:3], still, sides=32, squareness=2.3, caps=(0.3, 0.3))
    parts: dict[str, list[Surface]] = {"skin": [throat, face], "hair": [], "eye_white": [], "iris": [], "lips": []}
    parts["hair"].append(_hair(centre, scale, head))
    bridge = np.array([place(0, y, z) for y, z in ((-0.002, 0.082), (-0.016, 0.088), (-0.030, 0.093), (-0.037, 0.093))])
    wide = scale * np.array([0.005, 0.008, 0.0115, 0.012])
    parts["skin"].append(tube(bridge, wide, still[:4], _X, sides=12, caps=(1.0, 0.7)))
    smile = np.array([place(x, -0.071 + 14 * x * x, 0.0850 - 12 * x * x) for x in np.linspace(-0.026, 0.026, 9)])
    thin = scale * np.interp(np.abs(np.linspace(-1, 1, 9)), [0, 1], [0.0045, 0.0015])
    parts["lips"].append(tube(smile, thin, still[:9], _Z, sides=10))
    for sign in (1, -1):
        mirrored = np.array([sign, 1, 1])
        parts["skin"].append(ball(place(*(mirrored * person.EAR[0])), (0.012, person.EAR[1][1]), 0.018))
        parts["eye_white"].append(ball(place(*(mirrored * person.EYE_WHITE[0])), person.EYE_WHITE[1], 0.008))
        parts["iris"].append(ball(place(*(mirrored * person.IRIS[0])) + scale * 0.0025 * _Z, person.IRIS[1], 0.0035))
        for line, depth, thick in ((person.BROW, 0.089, 0.0030), (person.LID, 0.091, 0.0018)):
            x = np.linspace(line[0][0], line[-2][0], 7)
            y = np.polyval(np.polyfit([point[0] for point in line[:-1]], [point[1] for point in line[:-1]], 2), x)
            path = np.stack([place(sign * across, up, depth - 5 * across**2) for across, up in zip(x, y)])
            radii = scale * thick * np.array([0.7, 0.9, 1, 1, 0.9, 0.7, 0.4])
            parts["hair"].append(tube(path, radii, still[:7], _Z, sides=8))
    return parts


def _hair(centre: np.ndarray, scale: float, head: np.ndarray) -> Surface:
    """Build a shell from the hairline to the crown; what closes it is within the head."""
    rings = centre + scale * (_HAIR[:, :1] * _Y + _HAIR[:, 3:] * _Z)
    still = np.tile(head, (len(_HAIR), 1))
    shell = loft(rings, _X, _Z, scale * _HAIR[:, 1:3], still, sides=48, caps=(0.1, 0.12))
    x, y, z = ((shell.points - centre) / scale).T
    heights, low, high = _HAIR[:, 0], _HAIR[0, 0], _HAIR[-1, 0]
    wide, deep, ahead = (np.interp(y, heights, column) for column in _HAIR.T[1:])
    line = np.interp(np.rad2deg(np.arctan2(x, z - ahead - 1e-6)), *_HAIRLINE.T)
    level = np.where(y < high, line + (y - low) / (high - low) * (high - line), y)
    new_wide, new_deep, new_ahead = (np.interp(level, heights, column) for column in _HAIR.T[1:])
    points = np.stack([x * new_wide / wide, level, new_ahead + (z - ahead) * new_deep / deep], axis=-1)
    return with_normals(centre + scale * points, shell.faces, shell.influence)

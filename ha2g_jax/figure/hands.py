"""Shapes of the hands."""

import numpy as np

from ha2g_jax.figure.shapes import Look, Part, Shape, capsules, hull, shade, unit

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_EDGE = 0.0028  # metres
_RADII = np.array((0.0125, 0.0105, 0.011, 0.0105, 0.009))
_BONES = np.repeat(_RADII, 3) * np.tile([1.08, 1.0, 0.94], 5)
_TIPS = np.repeat(_RADII, 3) * np.tile([1.0, 0.94, 0.8], 5)
_OUT = 0.4  # fraction of the first bone of a finger that has no edge within the palm
# Metres from the wrist, and radii.
_MITTEN = (
    (0.0, 0.026),
    (0.025, 0.0315),
    (0.05, 0.0350),
    (0.075, 0.0355),
    (0.1, 0.033),
    (0.125, 0.0285),
    (0.145, 0.022),
)


def hand_parts(points: dict[str, np.ndarray], side: str, look: Look, detail: int) -> list[Part]:
    """Build palm and fingers, or a mitten where the skeleton has no fingers.

    Args:
        points: (T, 3) positions of the joints in metres by name.
        side: "left" or "right".
        look: colours of the figure.
        detail: factor of the number of points of a curve of the mitten.

    Returns:
        The edge of the hand, which is behind everything else of it, the palm and each finger as parts of their own,
        with their depths in metres as keys.
    """
    wrist = points[f"{side}_wrist"]
    edge, lit = shade(look.skin, 0.72), shade(look.skin, 1.02)
    behind = np.full(len(wrist), np.inf)
    if f"{side}_index_1" not in points:
        along = unit(wrist - points[f"{side}_elbow"])
        centres = np.stack([wrist + far * along for far, _ in _MITTEN], axis=1)
        radii = np.array([radius for _, radius in _MITTEN])
        mitten = Shape(hull(centres, radii, detail), edge), Shape(hull(centres, radii - 0.0035, detail), lit)
        return [Part(behind, list(mitten))]
    chains = np.stack([_finger_chain(points, side, finger) for finger in _FINGERS], axis=1)
    starts, ends = chains[:, :, :-1].reshape(-1, 15, 3), chains[:, :, 1:].reshape(-1, 15, 3)
    # The palm: the hull of the wrist and the four knuckles, and the ball of the thumb.
    discs = np.concatenate([wrist[:, None], chains[:, 1:, 0]], axis=1)
    radii = np.array([0.023, 0.0125, 0.0125, 0.0120, 0.0115])
    ball = np.stack([wrist + 0.2 * (chains[:, 0, 0] - wrist), chains[:, 0, 0]], axis=1)
    ball_radii = np.array([0.020, 0.0145])
    base = [Shape(hull(discs, radii + _EDGE), edge), Shape(hull(ball, ball_radii + _EDGE), edge)]
    palm = [Shape(hull(ball, ball_radii), lit), Shape(hull(discs, radii), lit)]
    out = starts.copy()
    out[:, ::3] += _OUT * (ends - starts)[:, ::3]
    whole = capsules(starts[:, ::3], ends[:, ::3], _BONES[::3] + _EDGE, _TIPS[::3] + _EDGE)
    outer = capsules(out, ends, _BONES + _EDGE, _TIPS + _EDGE)
    inner = capsules(starts, ends, _BONES, _TIPS)
    parts = [
        Part(behind, [*base, *(Shape(outline, edge) for outline in whole)]),
        Part(discs[..., 2].mean(axis=1), palm),
    ]
    # Each finger is one part, with its edge first, so that there are no seams at its joints.
    for finger in range(5):
        bones = range(3 * finger, 3 * finger + 3)
        shapes = [Shape(outer[bone], edge) for bone in bones] + [Shape(inner[bone], lit) for bone in bones]
        parts.append(Part(chains[:, finger, 1:, 2].mean(axis=1), shapes))
    return parts


def _finger_chain(points: dict[str, np.ndarray], side: str, finger: str) -> np.ndarray:
    """Return the (T, 4, 3) joints of a finger and its tip, which is extrapolated because skeletons have no tips."""
    first, second, third = (points[f"{side}_{finger}_{part}"] for part in (1, 2, 3))
    ahead, last = second - first, third - second
    tip = third + 0.026 * unit(unit(last) + 0.4 * (unit(last) - unit(ahead)))
    return np.stack([first, second, third, tip], axis=1)

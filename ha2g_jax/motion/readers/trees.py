"""Conversion of trees whose joints have rest axes, as in tables and glTF, to trees of BVH, whose joints have none."""

import codecs
import contextlib
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import naming, reading, reason, shown
from ha2g_jax.motion import lower_body, rigs, rotations
from ha2g_jax.motion.armature import Animation, Armature, ha2g_armature, rest_positions, with_legs, world
from ha2g_jax.motion.motion import check_length
from ha2g_jax.motion.readers.bvh import USUAL_RATES, Bvh
from ha2g_jax.skeleton import SKELETONS, load_skeleton

TABLE = ("fps", "joints", "frames")
"""Parts of a `.json` that `ha2g export` writes."""

CSV = b"frame,time,"
"""Beginning of a `.csv` that `ha2g export` writes."""

_SEPARATORS = (b",", b";", b"\t")  # the others are those of spreadsheets
_EXPECTED = "a table of ha2g export"
_TURNS = ("Zrotation", "Xrotation", "Yrotation")
_MAX_PLACE = 1e6  # largest distance from the origin, in any unit
_MAX_ERROR = 0.35  # largest error of the length of a quaternion
_ALIKE = 1e-4  # relative difference from a usual rate that rounded times explain
_MAX_UNEVEN = 0.5  # of the usual step of time


def to_bvh(armature: Armature, local: np.ndarray, places: Mapping[int, np.ndarray], fps: float) -> Bvh:
    """Convert rotations (T, J, 4) of an armature to a tree whose joints have the axes of the world at rest.

    Args:
        places: (T, 3) of the joints that move relative to their parents, the root among them.

    Raises:
        UserError: the motion is too long, or has values that are no rotations or no places.
    """
    if local.size > limits.MAX_BVH_VALUES:
        raise UserError(f"{len(local)} frames of {len(armature.joints)} joints are too many; cut the file")
    check_length(len(local), fps)
    if not all((np.abs(values) <= _MAX_PLACE).all() for values in (armature.offsets, *places.values())):
        raise UserError("it has places that are not finite or too far away; export it again")
    turned, _ = rest_positions(armature)
    above = np.stack([turned[parent] if parent >= 0 else rotations.IDENTITY for parent in armature.parents])
    plain = rotations.multiply(rotations.multiply(above, as_rotations(local)), rotations.conjugate(turned))
    angles, channels, columns = rotations.to_euler(plain, "ZXY"), list[tuple[str, ...]](), list[np.ndarray]()
    for joint in range(len(armature.joints)):
        channels.append((("Xposition", "Yposition", "Zposition") if joint in places else ()) + _TURNS)
        columns += [rotations.rotate(above[joint], places[joint])] if joint in places else []
        columns.append(angles[:, joint])
    offsets = rotations.rotate(above, armature.offsets)
    return Bvh(armature.joints, armature.parents, offsets, tuple(channels), np.concatenate(columns, axis=1), fps)


def as_rotations(values: np.ndarray) -> np.ndarray:
    """Return quaternions (..., 4) of length 1; a UserError if one is far from that."""
    if not (np.abs(np.linalg.norm(np.clip(values, -2, 2), axis=-1) - 1) < _MAX_ERROR).all():
        raise UserError("it has values that are no rotations; export it again")
    return rotations.unit(values)


def frame_rate(times: np.ndarray) -> float:
    """Return the frames per second of ascending times (T,) in seconds, T >= 2, which may be rounded."""
    rate = (len(times) - 1) / (times[-1] - times[0])
    usual = min(USUAL_RATES, key=lambda usual: abs(usual - rate))
    return usual if abs(usual - rate) < _ALIKE * usual else float(rate)


def read_json(content: Mapping[str, Any], path: pathlib.Path) -> Bvh:
    """Convert the content of a `.json` that `ha2g export` wrote.

    Raises:
        UserError: a part is missing or has another form, or the length or the frame rate is out of range.
    """
    try:
        joints, frames = content["joints"], content["frames"]
        names = tuple(str(joint["name"]) for joint in joints)
        parents = tuple(int(joint["parent"]) for joint in joints)
        offsets, rest = (np.array([joint[field] for joint in joints], float) for field in ("offset", "rest"))
        places = np.array([frame["positions"][0] for frame in frames], float).reshape(len(frames), 3)
        local = np.array([frame["rotations"] for frame in frames], float).reshape(len(frames), len(names), 4)
        armature = Armature("", names, parents, offsets.reshape(len(names), 3), rest.reshape(len(names), 4))
        fps = float(content["fps"])
    except (KeyError, IndexError, ValueError, TypeError, OverflowError) as error:
        raise UserError(f"{shown(path)} is no table of ha2g export ({reason(error)}); export it again") from error
    if parents[:1] != (-1,) or not all(0 <= parent < index for index, parent in enumerate(parents[1:], start=1)):
        raise UserError(f"{shown(path)} has a joint before its parent; export it again")
    with naming(path):
        as_rotations(armature.rest)
        return to_bvh(armature, local, {0: places}, fps)


def is_csv(path: pathlib.Path) -> bool:
    """Return whether a file begins as a `.csv` of `ha2g export`, or as one that a spreadsheet has saved again."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        head = file.read(len(codecs.BOM_UTF8 + CSV) + 4).removeprefix(codecs.BOM_UTF8).replace(b'"', b"")
        return head.startswith(tuple(CSV.replace(b",", separator) for separator in _SEPARATORS))
    return False


def read_csv(path: pathlib.Path, fps: float | None) -> Bvh:
    """Read a `.csv` that `ha2g export` wrote; the names of its joints tell the rig, which has their tree.

    The frame rate is `fps`, or by default that of the times of the frames. A spreadsheet may have put semicolons or
    tabs between the values, and then commas for points.

    Raises:
        UserError: the file begins otherwise, the joints are those of no rig, a number or a frame is missing, or the
            values are no motion.
    """
    if not is_csv(path):
        raise UserError(
            f"{shown(path)} is not {_EXPECTED}: its first line has to begin with {CSV.decode()} in UTF-8, separated by "
            "commas, semicolons or tabs"
        )
    with reading(path, _EXPECTED), path.open(encoding="utf-8-sig") as file:
        head = file.readline(limits.MAX_BVH_HEADER).strip().replace('"', "")
        separator = head.removeprefix("frame")[0]
        names = head.split(separator)
        joints = tuple(name.removesuffix("_qw") for name in names if name.endswith("_qw"))
        armature = next((each for each in _armatures() if each.joints == joints), None)
        if armature is None:
            raise UserError(
                f"{shown(path)} is not {_EXPECTED}: no rig of {', '.join(rigs.RIGS)} has its joints; give .bvh or .json"
            )
        fields = [("x", "y", "z"), ("qx", "qy", "qz", "qw")]
        columns = [names.index(f"{joint}_{field}") for each in fields for joint in joints for field in each]
        lines = file.readlines()
        if not lines:
            raise UserError(f"{shown(path)} has no frames; export it again")
        usecols = [names.index("time"), *columns]
        texts = lines if separator == "," else (line.replace(",", ".") for line in lines)
        table = np.loadtxt(texts, delimiter=separator, usecols=usecols, ndmin=2, comments=None, quotechar='"')
    times, values = table[:, 0], table[:, 1:]
    places = values[:, : 3 * len(joints)].reshape(-1, len(joints), 3)
    with naming(path):
        rate = fps or _rate_of(times)
        local = as_rotations(values[:, 3 * len(joints) :].reshape(-1, len(joints), 4))
        parents = np.maximum(armature.parents, 0)
        turned, _ = world(Animation(armature, local, places[:, 0], 1.0, {}))
        bones = rotations.rotate(rotations.conjugate(turned[:, parents]), places - places[:, parents])
        armature = Armature(armature.name, joints, armature.parents, bones.mean(axis=0), armature.rest)
        return to_bvh(armature, local, {0: places[:, 0]}, rate)


def _rate_of(times: np.ndarray) -> float:
    """Return the frames per second of the times (T,) of a table, which begin in its row 2."""
    steps = np.diff(times)
    if not len(steps) or not (steps > 0).all():
        raise UserError("its times do not tell the frames per second; state them (--source-fps)")
    usual = np.median(steps)
    uneven = np.flatnonzero(np.abs(steps - usual) > _MAX_UNEVEN * usual)
    if len(uneven):
        row = uneven[0]
        raise UserError(
            f"its times have a gap at row {row + 3}, {steps[row]:.3g} s after the row before it, not {usual:.3g} s; "
            "give every frame"
        )
    return frame_rate(times)


def _armatures() -> Iterator[Armature]:
    """Yield the armatures that `ha2g export` writes, with any lengths of bones."""
    every = [ha2g_armature(load_skeleton(skeleton)) for skeleton in SKELETONS]
    yield from every
    yield from (with_legs(own, np.zeros((len(lower_body.JOINTS) + 1, 3))) for own in every)
    yield from (rigs.armature_of(rigs.load_rig(rig), every[0]) for rig in rigs.RIGS[1:])

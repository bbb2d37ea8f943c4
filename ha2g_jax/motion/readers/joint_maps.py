"""Maps from joints of the skeleton to joints of a motion capture file: built-in ones, and files in JSON or YAML.

A map has an entry `JOINT: NAME` for each joint of the skeleton except those of the face, and one for `head`, the joint
that the head rotates about. NAME may be a list; the first name that the file has is used. Letter case, and prefixes and
suffixes of most names, such as `mixamorig:` or `_jnt`, are ignored. Three entries are optional: `unit`, metres in one
unit of the file, `up`, the axis of the file that points up, and `comment`. A map without fingers is sufficient for
TED-Gesture. The rigs of `ha2g export` are maps as well.
"""

import collections
import difflib
import importlib.resources
import json
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import check_regular, parse_json, read_bytes, reading, reason, shown
from ha2g_jax.limits import MAX_JOINT_MAP_BYTES, MAX_JOINT_NAME
from ha2g_jax.motion import rigs
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.motion.lower_body import OPTIONAL
from ha2g_jax.motion.readers.body import FACE, UPS
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

# The most demanding first, because "auto" takes the first that fits.
_FILES = ("zeroeggs", "beat", "mixamo", "genea")
MAPS = (*_FILES, *(rig for rig in rigs.RIGS if rig not in _FILES))
AUTO = "auto"
HEAD = "head"

_EXPECTED = "a joint map in JSON or YAML"
_NUMBER = re.compile(r"_\d+$")
_MAX_DEPTH = 3  # a map has lists in its entries; one level more, so that the message can name the joint
_MAX_SHOWN, _MAX_LISTED, _MAX_LISTED_LETTERS = 40, 8, 400


class JointMap(NamedTuple):
    """A map from joints of the skeleton to names of joints in a file.

    Attributes:
        names: possible names in a file of each joint of the skeleton and of `head`, in order of preference.
        unit: metres in one unit of the file, None to detect it.
        up: axis of the file that points up, None to detect it.
    """

    name: str
    names: Mapping[str, tuple[str, ...]]
    unit: float | None
    up: str | None


def choose_map(
    joints: Sequence[str], skeleton: Skeleton, joint_map: str, file: str | pathlib.Path
) -> tuple[JointMap, dict[str, int]]:
    """Choose the map for a file and locate the joints of the skeleton in it.

    Args:
        joint_map: "auto" for the first of `MAPS` that fits, or one of `MAPS`, or the path of a JSON or YAML file.

    Returns:
        The map, and the index in `joints` of `head` and of each joint of the skeleton except those of the face.

    Raises:
        UserError: there is no such map, or the file lacks joints of the map.
    """
    candidates = [load_map(name) for name in (MAPS if joint_map == AUTO else (joint_map,))]
    wanted = [*(joint for joint in skeleton.joints if joint not in FACE), HEAD]
    best = max(candidates, key=lambda candidate: len(_find(candidate, joints, wanted)))
    places = find(best, joints, wanted, file)
    if missing := [joint for joint in wanted if joint not in places]:
        body = [joint for joint in wanted if not _is_finger(joint)]
        is_known = joint_map != AUTO or 2 * sum(joint in places for joint in body) >= len(body)
        raise _lacks(file, joints, best, places, missing) if is_known else _unknown(file, joints, missing)
    owners: dict[int, str] = {}
    for joint, place in places.items():
        if place in owners:
            raise UserError(
                f"map {best.name} uses {joints[place]} for both {owners[place]} and {joint}; name two different joints"
            )
        owners[place] = joint
    return best, places


def find_legs(joint_map: JointMap, joints: Sequence[str], file: str | pathlib.Path) -> dict[str, int]:
    """Locate pelvis and legs among the joints of a file.

    Returns:
        The index in `joints` of each joint of `lower_body.JOINTS` that the file has; nothing if it lacks one that is
        not optional, or if two of them are the same.
    """
    places = find(joint_map, joints, LOWER_JOINTS, file)
    is_whole = all(joint in places for joint in LOWER_JOINTS if joint not in OPTIONAL)
    return places if is_whole and len(set(places.values())) == len(places) else {}


def load_map(name: str) -> JointMap:
    """Load one of `MAPS`, or the joint map of a JSON or YAML file.

    Raises:
        UserError: there is no such file, or it is not a joint map.
    """
    if name in MAPS and name not in _FILES:
        return _of_rig(rigs.load_rig(name))
    if name in MAPS:
        path = importlib.resources.files("ha2g_jax") / "assets" / "joint_maps" / f"{name}.json"
        return _to_map(json.loads(path.read_bytes()), name)
    with reading(name, _EXPECTED):
        path = pathlib.Path(name)
        if not path.exists():
            raise UserError(f"no joint map {shown(name)}; give {AUTO}, {', '.join(MAPS)} or the path of a file")
    check_regular(path, _EXPECTED)
    text = read_bytes(path, f"{_EXPECTED} of some 40 lines", MAX_JOINT_MAP_BYTES)
    form, parse = ("JSON", parse_json) if path.suffix.lower() == ".json" else ("YAML", _parse_yaml)
    try:
        lines = parse(text)
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise UserError(f"{shown(name)} is not {form} ({reason(error)}); expected a joint map") from error
    return _to_map(lines, shown(name))


def _of_rig(rig: rigs.Rig) -> JointMap:
    """Return the map of a rig, whose joints of the spine may be fewer in a file."""
    names = {joint: (joint,) for joint in LOWER_JOINTS}
    names |= {joint.place: (joint.name,) for joint in rig.joints if joint.place}
    spine = tuple(joint.name for joint in reversed(rig.joints) if joint.carries == "spine")
    names |= {"spine": spine} | ({HEAD: (rig.names[HEAD],)} if HEAD in rig.names else {})
    return JointMap(rig.name, names, None, None)


def _to_map(lines: Any, name: str) -> JointMap:
    if not isinstance(lines, dict) or not all(isinstance(key, str) for key in lines):
        raise UserError(f"{name} is not a joint map; expected lines such as `spine: Spine3`")
    lines.pop("comment", None)
    unit, up = lines.pop("unit", None), lines.pop("up", None)
    if unit is not None:
        unit = _positive(unit, name)
    if up not in (None, *UPS):
        raise UserError(f"{name} has `up: {_text(up)}`; expected one of {', '.join(UPS)}")
    joints = {HEAD, *LOWER_JOINTS, *(joint for name in SKELETONS for joint in load_skeleton(name).joints)}
    if unknown := next((key for key in lines if key not in joints), None):
        alike = difflib.get_close_matches(unknown.casefold(), [*sorted(joints), "unit", "up", "comment"], 1)
        meant = f"; did you mean {alike[0]}?" if alike else ""
        raise UserError(f"{name} has an unknown entry {_text(unknown)}{meant}")
    return JointMap(name, {key: _names(value, key, name) for key, value in lines.items()}, unit, up)


def _parse_yaml(text: bytes) -> Any:
    yaml = require("yaml", "import", by="a joint map in YAML", package="pyyaml")
    try:
        _check_structure(yaml, text)
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(reason(error)) from error


def _check_structure(yaml: Any, text: bytes) -> None:
    """Refuse aliases, with which a short file may become endless, and deep nesting, before anything is built."""
    depth = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise ValueError("nested too deep")


def _positive(value: Any, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = 0.0
    if not 0 < number < float("inf"):
        raise UserError(f"{name} has `unit: {_text(value)}`; expected metres, such as 0.01 for centimetres")
    return number


def _text(value: Any) -> str:
    """Return a value of a map as the beginning of its text; Python writes no number of thousands of digits."""
    is_endless = isinstance(value, int) and abs(value) >= 10**MAX_JOINT_NAME
    return "9" * _MAX_SHOWN if is_endless else str(value)[:_MAX_SHOWN]


def _names(value: Any, key: str, name: str) -> tuple[str, ...]:
    names = value if isinstance(value, list) else [value]
    if not names or not all(isinstance(item, str | int) and not isinstance(item, bool) for item in names):
        raise UserError(
            f"{name} has no name for {_text(key)}; expected the name of a joint, in quotes if it is unusual"
        )
    if any(
        (isinstance(item, int) and abs(item) >= 10**MAX_JOINT_NAME) or len(str(item)) > MAX_JOINT_NAME for item in names
    ):
        raise UserError(f"{name} has a name of more than {MAX_JOINT_NAME} characters for {_text(key)}; correct it")
    return tuple(str(item) for item in names)


def find(joint_map: JointMap, joints: Sequence[str], wanted: Sequence[str], file: str | pathlib.Path) -> dict[str, int]:
    """Return the index in the file of those wanted joints that it has; two for one of them are a UserError."""
    places = {}
    for ours, alike in _find(joint_map, joints, wanted).items():
        if len(alike) > 1:
            first, second = (shown(joints[index]) for index in alike[:2])
            if first == second:
                raise UserError(f"{shown(file)} has two joints named {first}; keep one person in it")
            raise UserError(
                f"{shown(file)} has {first} and {second}, and either may be {ours}; choose one in a joint map "
                "(--joint-map)"
            )
        places[ours] = alike[0]
    return places


def _find(joint_map: JointMap, joints: Sequence[str], wanted: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of the joints of a file that may be the wanted ones, of those that it has."""
    exact: dict[str, list[int]] = {}
    for index, joint in enumerate(joints):
        exact.setdefault(joint, []).append(index)
    joints = _without_numbers(joints)
    affixes = _affixes(joint_map, joints)
    plain: dict[str, list[int]] = {}
    for index, joint in enumerate(joints):
        plain.setdefault(_plain(joint, affixes), []).append(index)
    found: dict[str, list[int]] = {}
    for ours in wanted:
        for name in joint_map.names.get(ours, ()):
            alike = exact.get(name) or plain.get(_bare(name), [])
            if alike:
                found.setdefault(ours, alike)
    return found


def _without_numbers(joints: Sequence[str]) -> Sequence[str]:
    """Return the names of joints without the number that Sketchfab appends to each, as in LeftHand_011."""
    plain = [_NUMBER.sub("", joint) for joint in joints]
    is_numbered = 2 * sum(name != joint for name, joint in zip(plain, joints, strict=True)) > len(joints)
    return plain if is_numbered and len(set(plain)) == len(plain) else joints


def _affixes(joint_map: JointMap, joints: Sequence[str]) -> list[tuple[str, str]]:
    """Return the prefixes and suffixes of the names of the map in the joints of a file.

    These are the most frequent pair and those that are more than half as frequent, such as that of a second person in
    the file; a pair that only one joint has does not count.
    """
    names = {_bare(name) for several in joint_map.names.values() for name in several} - {""}
    counts: collections.Counter[tuple[str, str]] = collections.Counter()
    for joint in map(str.casefold, joints):
        counts.update((before, behind) for before, found, behind in map(joint.partition, names) if found)
    return [affix for affix, count in counts.most_common() if count > 1 and 2 * count > max(counts.values())]


def _bare(name: str) -> str:
    """Return a name of a map without its namespace, in lower case."""
    return name[max(name.rfind(":"), name.rfind("|")) + 1 :].casefold()


def _plain(joint: str, affixes: Sequence[tuple[str, str]]) -> str:
    """Return the name of a joint without the first of the affixes that it has, in lower case."""
    name = joint.casefold()
    for before, behind in affixes:
        if name.startswith(before) and name.endswith(behind) and len(name) > len(before) + len(behind):
            return name[len(before) : len(name) - len(behind)]
    return name


def _lacks(
    file: str | pathlib.Path, joints: Sequence[str], joint_map: JointMap, places: Mapping[str, int], missing: list[str]
) -> UserError:
    names = {joint: " or ".join(joint_map.names.get(joint, ()))[:80] or "not in the map" for joint in missing}
    lacking = ", ".join(f"{joint} ({name})" for joint, name in list(names.items())[:_MAX_LISTED])
    if len(missing) > _MAX_LISTED:
        lacking += f" and {len(missing) - _MAX_LISTED} more"
    used = set(places.values())
    others = _listed([joint for index, joint in enumerate(joints) if index not in used])
    advice = "choose the skeleton ted_gesture, which has no fingers, or " if all(map(_is_finger, missing)) else ""
    return UserError(
        f"{shown(file)} does not fit the joint map {joint_map.name}: it lacks {lacking}; {advice}write a joint map "
        f"with an entry `{missing[0]}: NAME` for each joint and give it with --joint-map; other joints of the file: "
        f"{others}"
    )


def _unknown(file: str | pathlib.Path, joints: Sequence[str], missing: list[str]) -> UserError:
    return UserError(
        f"{shown(file)} fits no known joint map ({', '.join(MAPS)}); write one with an entry `{missing[0]}: NAME` for "
        f"each joint and give it with --joint-map; joints of the file: {_listed(joints)}"
    )


def _listed(joints: Sequence[str]) -> str:
    names = ", ".join(map(shown, joints))
    return names if len(names) <= _MAX_LISTED_LETTERS else f"{names[:_MAX_LISTED_LETTERS]}..."


def _is_finger(joint: str) -> bool:
    return joint.rstrip("123").endswith("_")

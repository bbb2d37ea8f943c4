"""The key of a study: which stimulus is which system and clip, and the answers that attention checks expect.

The site of a study names stimuli by opaque ids alone; `key.json`, which is not published, says what they are.
"""

import dataclasses
import json
import pathlib
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_json, shown
from ha2g_jax.files.writing import whole_file

RATING, PREFERENCE, MISMATCH, ATTENTION = "rating", "preference", "mismatch", "attention"
KINDS = (RATING, PREFERENCE, MISMATCH, ATTENTION)
"""Kinds of items: one clip rated on scales; two systems compared on a clip; the motion of a clip compared with that of
another clip, for the same sound; a clip that says which number to choose."""

SCALES = ("naturalness", "smoothness", "synchrony")
"""Scales of a rating, those of the paper's Table 2."""

POINTS = (1, 5)
"""Least and greatest number of a rating."""

_FORMAT, _VERSION = "ha2g-study-key", 1
_EXPECTED = "the key.json of a study, as ha2g study make writes it"
_MAX_BYTES = 1 << 26
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_HASH = re.compile(r"[0-9a-f]{64}")


class Stimulus(NamedTuple):
    """A video that participants see.

    Attributes:
        system: name of the system that made the motion.
        clip: clip that the motion was made for.
        matched: whether the sound is that of the clip.
        sound_of: clip whose sound the video has; None for an attention check, whose sound says a number.
        sha256: hash of the file, as 64 hexadecimal digits.
    """

    system: str
    clip: str
    matched: bool
    sound_of: str | None
    sha256: str


class Item(NamedTuple):
    """A question of the study.

    Attributes:
        id: name of the item.
        kind: one of `KINDS`.
        stimuli: id of the stimulus of a rating or an attention check, ids of both of a preference or a mismatch.
        expected: number that an attention check asks for, None for other kinds.
    """

    id: str
    kind: str
    stimuli: tuple[str, ...]
    expected: int | None = None


@dataclasses.dataclass(frozen=True)
class Key:
    """What the owner of a study keeps.

    Attributes:
        study: id of the study, which the answers repeat.
        title: title that participants see.
        seed: seed of the choices and of the order.
        created: time in ISO 8601.
        systems: names of the systems.
        clips: names of the clips.
        stimuli: stimuli by opaque id.
        items: all items.
        per_participant: number of items of each kind that a participant answers.
        scales: names of the scales of ratings.
        points: least and greatest number of a rating.
    """

    study: str
    title: str
    seed: int
    created: str
    systems: tuple[str, ...]
    clips: tuple[str, ...]
    stimuli: Mapping[str, Stimulus]
    items: tuple[Item, ...]
    per_participant: Mapping[str, int]
    scales: tuple[str, ...] = SCALES
    points: tuple[int, int] = POINTS


def write_key(path: pathlib.Path, key: Key) -> None:
    """Write a key, completely or not at all, so that only this user can read it.

    Args:
        path: `.json` file to write.
        key: key of a study.

    Raises:
        UserError: the file cannot be written.
    """
    content = {
        "format": _FORMAT,
        "version": _VERSION,
        **dataclasses.asdict(key),
        "stimuli": {name: stimulus._asdict() for name, stimulus in key.stimuli.items()},
        "items": [item_as_json(item) for item in key.items],
    }
    with whole_file(path) as temporary:
        temporary.chmod(0o600)
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def item_as_json(item: Item) -> dict[str, Any]:
    """Return an item as a JSON object, with the expected answer of an attention check."""
    stimuli = {"pair": list(item.stimuli)} if len(item.stimuli) == 2 else {"stimulus": item.stimuli[0]}
    expected = {} if item.expected is None else {"expected": item.expected}
    return {"id": item.id, "kind": item.kind, **stimuli, **expected}


def read_key(path: pathlib.Path) -> Key:
    """Read a key and check that its parts fit each other.

    Args:
        path: `key.json` of a study.

    Raises:
        UserError: the file cannot be read, is not a key, or names a stimulus, a system or a clip that it does not have.
    """
    content = read_json(path, _EXPECTED, _MAX_BYTES)
    try:
        return _parse(content)
    except (KeyError, TypeError, ValueError) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise UserError(f"{shown(path)} is not {_EXPECTED}: {shown(what)}") from error


def _parse(content: Any) -> Key:
    _check(isinstance(content, dict) and content.get("format") == _FORMAT, f'no "format": "{_FORMAT}"')
    _check(content.get("version") == _VERSION, f"version {content.get('version')!r}, expected {_VERSION}")
    systems, clips = _names(content["systems"], "systems"), _names(content["clips"], "clips")
    scales, points = _names(content["scales"], "scales"), tuple(_number(point) for point in content["points"])
    _check(len(points) == 2 and points[0] < points[1], "points are not two rising numbers")
    stimuli = {name: _stimulus(name, value, systems, clips) for name, value in _table(content["stimuli"]).items()}
    items = tuple(_item(value, stimuli, points) for value in content["items"])
    _check(len({item.id for item in items}) == len(items), "two items of one id")
    counts = {kind: _number(count) for kind, count in _table(content["per_participant"]).items()}
    _check(set(counts) <= set(KINDS), "per_participant has an unknown kind")
    study = _text(content["study"])
    _check(_ID.fullmatch(study) is not None, "study is not an id")
    return Key(
        study=study,
        title=_text(content["title"]),
        seed=_number(content["seed"]),
        created=_text(content["created"]),
        systems=systems,
        clips=clips,
        stimuli=stimuli,
        items=items,
        per_participant=counts,
        scales=scales,
        points=(points[0], points[1]),
    )


def _stimulus(name: str, value: Any, systems: tuple[str, ...], clips: tuple[str, ...]) -> Stimulus:
    _check(_ID.fullmatch(name) is not None, f"stimulus {name!r} is not an id")
    stimulus = Stimulus(**{field: _table(value)[field] for field in Stimulus._fields})
    _check(stimulus.system in systems, f"stimulus {name} is of an unknown system")
    _check(stimulus.clip in clips, f"stimulus {name} is of an unknown clip")
    _check(stimulus.sound_of is None or stimulus.sound_of in clips, f"stimulus {name} has the sound of no clip")
    _check(isinstance(stimulus.matched, bool), f"stimulus {name} is neither matched nor mismatched")
    _check(stimulus.matched == (stimulus.clip == stimulus.sound_of), f"stimulus {name} contradicts itself")
    _check(_HASH.fullmatch(_text(stimulus.sha256)) is not None, f"stimulus {name} has no SHA-256")
    return stimulus


def _item(value: Any, stimuli: Mapping[str, Stimulus], points: tuple[int, ...]) -> Item:
    name, kind = _text(_table(value)["id"]), _text(value["kind"])
    _check(_ID.fullmatch(name) is not None, f"item {name!r} is not an id")
    _check(kind in KINDS, f"item {name} is of an unknown kind")
    named = value["pair"] if kind in (PREFERENCE, MISMATCH) else [value["stimulus"]]
    _check(isinstance(named, list) and len(named) in (1, 2) and len(set(named)) == len(named), f"item {name}: stimuli")
    _check(len(named) == 2 or kind in (RATING, ATTENTION), f"item {name} has no pair")
    _check(all(stimulus in stimuli for stimulus in named), f"item {name} has an unknown stimulus")
    expected = _number(value["expected"]) if kind == ATTENTION else None
    _check(expected is None or points[0] <= expected <= points[1], f"item {name} expects a number out of range")
    item = Item(name, kind, tuple(named), expected)
    _check_pair(item, [stimuli[stimulus] for stimulus in named])
    return item


def _check_pair(item: Item, shown_together: list[Stimulus]) -> None:
    """Check that the two stimuli of a pair differ in what is asked for, and in nothing else."""
    if item.kind in (RATING, ATTENTION):
        return
    first, second = shown_together
    _check(first.sound_of == second.sound_of is not None, f"item {item.id} has two sounds")
    if item.kind == PREFERENCE:
        _check(first.matched and second.matched and first.system != second.system, f"item {item.id} is no preference")
    else:
        _check(first.matched != second.matched and first.system == second.system, f"item {item.id} is no mismatch")


def _check(is_right: bool, what: str) -> None:
    if not is_right:
        raise ValueError(what)


def _text(value: Any) -> str:
    _check(isinstance(value, str), "a value is not a text")
    return value


def _number(value: Any) -> int:
    _check(type(value) is int and value >= 0, "a value is not a whole number")
    return value


def _table(value: Any) -> dict[str, Any]:
    _check(isinstance(value, dict), "a value is not an object")
    return value


def _names(value: Any, what: str) -> tuple[str, ...]:
    _check(isinstance(value, list) and all(isinstance(name, str) and name for name in value), f"{what}: no names")
    _check(len(set(value)) == len(value), f"{what}: a name occurs twice")
    return tuple(value)

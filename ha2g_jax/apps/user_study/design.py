"""The design of a study: its items, balanced lists of them for participants, and the key that says what they show.

All choices are determined by the seed. Rows are systems, or pairs of systems, and columns are clips. A list holds the
same number of clips of every row. They are taken from the clips in a cycle that starts further on in the next list, so
that over all lists every item occurs equally often. Rows start at different clips of the cycle, as in a Latin square.

The site of a study names stimuli only by opaque ids; `key.json`, which is not published, says what they are.
"""

import collections
import dataclasses
import itertools
import json
import math
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_json, reading
from ha2g_jax.files.writing import whole_file

RATING, PREFERENCE, MISMATCH, ATTENTION = "rating", "preference", "mismatch", "attention"
KINDS = (RATING, PREFERENCE, MISMATCH, ATTENTION)
"""Kinds of items: one clip rated on scales; two systems compared on a clip; the motion of a clip compared with that of
another clip, for the same sound; a clip that says which number to choose."""

SCALES = ("naturalness", "smoothness", "synchrony")
"""Scales of a rating, those of the paper's Table 2."""

POINTS = (1, 5)
"""Least and greatest number of a rating."""

KEY_FILE = "key.json"
_FORMAT, _VERSION = "ha2g-study-key", 1
_EXPECTED = "the key.json of a study, as ha2g study make writes it"
_MAX_BYTES = 1 << 26

PARTS = (RATING, PREFERENCE, MISMATCH)
"""Parts of a protocol that a study may have, in any combination."""

_MAX_ITEMS = 20_000
_MAX_ATTENTION = POINTS[1]
_ID_BYTES = 8
_ROUNDING = 0.1  # seconds by which clips may differ and still count as equally long


class Stimulus(NamedTuple):
    """A video that participants see, with motion that was made for a clip.

    Attributes:
        matched: whether the sound is that of the clip.
        sound_of: clip whose sound the video has; None for an attention check, whose sound says a number.
        sha256: hash of the file, as 64 hexadecimal digits; empty before it is rendered.
    """

    system: str
    clip: str
    matched: bool
    sound_of: str | None
    sha256: str = ""


class Item(NamedTuple):
    """A question of the study, of a kind of `KINDS`: about one stimulus or both of a pair, by their ids.

    The number `expected` is what an attention check asks for, None for other kinds.
    """

    id: str
    kind: str
    stimuli: tuple[str, ...]
    expected: int | None = None


@dataclasses.dataclass(frozen=True)
class Key:
    """The private record of a study: its id, which the answers repeat, and its stimuli by opaque id.

    The time of creation is in ISO 8601. `per_participant` counts the items of each kind that a participant answers.
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
    """Write a key atomically, so that only this user can read it.

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


def read_key(study: pathlib.Path) -> Key:
    """Read the key of a study from its folder, or from the `key.json` in it.

    Raises:
        UserError: there is no such file, or it is no key of this version.
    """
    path = study / KEY_FILE if study.is_dir() else study
    content = read_json(path, _EXPECTED, _MAX_BYTES)
    with reading(path, _EXPECTED, LookupError, TypeError, AttributeError):
        if (content.pop("format"), content.pop("version")) != (_FORMAT, _VERSION):
            raise ValueError("it is of another version")
        content |= {name: tuple(content[name]) for name in ("systems", "clips", "scales", "points")}
        content["stimuli"] = {name: Stimulus(**value) for name, value in content["stimuli"].items()}
        content["items"] = tuple(
            Item(value["id"], value["kind"], tuple(value.get("pair") or [value["stimulus"]]), value.get("expected"))
            for value in content["items"]
        )
        for stimulus in (content["stimuli"][name] for item in content["items"] for name in item.stimuli):
            if not {stimulus.clip, stimulus.sound_of or stimulus.clip} <= {*content["clips"]}:
                raise ValueError(f"it has no clip {stimulus.clip}")
            content["systems"].index(stimulus.system)
        return Key(**content)


class Scene(NamedTuple):
    """Videos that are compared with each other, and so have the same sound, camera and length.

    The part is `MISMATCH` for pairs of that part, `ATTENTION` for a check, or else `RATING`. The sound of `clip` is
    heard; a check shows its motion and says `number`, which is None in other scenes.
    """

    part: str
    clip: str
    number: int | None = None


class Design(NamedTuple):
    """Stimuli of each scene by opaque id, items, lists of ids of items, and how many of each kind a list has."""

    scenes: Mapping[Scene, Mapping[str, Stimulus]]
    items: tuple[Item, ...]
    lists: tuple[tuple[str, ...], ...]
    per_participant: dict[str, int]


_Add = Callable[[Scene, str, str], str]


class _Row(NamedTuple):
    kind: str
    row: int  # number of the system, or of the pair of systems
    column: int  # number of the clip
    stimuli: tuple[str, ...]
    expected: int | None = None


def make_design(
    systems: Sequence[str],
    durations: Mapping[str, float],
    parts: Sequence[str],
    *,
    per_participant: int = 24,
    attention: int = 2,
    seed: int = 0,
) -> Design:
    """Design a study of parts of `PARTS`; equal arguments give equal designs.

    Args:
        durations: length in seconds of each clip.
        per_participant: maximum number of items of each part for a participant, who answers an equal number for every
            system, or pair of systems, and at least one.
        attention: number of attention checks that every participant answers, 0 to 5.

    Raises:
        UserError: the systems or the clips are too few for a part, or the study would have more than 20,000 items.
    """
    _check(systems, durations, parts, attention)
    random = np.random.default_rng(seed)
    clips = [str(clip) for clip in random.permutation(np.array(list(durations), dtype=object))]
    scenes: dict[Scene, dict[str, Stimulus]] = collections.defaultdict(dict)

    def add(scene: Scene, system: str, clip: str) -> str:
        """Add a stimulus to a scene, and return its id."""
        name, sound = random.bytes(_ID_BYTES).hex(), None if scene.part == ATTENTION else scene.clip
        scenes[scene][name] = Stimulus(system, clip, clip == sound, sound)
        return name

    rows = _main_rows(systems, clips, parts, add) if {RATING, PREFERENCE} & set(parts) else []
    if MISMATCH in parts:
        rows += _mismatch_rows(systems, clips, mismatched_clips(clips, durations), add)
    checks = _checks(systems, clips, attention, random, add)
    rows = [*(rows[index] for index in random.permutation(len(rows))), *checks]
    placed = []
    for number, entry in enumerate(rows, start=1):
        # The order of a pair must not tell which of them is which.
        shown = tuple(entry.stimuli[index] for index in random.permutation(len(entry.stimuli)))
        placed.append((Item(f"i{number:0{max(3, len(str(len(rows))))}}", entry.kind, shown, entry.expected), entry))
    lists, counts = _lists(placed, len(clips), per_participant, attention)
    return Design(scenes, tuple(item for item, _ in placed), lists, counts)


def mismatched_clips(clips: Sequence[str], durations: Mapping[str, float]) -> dict[str, str]:
    """Choose for each clip, of at least two, another one of about the same length, to show with the sound of the first.

    The motion of every clip is used once. The order of `clips` decides among clips of equal length.
    """
    ordered = sorted(clips, key=lambda clip: round(durations[clip] / _ROUNDING))
    pairs = [ordered[start : start + 2] for start in range(0, len(ordered) - len(ordered) % 2, 2)]
    if len(ordered) % 2:
        pairs[-1].append(ordered[-1])
    return {clip: group[(index + 1) % len(group)] for group in pairs for index, clip in enumerate(group)}


def _main_rows(systems: Sequence[str], clips: Sequence[str], parts: Sequence[str], add: _Add) -> list[_Row]:
    rows = []
    for column, clip in enumerate(clips):
        stimuli = [add(Scene(RATING, clip), system, clip) for system in systems]
        if RATING in parts:
            rows += [_Row(RATING, row, column, (stimulus,)) for row, stimulus in enumerate(stimuli)]
        if PREFERENCE in parts:
            pairs = itertools.combinations(stimuli, 2)
            rows += [_Row(PREFERENCE, row, column, pair) for row, pair in enumerate(pairs)]
    return rows


def _mismatch_rows(systems: Sequence[str], clips: Sequence[str], others: Mapping[str, str], add: _Add) -> list[_Row]:
    """Return the items of the mismatch; they share no stimuli, because a shared one would show that it is matched."""
    rows = []
    for column, clip in enumerate(clips):
        for row, system in enumerate(systems):
            pair = tuple(add(Scene(MISMATCH, clip), system, shown) for shown in (clip, others[clip]))
            rows.append(_Row(MISMATCH, row, column, pair))
    return rows


def _checks(
    systems: Sequence[str], clips: Sequence[str], count: int, random: np.random.Generator, add: _Add
) -> list[_Row]:
    rows = []
    for number in random.permutation(np.arange(POINTS[0], POINTS[1] + 1))[:count].tolist():
        clip, system = (names[int(random.integers(len(names)))] for names in (clips, systems))
        rows.append(_Row(ATTENTION, 0, 0, (add(Scene(ATTENTION, clip, number), system, clip),), number))
    return rows


def _lists(
    placed: Sequence[tuple[Item, _Row]], num_clips: int, per_participant: int, attention: int
) -> tuple[tuple[tuple[str, ...], ...], dict[str, int]]:
    """Return balanced lists, and the number of items of each kind in every list."""
    num_items = collections.Counter(item.kind for item, _ in placed if item.kind != ATTENTION)
    num_rows = {kind: num_items[kind] // num_clips for kind in PARTS if num_items[kind]}
    rounds = {kind: max(1, min(num_clips, per_participant // count)) for kind, count in num_rows.items()}
    num_lists = math.lcm(1, *(num_clips // math.gcd(num_clips, each) for each in rounds.values()))

    def has(number: int, entry: _Row) -> bool:
        """Return whether a list has an item: its share of the clips of each row, and all checks."""
        each = rounds.get(entry.kind)
        return each is None or (entry.column - (number + entry.row) * each) % num_clips < each

    lists = tuple(tuple(item.id for item, entry in placed if has(number, entry)) for number in range(num_lists))
    return lists, {kind: each * num_rows[kind] for kind, each in rounds.items()} | {ATTENTION: attention}


def _check(systems: Sequence[str], durations: Mapping[str, float], parts: Sequence[str], attention: int) -> None:
    if PREFERENCE in parts and len(systems) < 2:
        raise UserError(f"a preference compares two systems, and there is only {systems[0]}; give another folder")
    if MISMATCH in parts and len(durations) < 2:
        raise UserError("mismatched speech needs the motion of another clip, and there is only one clip; give more")
    if not 0 <= attention <= _MAX_ATTENTION:
        raise UserError(f"{attention} attention checks; expected 0 to {_MAX_ATTENTION}")
    count = len(durations) * sum(
        math.comb(len(systems), 2) if part == PREFERENCE else len(systems) for part in set(parts)
    )
    if count > _MAX_ITEMS:
        raise UserError(
            f"the study would have {count} items; expected at most {_MAX_ITEMS}, give --clips or fewer systems"
        )

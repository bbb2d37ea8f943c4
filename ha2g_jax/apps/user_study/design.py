"""The design of a study: its stimuli, its items, and balanced lists of items for participants.

All choices are functions of the seed. Rows are systems, or pairs of systems, and columns are clips. A list holds the
same number of clips of every row, taken from the clips in a cycle that starts further on in the next list, so that over
all lists every item occurs equally often. Rows start at different clips of the cycle, as in a Latin square.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.apps.user_study.key import ATTENTION, MISMATCH, POINTS, PREFERENCE, RATING, Item
from ha2g_jax.errors import UserError

PARTS = (RATING, PREFERENCE, MISMATCH)
"""Parts of a protocol that a study may have, in any combination."""

_MAX_ITEMS = 20_000
_MAX_ATTENTION = POINTS[1]
_ID_BYTES = 8
_ROUNDING = 0.1  # seconds by which clips may differ and still count as equally long


class Scene(NamedTuple):
    """Videos that are compared with each other, and so have one sound, one camera and one length.

    Attributes:
        part: `MISMATCH` for pairs of that part, `ATTENTION` for a check, or else `RATING`.
        clip: clip whose sound is heard, and whose motion is shown in a check.
        number: number that a check says, None in other scenes.
    """

    part: str
    clip: str
    number: int | None = None


class Planned(NamedTuple):
    """A stimulus that is to be rendered: a motion in a scene.

    Attributes:
        id: opaque name.
        scene: sound, camera and length.
        system: system that made the motion.
        clip: clip that the motion was made for.
    """

    id: str
    scene: Scene
    system: str
    clip: str


class Design(NamedTuple):
    """The design of a study.

    Attributes:
        stimuli: all stimuli, in the order of their ids.
        items: all items, in the order of their ids.
        lists: ids of the items of each list; a participant answers one list.
        per_participant: number of items of each kind in a list.
    """

    stimuli: tuple[Planned, ...]
    items: tuple[Item, ...]
    lists: tuple[tuple[str, ...], ...]
    per_participant: dict[str, int]


class _Row(NamedTuple):
    kind: str
    row: int  # number of the system, or of the pair of systems
    column: int  # number of the clip
    stimuli: tuple[Planned, ...]


def make_design(
    systems: Sequence[str],
    durations: Mapping[str, float],
    parts: Sequence[str],
    *,
    per_participant: int = 24,
    attention: int = 2,
    seed: int = 0,
) -> Design:
    """Design a study.

    Args:
        systems: names of the systems.
        durations: length in seconds of each clip.
        parts: parts of the protocol, of `PARTS`.
        per_participant: items of each part that a participant answers at most; a participant answers an equal number
            for every system, or pair of systems, and at least one.
        attention: number of attention checks that every participant answers, 0 to 5.
        seed: seed of all choices.

    Returns:
        The design, equal for equal arguments.

    Raises:
        UserError: the systems or the clips are too few for a part, or the study would have more than 20,000 items.
    """
    _check(systems, durations, parts, per_participant, attention)
    random = np.random.default_rng(seed)
    clips = [str(clip) for clip in random.permutation(np.array(list(durations), dtype=object))]
    ids = _Ids(random)
    rows = [*_main_rows(systems, clips, parts, ids)]
    if MISMATCH in parts:
        rows += _mismatch_rows(systems, clips, mismatched_clips(clips, durations), ids)
    checks = _checks(systems, clips, attention, random, ids)
    rows = [rows[index] for index in random.permutation(len(rows))]
    placed = []
    digits = max(3, len(str(len(rows) + len(checks))))
    for number, entry in enumerate([*rows, *checks], start=1):
        # The order of a pair must not tell which of them is which.
        shown = tuple(entry.stimuli[index].id for index in random.permutation(len(entry.stimuli)))
        item = Item(f"i{number:0{digits}}", entry.kind, shown, entry.stimuli[0].scene.number)
        placed.append((item, entry))
    lists, counts = _lists(placed, len(clips), per_participant, attention)
    used = {stimulus.id: stimulus for entry in [*rows, *checks] for stimulus in entry.stimuli}
    return Design(tuple(used[name] for name in sorted(used)), tuple(item for item, _ in placed), lists, counts)


def mismatched_clips(clips: Sequence[str], durations: Mapping[str, float]) -> dict[str, str]:
    """Choose for each clip another one of about the same length, whose motion is shown with the sound of the first.

    The motion of every clip is used once. Neighbours in the order of length are exchanged, and the last three in a
    circle if the number of clips is odd.

    Args:
        clips: two clips or more; their order decides among clips of equal length.
        durations: length in seconds of each clip.
    """
    ordered = sorted(clips, key=lambda clip: round(durations[clip] / _ROUNDING))
    pairs = [ordered[start : start + 2] for start in range(0, len(ordered) - len(ordered) % 2, 2)]
    if len(ordered) % 2:
        pairs[-1].append(ordered[-1])
    return {clip: group[(index + 1) % len(group)] for group in pairs for index, clip in enumerate(group)}


class _Ids:
    """Opaque names of stimuli, all different."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random, self._given = random, set[str]()

    def draw(self) -> str:
        while (name := self._random.bytes(_ID_BYTES).hex()) in self._given:
            pass
        self._given.add(name)
        return name


def _main_rows(systems: Sequence[str], clips: Sequence[str], parts: Sequence[str], ids: _Ids) -> list[_Row]:
    """Return the items of ratings and preferences, which share their stimuli."""
    if not {RATING, PREFERENCE} & set(parts):
        return []
    rows = []
    for column, clip in enumerate(clips):
        stimuli = [Planned(ids.draw(), Scene(RATING, clip), system, clip) for system in systems]
        if RATING in parts:
            rows += [_Row(RATING, row, column, (stimulus,)) for row, stimulus in enumerate(stimuli)]
        if PREFERENCE in parts:
            pairs = itertools.combinations(stimuli, 2)
            rows += [_Row(PREFERENCE, row, column, pair) for row, pair in enumerate(pairs)]
    return rows


def _mismatch_rows(systems: Sequence[str], clips: Sequence[str], others: Mapping[str, str], ids: _Ids) -> list[_Row]:
    """Return the items of the mismatch; their stimuli are their own, as a shared one would show that it is matched."""
    return [
        _Row(
            MISMATCH,
            row,
            column,
            tuple(Planned(ids.draw(), Scene(MISMATCH, clip), system, shown) for shown in (clip, others[clip])),
        )
        for column, clip in enumerate(clips)
        for row, system in enumerate(systems)
    ]


def _checks(
    systems: Sequence[str], clips: Sequence[str], count: int, random: np.random.Generator, ids: _Ids
) -> list[_Row]:
    numbers = random.permutation(np.arange(POINTS[0], POINTS[1] + 1))[:count].tolist()
    rows = []
    for number in numbers:
        clip, system = (names[int(random.integers(len(names)))] for names in (clips, systems))
        rows.append(_Row(ATTENTION, 0, 0, (Planned(ids.draw(), Scene(ATTENTION, clip, number), system, clip),)))
    return rows


def _lists(
    placed: Sequence[tuple[Item, _Row]], num_clips: int, per_participant: int, attention: int
) -> tuple[tuple[tuple[str, ...], ...], dict[str, int]]:
    """Return balanced lists, and the number of items of each kind in every list."""
    num_rows: dict[str, int] = {}
    for _, entry in placed:
        num_rows[entry.kind] = max(num_rows.get(entry.kind, 0), entry.row + 1)
    # Clips of each row in a list; the checks are in every list.
    rounds = {
        kind: max(1, min(num_clips, per_participant // count)) for kind, count in num_rows.items() if kind != ATTENTION
    }
    num_lists = math.lcm(1, *(num_clips // math.gcd(num_clips, each) for each in rounds.values()))
    lists = []
    for number in range(num_lists):
        chosen = []
        for item, entry in placed:
            if entry.kind != ATTENTION:
                each = rounds[entry.kind]
                if (entry.column - number * each - entry.row * each) % num_clips >= each:
                    continue
            chosen.append(item.id)
        lists.append(tuple(chosen))
    counts = {kind: each * num_rows[kind] for kind, each in rounds.items()}
    return tuple(lists), {kind: counts[kind] for kind in PARTS if kind in counts} | {ATTENTION: attention}


def _check(
    systems: Sequence[str], durations: Mapping[str, float], parts: Sequence[str], per_participant: int, attention: int
) -> None:
    if not parts or set(parts) - set(PARTS):
        raise UserError(f"the protocol is {', '.join(parts) or 'empty'}; give one or more of {', '.join(PARTS)}")
    if PREFERENCE in parts and len(systems) < 2:
        raise UserError(f"a preference compares two systems, and there is only {systems[0]}; give another folder")
    if MISMATCH in parts and len(durations) < 2:
        raise UserError("mismatched speech needs the motion of another clip, and there is only one clip; give more")
    if per_participant < 1:
        raise UserError(f"{per_participant} items for a participant; expected 1 or more")
    if not 0 <= attention <= _MAX_ATTENTION:
        raise UserError(f"{attention} attention checks; expected 0 to {_MAX_ATTENTION}")
    count = len(durations) * sum(
        math.comb(len(systems), 2) if part == PREFERENCE else len(systems) for part in set(parts)
    )
    if count > _MAX_ITEMS:
        raise UserError(
            f"the study would have {count} items; expected at most {_MAX_ITEMS}, give --clips or fewer systems"
        )

"""Answers of all participants as arrays, one row for each answer."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.apps.user_study.answers import Participant
from ha2g_jax.apps.user_study.key import MISMATCH, PREFERENCE, RATING, Item, Key

MISMATCHED = "mismatched speech"
"""What is added to the name of a system whose clips are rated with the speech of another clip."""


class Ratings(NamedTuple):
    """Ratings, n of them.

    Attributes:
        systems: names that `system` refers to.
        participant: (n,) index of the participant.
        clip: (n,) index of the clip whose sound is heard.
        system: (n,) index of the system.
        item: (n,) index of the item.
        scores: (n, scales) numbers that were chosen.
    """

    systems: tuple[str, ...]
    participant: np.ndarray
    clip: np.ndarray
    system: np.ndarray
    item: np.ndarray
    scores: np.ndarray


class Choices(NamedTuple):
    """Choices between the two stimuli of a pair, n of them.

    Attributes:
        participant: (n,) index of the participant.
        clip: (n,) index of the clip whose sound is heard.
        item: (n,) index of the item.
        first: (n,) index of the system of the first stimulus.
        second: (n,) index of the system of the second stimulus.
        outcome: (n,) 1 if the first one was preferred, -1 if the second one was, 0 if they were equal.
    """

    participant: np.ndarray
    clip: np.ndarray
    item: np.ndarray
    first: np.ndarray
    second: np.ndarray
    outcome: np.ndarray

    def where(self, is_kept: np.ndarray) -> "Choices":
        """Return the choices at which a mask (n,) is true."""
        return Choices(*(column[is_kept] for column in self))


def ratings_of(participants: Sequence[Participant], key: Key) -> Ratings:
    """Collect the ratings of all participants.

    Args:
        participants: participants who are kept.
        key: key of the study.
    """
    names = list(key.systems)
    items = {item.id: number for number, item in enumerate(key.items)}
    rows, scores = [], []
    for number, participant in enumerate(participants):
        for answer in participant.answers:
            if answer.item.kind == RATING:
                stimulus = key.stimuli[answer.item.stimuli[0]]
                name = stimulus.system if stimulus.matched else f"{stimulus.system}, {MISMATCHED}"
                if name not in names:
                    names.append(name)
                rows.append((number, _clip(answer.item, key), names.index(name), items[answer.item.id]))
                scores.append(answer.ratings)
    used = sorted({row[2] for row in rows})
    participant, clip, system, item = np.array(rows, int).reshape(-1, 4).T
    return Ratings(
        tuple(names[index] for index in used),
        participant,
        clip,
        np.searchsorted(used, system),
        item,
        np.array(scores, float).reshape(-1, len(key.scales)),
    )


def preferences_of(participants: Sequence[Participant], key: Key) -> Choices:
    """Collect the choices between two systems; the first of a pair is the one that the key names first.

    Args:
        participants: participants who are kept.
        key: key of the study, whose `systems` the indices refer to.
    """
    return _choices(participants, key, PREFERENCE)


def mismatches_of(participants: Sequence[Participant], key: Key) -> Choices:
    """Collect the choices between motion with its own speech, the first of a pair here, and motion of another clip.

    Args:
        participants: participants who are kept.
        key: key of the study, whose `systems` the indices refer to.
    """
    return _choices(participants, key, MISMATCH)


def _choices(participants: Sequence[Participant], key: Key, kind: str) -> Choices:
    items = {item.id: number for number, item in enumerate(key.items)}
    systems = {name: number for number, name in enumerate(key.systems)}
    rows = []
    for number, participant in enumerate(participants):
        for answer in participant.answers:
            if answer.item.kind == kind:
                pair, outcome = answer.item.stimuli, answer.outcome
                if _is_turned(answer.item, key, systems):
                    pair, outcome = pair[::-1], -outcome
                first, second = (systems[key.stimuli[stimulus].system] for stimulus in pair)
                rows.append((number, _clip(answer.item, key), items[answer.item.id], first, second, outcome))
    return Choices(*np.array(rows, int).reshape(-1, 6).T)


def _is_turned(item: Item, key: Key, systems: dict[str, int]) -> bool:
    """Return whether the second stimulus of a pair is the matched one, or the one of the earlier system."""
    first, second = (key.stimuli[stimulus] for stimulus in item.stimuli)
    if item.kind == MISMATCH:
        return second.matched
    return systems[first.system] > systems[second.system]


def _clip(item: Item, key: Key) -> int:
    stimulus = key.stimuli[item.stimuli[0]]
    return key.clips.index(stimulus.sound_of or stimulus.clip)

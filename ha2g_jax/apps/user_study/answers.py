"""Strict reading of answer files: each is kept whole, or excluded with a reason. Nothing in a file is ever run."""

import datetime
import math
import pathlib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.apps.user_study.design import ATTENTION, MISMATCH, RATING, Item, Key
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_regular, files_below, read_json, resolved, shown
from ha2g_jax.limits import MAX_ANSWER_BYTES, MAX_ANSWER_FILES
from ha2g_jax.progress import progress_bar

_FORMAT, _VERSION = "ha2g-study-answers", 1
_EXPECTED = "an answer file of a study"
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_CHOICES = ("left", "right", "equal")
_NAMED = 3  # items that a reason names
_MAX_COMMENTS = 2000  # characters


class Answer(NamedTuple):
    """What a participant answered to an item.

    Attributes:
        ratings: number for each scale of the key, or for an attention check the number that was chosen.
        outcome: for a pair of stimuli, 1 if the first one in the key was preferred, -1 if the second one was, else 0.
    """

    item: Item
    ratings: tuple[int, ...] = ()
    outcome: int = 0


class Participant(NamedTuple):
    """A participant whose answers are complete and well-formed, in the order of the file, whose name is printable."""

    id: str
    file: str
    finished: datetime.datetime
    answers: tuple[Answer, ...]
    comments: str


class Exclusion(NamedTuple):
    """An excluded file: its name as printable text, the participant if the file has a valid name, and the reason."""

    file: str
    participant: str
    reason: str


class Answers(NamedTuple):
    """All files: participants in the order of their names, and what is left out in the order of the files."""

    participants: tuple[Participant, ...]
    excluded: tuple[Exclusion, ...]


def read_answers(paths: Sequence[pathlib.Path], key: Key) -> Answers:
    """Read answer files, and all files of folders; one that does not fit the study or the format is excluded.

    Of several files with the same participant, only the one that was finished first may be kept, so that a failed
    attention check is not repaired by a second try.

    Raises:
        UserError: there is nothing at a path, a folder has no answer file, or there are too many files.
    """
    files = _files(paths)
    complete: list[tuple[Participant, str, pathlib.Path]] = []
    excluded: dict[pathlib.Path, Exclusion] = {}
    with progress_bar("reading answers", len(files), "file") as bar:
        for path in files:
            participant = ""
            try:
                check_regular(path, _EXPECTED)
                content = read_json(path, _EXPECTED, MAX_ANSWER_BYTES)
                participant = _name_of(content)
                complete.append((*_participant(content, path, key), path))
            except (UserError, ValueError) as error:  # a UserError begins with the name of the file
                excluded[path] = Exclusion(shown(path), participant, str(error).removeprefix(f"{shown(path)} "))
            bar.update()
    firsts, kept = dict[str, Participant](), dict[str, Participant]()
    for one, failure, path in sorted(complete, key=lambda each: (each[0].finished, each[2])):
        first = firsts.setdefault(one.id, one)
        if first is not one:
            is_copy = one.answers == first.answers
            what = "a copy of the answers" if is_copy else "further answers, finished later,"
            failure = f"{what} of participant {one.id}; {first.file} is the first"
        if failure:
            excluded[path] = Exclusion(one.file, one.id, failure)
        else:
            kept[one.id] = one
    return Answers(
        tuple(kept[name] for name in sorted(kept)), tuple(excluded[path] for path in files if path in excluded)
    )


def _files(paths: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    found: dict[pathlib.Path, pathlib.Path] = {}
    for path in paths:
        inside = [path]
        if path.is_dir():
            inside = sorted(each for each in files_below(path) if not each.name.startswith("."))
            if not inside:
                raise UserError(f"{shown(path)} has no file; give the answer files of a study, or their folder")
        elif not path.exists():
            raise UserError(f"no file or folder at {shown(path)}; give the answer files of a study")
        for each in inside:
            found.setdefault(resolved(each), each)
    if len(found) > MAX_ANSWER_FILES:
        raise UserError(f"{len(found)} answer files, at most {MAX_ANSWER_FILES} can be analysed together")
    return list(found.values())


def _name_of(content: Any) -> str:
    name = content.get("participant") if isinstance(content, dict) else None
    return name if isinstance(name, str) and _ID.fullmatch(name) else ""


def _participant(content: Any, path: pathlib.Path, key: Key) -> tuple[Participant, str]:
    """Check a whole file; the message of the ValueError is the reason for its exclusion.

    Returns:
        The participant, and why complete answers do not count, "" if they do.
    """
    _check(isinstance(content, dict), "not a JSON object")
    _check(content.get("format") == _FORMAT, f'no "format": "{_FORMAT}"')
    _check(
        type(content.get("version")) is int and content["version"] == _VERSION, f"not of version {_VERSION} of the form"
    )
    study = _id(content.get("study"), "study")
    _check(study == key.study, f"answers of another study, {study}")
    name = _id(content.get("participant"), "participant")
    _check(content.get("consent") is True, "no consent")
    _time(content.get("started"), "started")
    finished = _time(content.get("finished"), "finished")
    comments = content.get("comments", "")
    _check(isinstance(comments, str), "comments are not text")
    _check(len(comments) <= _MAX_COMMENTS, f"comments of more than {_MAX_COMMENTS} characters")
    answers = tuple(_answers(content, key))
    checks = [answer for answer in answers if answer.item.kind == ATTENTION]
    failed = sum(answer.ratings != (answer.item.expected,) for answer in checks)
    failure = f"failed {failed} of {len(checks)} attention checks" if failed else ""
    return Participant(name, shown(path), finished, answers, comments), failure


def _answers(content: Mapping[str, Any], key: Key) -> Iterator[Answer]:
    items = {item.id: item for item in key.items}
    given = _list(content.get("answers"), "answers are not a list")
    _check(len(given) <= len(items), f"{len(given)} answers, but the study has {len(items)} items")
    seen: dict[str, str] = {}
    for value in given:
        _check(isinstance(value, dict), "an answer is not an object")
        name = _id(value.get("item"), "item of an answer")
        _check(name in items, f"unknown item {name}")
        _check(name not in seen, f"item {name} is answered twice")
        seen[name] = items[name].kind
        yield _answer(value, items[name], key)
    order = _list(content.get("order"), "order is not a list")
    _check(len(order) <= len(items), f"an order of {len(order)} items, but the study has {len(items)}")
    order = [_id(name, "item of the order") for name in order]
    _check(set(order) <= items.keys(), "order has an unknown item")
    missing = [name for name in order if name not in seen]
    more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
    _check(not missing, f"missing items: {', '.join(missing[:_NAMED])}{more}")
    _check(len(order) == len(seen), "order and answers have different items")
    for kind in {item.kind for item in key.items}:
        count, expected = list(seen.values()).count(kind), key.per_participant.get(kind, 0)
        _check(count >= expected, f"missing items: {count} of kind {kind}, {expected} are asked for")
        _check(count <= expected, f"{count} items of kind {kind}, only {expected} are asked for")


def _answer(value: Mapping[str, Any], item: Item, key: Key) -> Answer:
    where = f"item {item.id}"
    _check(value.get("kind") == item.kind, f"{where} is not of the kind of the study")
    seconds = value.get("seconds", 0)
    is_number = type(seconds) in (int, float) and (type(seconds) is int or math.isfinite(seconds))
    _check(is_number and seconds >= 0, f"{where}: seconds are not a number from 0 up")
    _check(type(value.get("plays", 0)) is int and value.get("plays", 0) >= 0, f"{where}: plays are not a whole number")
    if item.kind in (RATING, ATTENTION):
        _check(value.get("stimulus") == item.stimuli[0], f"{where} has another stimulus than in the study")
        if item.kind == ATTENTION:
            return Answer(item, ratings=(_point(value.get("answer"), where, key),))
        ratings = value.get("ratings", {})
        _check(isinstance(ratings, dict), f"{where}: ratings are not an object")
        _check(set(ratings) == set(key.scales), f"{where}: ratings are not those of {', '.join(key.scales)}")
        return Answer(item, ratings=tuple(_point(ratings[scale], where, key) for scale in key.scales))
    left, right, choice = (value.get(name) for name in ("left", "right", "choice"))
    _check((left, right) in (item.stimuli, item.stimuli[::-1]), f"{where} has other stimuli than in the study")
    _check(choice in _CHOICES, f"{where}: the choice is not one of {', '.join(_CHOICES)}")
    if choice == "equal":
        return Answer(item)
    return Answer(item, outcome=1 if (left if choice == "left" else right) == item.stimuli[0] else -1)


def _point(value: Any, where: str, key: Key) -> int:
    low, high = key.points
    _check(type(value) is int and low <= value <= high, f"{where}: not a whole number from {low} to {high}")
    return value


def _list(value: Any, what: str) -> list[Any]:
    _check(isinstance(value, list), what)
    return value


def _id(value: Any, what: str) -> str:
    _check(isinstance(value, str) and _ID.fullmatch(value) is not None, f"{what}: not an id")
    return value


def _time(value: Any, what: str) -> datetime.datetime:
    _check(isinstance(value, str), f"{what}: not a time in ISO 8601")
    try:
        time = datetime.datetime.fromisoformat(value)
    except ValueError:
        raise ValueError(f"{what}: not a time in ISO 8601") from None
    return time if time.tzinfo else time.replace(tzinfo=datetime.UTC)


def _check(is_right: bool, what: str) -> None:
    if not is_right:
        raise ValueError(what)


class Ratings(NamedTuple):
    """n ratings: indices (n,) of participant, clip and system, and the chosen numbers (n, scales).

    A system is an index of `systems`, and the clip is the one whose sound is heard.
    """

    systems: tuple[str, ...]
    participant: np.ndarray
    clip: np.ndarray
    system: np.ndarray
    item: np.ndarray
    scores: np.ndarray


class Choices(NamedTuple):
    """n choices between the two stimuli of a pair: indices (n,) of participant, clip and systems, and the outcome.

    The clip is the one whose sound is heard; `first` and `second` are indices in `Key.systems`, and the outcome is 1 if
    the first one was preferred, -1 if the second one was, 0 if they were equal.
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
    """Collect the ratings of all participants."""
    rows, scores = [], []
    for number, item, answer in _answers_of(participants, key, RATING):
        stimulus = key.stimuli[answer.item.stimuli[0]]
        rows.append((number, key.clips.index(stimulus.clip), key.systems.index(stimulus.system), item))
        scores.append(answer.ratings)
    participant, clip, system, item = np.array(rows, int).reshape(-1, 4).T
    used, system = np.unique(system, return_inverse=True)
    names = tuple(key.systems[index] for index in used)
    return Ratings(names, participant, clip, system, item, np.array(scores, float).reshape(-1, len(key.scales)))


def choices_of(participants: Sequence[Participant], key: Key, kind: str) -> Choices:
    """Collect the choices of a kind of pairs; the first one is the key's first system, or the matched motion."""
    rows = []
    for number, item, answer in _answers_of(participants, key, kind):
        first, second = (key.stimuli[name] for name in answer.item.stimuli)
        systems = key.systems.index(first.system), key.systems.index(second.system)
        outcome = answer.outcome
        if second.matched if kind == MISMATCH else systems[0] > systems[1]:
            systems, outcome = systems[::-1], -outcome
        rows.append((number, key.clips.index(first.sound_of or first.clip), item, *systems, outcome))
    return Choices(*np.array(rows, int).reshape(-1, 6).T)


def _answers_of(participants: Sequence[Participant], key: Key, kind: str) -> Iterator[tuple[int, int, Answer]]:
    """Yield the answers of a kind, each after the indices of its participant and its item."""
    items = {item.id: number for number, item in enumerate(key.items)}
    for number, participant in enumerate(participants):
        for answer in participant.answers:
            if answer.item.kind == kind:
                yield number, items[answer.item.id], answer

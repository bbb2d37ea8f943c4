"""Answer files that do not fit are left out with a reason, never run, and the others are read."""

import copy
import json

import numpy as np
import pytest
from fixtures.simulated_study import make_answers, make_key
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_tree
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.apps.user_study.answers import choices_of, ratings_of, read_answers
from ha2g_jax.apps.user_study.design import MISMATCH, PREFERENCE, RATING
from ha2g_jax.limits import MAX_ANSWER_BYTES


@pytest.fixture
def key():
    return make_key()


@pytest.fixture
def content(key):
    return make_answers(key, "p00", np.random.default_rng(0))


def read(folder, key, *contents):
    """Read the files of a folder after writing contents to it as 0.json, 1.json and so on."""
    for number, content in enumerate(contents):
        (folder / f"{number}.json").write_text(json.dumps(content))
    return read_answers([folder], key)


def at(kind, content):
    return next(answer for answer in content["answers"] if answer["kind"] == kind)


def changed(**changes):
    return lambda content: content.update(changes)


def first_of(kind, /, **changes):
    return lambda content: at(kind, content).update(changes)


HOSTILE = {
    "other study": (changed(study="deadbeef"), "another study, deadbeef"),
    "participant of markup": (changed(participant="<img src=x onerror=alert(1)>"), "participant: not an id"),
    "no consent": (changed(consent=False), "no consent"),
    "long comments": (changed(comments="x" * 2001), "comments of more than 2000 characters"),
    "missing items": (lambda content: content["answers"].pop(3), "missing items: i"),
    "items that were never shown": (
        lambda content: (content["answers"].pop(0), content["order"].pop(0)),
        "missing items: 11 of kind rating, 12 are asked for",
    ),
    "item in place of another": (
        lambda content: content["answers"].__setitem__(1, copy.deepcopy(content["answers"][0])),
        "is answered twice",
    ),
    "other stimuli": (first_of(PREFERENCE, left="s999"), "other stimuli"),
    "choice that is a list": (first_of(PREFERENCE, choice=["left"]), "the choice is not one of"),
    "rating that is true": (
        first_of(RATING, ratings=dict.fromkeys(("naturalness", "smoothness", "synchrony"), True)),
        "not a whole number from 1 to 5",
    ),
    "attention check": (first_of("attention", answer=1), "failed 1 of 1 attention checks"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_an_answer_file_that_does_not_fit_is_excluded(case, key, content, tmp_path):
    good = copy.deepcopy(content) | {"participant": "good"}
    change, reason = HOSTILE[case]
    change(content)
    found = read(tmp_path, key, good, content)
    assert [one.id for one in found.participants] == ["good"]
    (exclusion,) = found.excluded
    assert exclusion.file.endswith("1.json") and reason in exclusion.reason and len(exclusion.reason) < 300
    assert exclusion.participant in ("", "p00") and exclusion.reason.isprintable()


FILES = {
    "deep": (b"[" * 100 + b"]" * 100, "nested too deep"),
    "python": (b"__import__('os').system('touch executed')", "is not an answer file"),
    "huge": (bytes(MAX_ANSWER_BYTES + 1), f"has more than {MAX_ANSWER_BYTES} bytes"),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_is_no_answer_is_excluded(case, key, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data, reason = FILES[case]
    (tmp_path / "bad.json").write_bytes(data)
    found = read(tmp_path, key)
    assert not found.participants and reason in found.excluded[0].reason
    assert [path.name for path in tmp_path.iterdir()] == ["bad.json"]


def test_no_file_of_a_folder_is_passed_over(key, content, tmp_path):
    (tmp_path / "later").mkdir()
    for name, one in (("0.json", "p00"), ("1.txt", "p01"), ("2", "p02"), ("later/0.json", "p03")):
        (tmp_path / name).write_text(json.dumps(make_answers(key, one, np.random.default_rng(0))))
    (tmp_path / "notes.txt").write_text("two came late")
    found = read_answers([tmp_path], key)
    assert [one.id for one in found.participants] == ["p00", "p01", "p02", "p03"]
    assert [one.file.endswith("notes.txt") for one in found.excluded] == [True]


def test_of_two_files_of_a_participant_the_first_is_kept(key, content, tmp_path):
    later = make_answers(key, "p00", np.random.default_rng(1)) | {"finished": "2026-02-03T06:00:00+01:00"}
    found = read(tmp_path, key, later, content, content)
    assert [one.file[-6:] for one in found.participants] == ["1.json"]
    further, copied = found.excluded
    assert further.reason.startswith("further answers, finished later") and copied.reason.startswith("a copy of")


def test_a_second_try_does_not_repair_a_failed_attention_check(key, content, tmp_path):
    failed = copy.deepcopy(content)
    first_of("attention", answer=1)(failed)
    found = read(tmp_path, key, content | {"finished": "2027-02-03T06:00:00+01:00"}, failed)
    assert not found.participants
    second, first = found.excluded
    assert "failed 1 of 1 attention checks" in first.reason and "finished later, of participant p00" in second.reason


@FUZZ
@given(data=st.data())
def test_damaged_answers_are_read_or_excluded(data, tmp_path):
    key = make_key()
    content = data.draw(damaged_tree(make_answers(key, "p00", np.random.default_rng(0))))
    with one_line():
        found = read(tmp_path, key, content)
    assert len(found.participants) + len(found.excluded) == 1
    assert all(exclusion.reason.isprintable() for exclusion in found.excluded)


def test_times_at_the_ends_of_the_calendar_can_be_compared(key, content, tmp_path):
    times = "0001-01-01T00:00:00+23:59", "9999-12-31T23:59:59-23:59", "2026-01-01"
    assert len(read(tmp_path, key, *(content | {"finished": time} for time in times)).participants) == 1


def test_a_file_that_is_named_twice_counts_once(key, content, tmp_path):
    (tmp_path / "p00.json").write_text(json.dumps(content))
    found = read_answers([tmp_path, tmp_path / "p00.json", tmp_path], key)
    assert len(found.participants) == 1 and not found.excluded


def test_choices_are_about_systems_and_not_about_sides(key, content, tmp_path):
    """Whatever side and order of the pair, 1 is for the earlier system, and for the matched motion."""
    matched = {name for name, stimulus in key.stimuli.items() if stimulus.matched}
    for answer in content["answers"]:
        if answer["kind"] in ("preference", "mismatch"):
            left, right = (key.stimuli[answer[side]] for side in ("left", "right"))
            is_left = answer["left"] in matched if answer["kind"] == "mismatch" else left.system < right.system
            answer["choice"] = "left" if is_left else "right"
    found = read(tmp_path, key, content).participants
    preferences, mismatches = (choices_of(found, key, kind) for kind in (PREFERENCE, MISMATCH))
    assert (preferences.outcome == 1).all() and (preferences.first < preferences.second).all()
    assert (mismatches.outcome == 1).all()
    assert set(mismatches.first) == {0, 1, 2} and set(mismatches.clip) == {0, 1, 2, 3}


def test_ratings_are_those_of_the_file(key, content, tmp_path):
    ratings = ratings_of(read(tmp_path, key, content).participants, key)
    assert ratings.systems == key.systems and ratings.scores.shape == (12, 3)
    answer = at(RATING, content)
    row = next(n for n in range(12) if key.items[ratings.item[n]].id == answer["item"])
    stimulus = key.stimuli[answer["stimulus"]]
    assert ratings.scores[row].tolist() == list(answer["ratings"].values())
    assert (key.systems[ratings.system[row]], key.clips[ratings.clip[row]]) == (stimulus.system, stimulus.clip)

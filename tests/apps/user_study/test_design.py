"""The design of a study: every item occurs equally often over the lists, and all choices follow from the seed."""

import collections
import dataclasses
import json
import math

import pytest
from fixtures.simulated_study import EXPECTED, make_key
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.apps.user_study.design import PARTS, make_design, mismatched_clips, read_key, write_key
from ha2g_jax.errors import UserError

SYSTEMS = ("a", "b", "c")
DURATIONS = {f"clip {number}": 10.0 for number in range(7)}


def stimuli_of(design):
    """Id -> the scene and the stimulus."""
    return {name: (scene, one) for scene, stimuli in design.scenes.items() for name, one in stimuli.items()}


def rows_of(design):
    """Item -> its kind, its systems and the clip that is heard."""
    stimuli, rows = stimuli_of(design), {}
    for item in design.items:
        shown = [stimuli[name] for name in item.stimuli]
        rows[item.id] = (item.kind, frozenset(stimulus.system for _, stimulus in shown), shown[0][0].clip)
    return rows


@settings(deadline=None, max_examples=30)
@given(
    num_systems=st.integers(2, 5),
    num_clips=st.integers(2, 9),
    per_participant=st.integers(1, 40),
    seed=st.integers(0, 2**63 - 1),
)
def test_lists_are_balanced(num_systems, num_clips, per_participant, seed):
    systems, durations = [f"s{n}" for n in range(num_systems)], {f"c{n}": 5.0 for n in range(num_clips)}
    design = make_design(systems, durations, PARTS, per_participant=per_participant, seed=seed)
    rows, checks = rows_of(design), {item.id for item in design.items if item.kind == "attention"}
    over_lists = collections.Counter(name for each in design.lists for name in each if name not in checks)
    for part, count in zip(PARTS, (num_systems, math.comb(num_systems, 2), num_systems), strict=True):
        items = [name for name, (kind, *_) in rows.items() if kind == part]
        assert len(items) == count * num_clips
        assert len({over_lists[name] for name in items}) == 1
        assert over_lists[items[0]] > 0
        for each in design.lists:
            found = collections.Counter(rows[name][1] for name in each if rows[name][0] == part)
            assert len(found) == count and len(set(found.values())) == 1
            assert sum(found.values()) == design.per_participant[part] <= max(per_participant, count)
    assert all(checks <= set(each) for each in design.lists)


def test_a_list_has_different_clips_for_different_systems():
    design = make_design(SYSTEMS, DURATIONS, ["rating"], per_participant=3)
    rows = rows_of(design)
    assert len(design.lists) == 7
    for each in design.lists:
        assert len({rows[name][2] for name in each if rows[name][0] == "rating"}) == 3


def test_equal_seeds_give_equal_designs_and_others_other_names():
    first, second, third = (make_design(SYSTEMS, DURATIONS, PARTS, seed=seed) for seed in (3, 3, 4))
    assert first == second
    assert not stimuli_of(first).keys() & stimuli_of(third).keys()


def test_items_compare_what_they_are_for_and_share_sound_and_length():
    design = make_design(SYSTEMS, DURATIONS, PARTS, attention=5)
    stimuli, first_is_matched = stimuli_of(design), []
    for item in design.items:
        scenes, shown = zip(*(stimuli[name] for name in item.stimuli), strict=True)
        assert len(set(scenes)) == 1
        clip = scenes[0].clip
        if item.kind == "preference":
            assert shown[0].system != shown[1].system and {stimulus.clip for stimulus in shown} == {clip}
        if item.kind == "mismatch":
            assert shown[0].system == shown[1].system
            assert sum(stimulus.clip == clip for stimulus in shown) == 1
            first_is_matched.append(shown[0].clip == clip)
    assert 0 < sum(first_is_matched) < len(first_is_matched)  # the order of a pair tells nothing
    assert {item.expected for item in design.items if item.kind == "attention"} == {1, 2, 3, 4, 5}
    of_mismatch = {name for item in design.items if item.kind == "mismatch" for name in item.stimuli}
    assert not of_mismatch & {name for item in design.items if item.kind != "mismatch" for name in item.stimuli}


@given(lengths=st.lists(st.floats(1, 60), min_size=2, max_size=12))
def test_mismatched_motion_is_of_another_clip_of_about_the_same_length(lengths):
    durations = {f"c{number}": length for number, length in enumerate(lengths)}
    others = mismatched_clips(list(durations), durations)
    assert sorted(others) == sorted(others.values()) == sorted(durations)
    assert all(clip != other for clip, other in others.items())
    order = sorted(durations, key=lambda clip: round(durations[clip] / 0.1))
    assert all(abs(order.index(clip) - order.index(other)) <= 2 for clip, other in others.items())


@pytest.mark.parametrize(
    ("systems", "clips", "options", "message"),
    [
        (["a"], 3, {"parts": ["preference"]}, "compares two systems"),
        (["a", "b"], 20_000, {"parts": ["rating"]}, "expected at most"),
    ],
)
def test_what_cannot_be_asked_is_refused(systems, clips, options, message):
    with pytest.raises(UserError, match=message):
        make_design(systems, {f"c{number}": 5.0 for number in range(clips)}, **options)


def test_a_key_is_read_as_it_was_written_and_is_private(tmp_path):
    path = tmp_path / "key.json"
    key = dataclasses.replace(make_key(), seed=2**63 - 1, title="\udcff")
    write_key(path, key)
    assert read_key(path) == read_key(tmp_path) == key
    assert path.stat().st_mode & 0o777 == 0o600
    content = json.loads(path.read_text())
    assert (content["format"], content["version"]) == ("ha2g-study-key", 1)
    for other in ({}, [], {"words": []}, content | {"version": 99}, content | {"items": [{}]}):
        (tmp_path / "items.json").write_text(json.dumps(other))
        with pytest.raises(UserError, match=r"items\.json is not the key\.json of a study"):
            read_key(tmp_path / "items.json")
    for name in ("stimuli", "systems", "clips"):
        lost = content | {name: {} if name == "stimuli" else content[name][1:]}
        (tmp_path / "items.json").write_text(json.dumps(lost))
        with pytest.raises(UserError, match=r"items\.json is not the key\.json of a study"):
            read_key(tmp_path / "items.json")
    rating, *_, attention = content["items"]
    assert rating.keys() == {"id", "kind", "stimulus"} and attention["expected"] == EXPECTED

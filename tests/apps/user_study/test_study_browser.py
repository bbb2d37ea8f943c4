"""A study in a real Chromium: people take part with the mouse or the keyboard, and no answer is lost.

It needs node, chromium, playwright-core and axe-core, which node finds in NODE_PATH or node_modules; it is skipped
without them. The pictures that it takes stay in the test's temporary folder.
"""

import datetime
import json
import pathlib
import re
import shutil
import socket

import pytest
from fixtures.browser import drive

from ha2g_jax.apps.user_study.answers import read_answers
from ha2g_jax.apps.user_study.design import read_key
from ha2g_jax.apps.user_study.pages import read_wording, write_site


@pytest.fixture(scope="module")
def seen(study, tmp_path_factory):
    """What the script saw; `folder` is where its pictures are."""
    folder, key = tmp_path_factory.mktemp("visit"), read_key(study / "key.json")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lists = json.loads((study / "site" / "items.json").read_text())["lists"]
    for name, post in (("saved", None), ("sent", f"http://127.0.0.1:{port}/answers")):
        shutil.copytree(study / "site", folder / name)
        write_site(folder / name, key, lists, read_wording(title=key.title, post=post))
    found = drive(pathlib.Path(__file__).with_name("drive_study.cjs"), folder, str(port), needs=["axe-core"])
    return {**found, "folder": folder, "key": key}


def check_answers(text, seen, participant):
    """Check a file of answers as the analysis does, and what it does not look at; return the content."""
    found = json.loads(text)
    path = seen["folder"] / f"{participant}.json"
    path.write_text(text)
    read = read_answers([path], seen["key"])
    assert len(read.participants) + len(read.excluded) == 1 and found["participant"] == participant
    assert all(each.reason.startswith("failed ") for each in read.excluded)  # an attention check
    assert datetime.datetime.fromisoformat(found["started"]) < datetime.datetime.fromisoformat(found["finished"])
    assert found.keys() == {
        *("format", "version", "study", "participant", "started", "finished", "consent", "order", "answers"),
        *("comments", "client"),
    }
    assert found["client"].keys() == {"user_agent", "language"}
    assert [answer["item"] for answer in found["answers"]] == found["order"]
    assert all(answer["plays"] >= 1 and answer["seconds"] >= 1 for answer in found["answers"])
    return found


def test_answers_with_the_mouse_are_sent_whole_after_a_reload(seen):
    assert seen["posted"][0]["type"] == "application/json"
    found = check_answers(seen["posted"][0]["text"], seen, "p1")
    assert found["comments"] == "Très bien </script> \U0001f44b"
    assert found["order"] == seen["sessions"]["p1"]["order"]
    assert seen["reloaded"][0] == seen["reloaded"][1]
    ratings = [answer["ratings"] for answer in found["answers"] if answer["kind"] == "rating"]
    assert ratings and all(each == {"naturalness": 1, "smoothness": 2, "synchrony": 3} for each in ratings)
    assert seen["sentStatus"] == "Your answers are sent."
    assert seen["postsAfterReload"] == 1
    assert seen["leftBehind"] == []


def test_the_keyboard_is_enough(seen):
    assert "tick the box" in seen["refused"]
    assert not seen["startsByItself"]
    assert {"consent", "instructions", "rating", "attention", "pair-preference", "pair-mismatch", "comments"} <= set(
        seen["sessions"]["p2"]["pages"]
    )
    found = check_answers(seen["keyboard"]["text"], seen, "p2")
    assert seen["keyboard"]["name"] == f"{seen['key'].study}-p2.json"
    assert found["comments"] == "By keyboard"
    for answer in found["answers"]:
        if answer["kind"] == "rating":
            assert list(answer["ratings"].values()) == [1, 5, 3]
            assert answer["plays"] == 2
        else:
            assert answer.get("answer", answer.get("choice")) in (4, "right")
    assert "in a file" in seen["keyboardStatus"]


def test_nothing_is_answered_before_the_clip_was_seen(seen):
    assert seen["early"] == "Play the clip to its end first."
    assert seen["unanswered"].startswith("Please answer:")


def test_two_clips_play_together_with_one_sound(seen):
    assert len(seen["apart"]) >= 6
    for apart, *are_muted in seen["apart"]:
        assert abs(apart) < 0.3  # on a machine under load; 0.01 on one that is idle
        assert are_muted == [False, True]


def test_a_clip_that_cannot_be_loaded_is_loaded_later(seen):
    assert "could not be played" in seen["unloaded"]
    assert seen["loaded"] == ""


def test_order_and_sides_are_those_of_the_participant(seen):
    sessions = seen["sessions"]
    for name in ("p1", "p2"):
        assert sessions[f"{name} again"] == {part: sessions[name][part] for part in ("order", "sides")}
    orders = [sessions[f"{name} again"]["order"] for name in ("p1", "p2", "p3", "ann")]
    assert len({tuple(order) for order in orders}) == 4
    assert len({json.dumps(sessions[f"{name} again"]["sides"], sort_keys=True) for name in ("p1", "p2", "ann")}) > 1
    checks = {item.id for item in seen["key"].items if item.kind == "attention"}
    assert all(order[0] not in checks for order in orders)
    pairs = {item.id: item.stimuli for item in seen["key"].items if len(item.stimuli) == 2}
    for name in ("p1", "p2"):  # half of the pairs of each kind are exchanged
        sides = sessions[name]["sides"]
        assert sum(tuple(sides[item]) != pair for item, pair in pairs.items()) == len(pairs) / 2
    assert 70 < seen["left"] < 130  # of 200, of one pair alone


def test_a_participant_without_a_name_keeps_one(seen):
    first, second = seen["anonymous"]
    assert first == second
    assert re.fullmatch(r"anonymous-[0-9a-f]{16}", first)


def test_answers_that_cannot_be_sent_are_saved_and_sent_later(seen):
    assert "could not be sent (status 503)" in seen["failedStatus"]
    assert "kept in this browser" in seen["failedStatus"]
    found = check_answers(seen["failedFile"]["text"], seen, "p3")
    assert seen["retriedStatus"] == "Your answers are sent."
    assert json.loads(seen["posted"][1]["text"]) == found
    assert len(seen["posted"]) == 2


def test_a_link_with_a_wrong_code_is_refused(seen):
    assert "participant code in the link is not valid" in seen["wrong"]


def test_nothing_is_loaded_from_other_hosts_and_nothing_is_refused(seen):
    assert seen["errors"] == []
    assert all(re.match(r"(http://127\.0\.0\.1:\d+/|blob:|data:)", request) for request in seen["requests"])


def test_pages_are_accessible_and_fit_on_a_phone(seen):
    pages = {"consent", "instructions", "rating", "attention", "pair-preference", "pair-mismatch", "comments", "end"}
    assert pages | {"failed"} == seen["faults"].keys()
    assert {page: faults for page, faults in seen["faults"].items() if faults} == {}
    assert {page: pixels for page, pixels in seen["overflow"].items() if pixels > 0} == {}

"""A key is read as it was written, and a key that contradicts itself is refused in one line."""

import json

import pytest

from ha2g_jax.apps.user_study.design import Item, Key, Stimulus, read_key, write_key
from ha2g_jax.errors import UserError

HASH = "0" * 64
KEY = Key(
    study="ab12",
    title="Gestures",
    seed=2**63 - 1,
    created="2026-01-01T00:00:00+00:00",
    systems=("a", "\udcff b"),
    clips=("c", "d"),
    stimuli={
        "s1": Stimulus("a", "c", True, "c", HASH),
        "s2": Stimulus("a", "d", False, "c", HASH),
        "s3": Stimulus("\udcff b", "c", True, "c", HASH),
        "s4": Stimulus("a", "d", False, None, HASH),
    },
    items=(
        Item("i001", "rating", ("s1",)),
        Item("i002", "preference", ("s1", "s3")),
        Item("i003", "mismatch", ("s2", "s1")),
        Item("i004", "attention", ("s4",), 4),
    ),
    per_participant={"rating": 1, "preference": 1, "mismatch": 1, "attention": 1},
)


@pytest.fixture
def path(tmp_path):
    write_key(tmp_path / "key.json", KEY)
    return tmp_path / "key.json"


def test_a_key_is_read_as_it_was_written_and_is_private(path):
    assert read_key(path) == KEY
    assert path.stat().st_mode & 0o777 == 0o600
    content = json.loads(path.read_text())
    assert (content["format"], content["version"]) == ("ha2g-study-key", 1)
    assert content["items"][2] == {"id": "i003", "kind": "mismatch", "pair": ["s2", "s1"]}
    assert content["items"][3] == {"id": "i004", "kind": "attention", "stimulus": "s4", "expected": 4}


@pytest.mark.parametrize("content", ["[]", '{"format": "other"}', "{"])
def test_a_file_that_is_no_key_is_refused(path, content):
    path.write_text(content)
    with pytest.raises(UserError, match=r"key\.json") as caught:
        read_key(path)
    assert "\n" not in str(caught.value)

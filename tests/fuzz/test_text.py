"""Transcripts, settings, stored work, values of the TED data and requests of any content are read or refused."""

import json
import pathlib

import numpy as np
import pytest
from fixtures.transcripts import LONG_GRID, TEXTS, TREES, check_words
from fuzz.conftest import one_line, within_limits
from fuzz.mutation import FUZZ, damaged_bytes, damaged_text, damaged_tree
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.features.words import read_words
from ha2g_jax.features.words.parsers import without_brackets
from ha2g_jax.importers.ted import arrow
from ha2g_jax.importers.video import settings
from ha2g_jax.motion import control
from ha2g_jax.motion.control import Controls, apply
from ha2g_jax.skeleton import load_skeleton


def read(path: pathlib.Path) -> None:
    check_words(read_words(path))


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(TEXTS)))
def test_transcripts(data, name, answered):
    content = st.one_of(damaged_text(TEXTS[name]), damaged_bytes(TEXTS[name].encode()), st.binary(max_size=300))
    answered(read, data.draw(content), name)


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(TREES)))
def test_transcripts_in_json(data, name, answered):
    answered(read, json.dumps(data.draw(damaged_tree(TREES[name]))).encode(), name)


CUE = "00:00:01,000 --> 00:00:02,000\n"
LARGE = {
    "lines.vtt": ("WEBVTT\n\n" + 2 * (CUE.replace(",", ".") + "a\n" * 300_000 + "\n"), "a subtitle of 300001 lines"),
    "lines.srt": ("1\n" + CUE + "a\n" * 4_000_000, "more than 1000000 lines"),
    "gaps.srt": ("1\n" + CUE + "a\n\n" * 1_000, "a subtitle of"),
    "letters.srt": ("1\n" + CUE + "a" * (4 << 20), "expected at most 3145728"),
    "blanks.TextGrid": (LONG_GRID.replace("item []", "\n" * 900_000 + "item []"), "TextGrid"),
    "words.tsv": ("start\tend\tword\n" + "0\t1\ta\n" * 110_000, "more than 100000 words"),
    "deep.json": ('{"words":' + "[" * 90 + "]" * 90 + "}", "nested too deep"),
}


@pytest.mark.parametrize("name", LARGE)
def test_a_transcript_that_is_too_large(name, tmp_path):
    content, found = LARGE[name]
    (tmp_path / name).write_text(content)
    with within_limits(), pytest.raises(UserError, match=found):
        read_words(tmp_path / name)


def test_marks_without_end_are_read(answered):
    """Marks on one letter are sorted in the square of their number, a minute for these."""
    answered(read_words, ("1\n" + CUE + "a" + "\u0301\u0327" * 100_000).encode(), "a.srt")


def test_brackets_are_found_as_the_first_that_closes():
    assert without_brackets("a (b [c) d] e", "[(", "-") == "a - d] e"
    assert without_brackets("(" + "x" * 200 + ")y(" + "x" * 201 + ")", "(", "") == "y(" + "x" * 201 + ")"
    assert without_brackets("<a\n> <b>", "<", "") == "<a\n> "


SETTINGS = {**settings.VideoSettings().as_json(), "recognise": "tiny.en"}


@FUZZ
@given(data=st.data())
def test_settings(data, answered):
    content = json.dumps(data.draw(damaged_tree(SETTINGS))).encode()
    answered(settings.read_settings, data.draw(st.sampled_from([content, b'{"filters":' + b"[" * 10**5])), "a.json")


TED_VALUE = (pathlib.Path(__file__).parents[1] / "importers/ted/pyarrow_0_14_values.bin").read_bytes()


@FUZZ
@given(content=damaged_bytes(TED_VALUE))
def test_values_of_ted(content):
    with one_line():
        arrow.deserialize(content, "record 1")


@FUZZ
@given(
    parts=st.lists(
        st.sampled_from(
            ["0", "1", "-1", "nan", "inf", "1e300", "", "rest", "x.npz@1", "/dev/zero", "x" * 300, "\udcff"]
        ),
        max_size=4,
    )
)
def test_requests(parts):
    skeleton, text = load_skeleton("ted_expressive"), ":".join(parts)
    directions = np.tile(skeleton.mean_directions, (20, 1, 1)).astype(np.float32)
    for make in (
        lambda: Controls(pins=(control.read_pin(text),)),
        lambda: Controls(mutes=(control.read_mute(text),)),
    ):
        with one_line():
            apply(skeleton, directions, 15, make())

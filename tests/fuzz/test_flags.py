"""Flags of any form: those of a run give a config or one line, and numbers beyond reason are refused in one line."""

import os

import pytest
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_text
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax import launch
from ha2g_jax.config import settings
from ha2g_jax.limits import MAX_SEED, MAX_TALK_MINUTES, MAX_TALK_SPEAKERS
from ha2g_jax.synthesis.style import read_mixture

_FLAGS = (
    "--config.train.steps=10",
    "--config.train.betas=(0.9, 0.99)",
    "--config.data.noise_snr_db=(5.0, 20.0)",
    "--config.data.fps=15",
    "--config.loss.ha2g.weights.gan=1.0",
    "--config.model.audio.levels=('low',)",
    "--config.train.dtype=bfloat16",
    "--config.seed=3",
)


def damaged(text):
    """Damage a text, which the system gives a program as its arguments."""
    return damaged_text(text).map(os.fsdecode)


@FUZZ
@given(flag=st.sampled_from(_FLAGS).flatmap(damaged))
def test_any_flag_gives_a_config_or_one_line(flag):
    with one_line(5_000):
        settings.check(launch.load_config("talk:debug", [flag]))


@FUZZ
@given(spec=st.sampled_from(["talk:debug", "trimodal:talk:small", "./mine.py:small"]).flatmap(damaged))
def test_any_name_of_a_config_gives_one_or_one_line(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where no file is, so that nothing is executed
    with one_line(5_000):
        launch.load_config(spec)


@FUZZ
@given(text=damaged("ada:0.3,ben:0.7"))
def test_any_mixture_is_read_or_refused(text):
    with one_line():
        read_mixture(text)


@pytest.mark.parametrize("seed", ["-1", str(MAX_SEED + 1), "9" * 5000, "1e3", "nan", ""])
@pytest.mark.parametrize(
    "command",
    [
        ["generate", "a.wav", "--seed"],
        ["generate", "a.wav", "--style-seed"],
        ["evaluate", "--checkpoint", "demo", "--seed"],
        ["data", "make-talk", "a", "--seed"],
        ["data", "split", "a", "b", "--seed"],
    ],
)
def test_a_seed_out_of_range_is_refused(command, seed, refused):
    assert refused(*command[:-1], f"{command[-1]}={seed}").startswith("ha2g: the seed is ")


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("--minutes", ["nan", "inf", "-inf", "-5", "1e300", str(MAX_TALK_MINUTES + 1)]),
        ("--speakers", ["-3", "0", str(MAX_TALK_SPEAKERS + 1), "9" * 4000]),
        ("--workers", ["0"]),
        ("--fps", ["0", "1001"]),
    ],
)
def test_a_talk_corpus_of_no_possible_size_is_refused(option, values, refused, tmp_path):
    for value in values:
        refused("data", "make-talk", str(tmp_path / "talk"), f"{option}={value}")
    assert not list(tmp_path.iterdir())

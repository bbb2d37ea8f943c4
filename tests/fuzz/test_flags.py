"""Flags of any form: those of a run give a config or one line, and numbers beyond reason are refused in one line."""

import os

import pytest
from fuzz.mutation import FUZZ, damaged_text
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax import launch
from ha2g_jax.config import settings
from ha2g_jax.errors import UserError
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


def answered(read, *arguments):
    """Call a reader, which may raise a one-line `UserError` only."""
    try:
        return read(*arguments)
    except UserError as error:
        assert "\n" not in str(error) and len(str(error)) < 5_000


@FUZZ
@given(flag=st.sampled_from(_FLAGS).flatmap(damaged))
def test_any_flag_gives_a_config_or_one_line(flag):
    config = answered(launch.load_config, "talk:debug", [flag])
    if config is not None:
        answered(settings.check, config)


@FUZZ
@given(spec=st.sampled_from(["talk:debug", "trimodal:talk:small", "./mine.py:small"]).flatmap(damaged))
def test_any_name_of_a_config_gives_one_or_one_line(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where no file is, so that nothing is executed
    answered(launch.load_config, spec)


@FUZZ
@given(text=damaged("ada:0.3,ben:0.7"))
def test_any_mixture_is_read_or_refused(text):
    answered(read_mixture, text)


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
    ("option", "value"),
    [
        ("--minutes", "nan"),
        ("--minutes", "inf"),
        ("--minutes", "-inf"),
        ("--minutes", "-5"),
        ("--minutes", "1e300"),
        ("--minutes", str(MAX_TALK_MINUTES + 1)),
        ("--speakers", "-3"),
        ("--speakers", "0"),
        ("--speakers", str(MAX_TALK_SPEAKERS + 1)),
        ("--speakers", "9" * 4000),
        ("--workers", "0"),
        ("--fps", "0"),
        ("--fps", "1001"),
    ],
)
def test_a_talk_corpus_of_no_possible_size_is_refused(option, value, refused, tmp_path):
    refused("data", "make-talk", str(tmp_path / "talk"), f"{option}={value}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("flag", "line"),
    [
        ("seed=-1", "config.seed is -1, expected a whole number from 0 to"),
        (f"seed={MAX_SEED + 1}", "config.seed is"),
        ("train.betas=((((((", "config.train.betas is"),
        ("train.betas=(0.9,)", "config.train.betas is"),
        ("train.betas=(0.9,1.5)", "config.train.betas is"),
        ("data.noise_snr_db=()", "config.data.noise_snr_db is"),
    ],
)
def test_a_setting_that_breaks_a_run_is_named(flag, line):
    with pytest.raises(UserError, match=line):
        settings.check(launch.load_config("talk:debug", [f"--config.{flag}"]))

"""Samples of a training run show both motions, follow the weights, and never end the run."""

import dataclasses
from typing import Any

import av
import jax
import numpy as np
import pytest

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.evaluation import samples
from ha2g_jax.synthesis import scan


@pytest.fixture(scope="module")
def clip(tiny_talk):
    """Two seconds of a clip."""
    clip = Corpus.open(tiny_talk).clips("val")[0]
    return dataclasses.replace(clip, audio=clip.audio[:32000], positions=clip.positions[:30])


@pytest.fixture
def write(debug_model, clip, tmp_path, monkeypatch):
    """`write_sample` into the temporary folder, small, with some of its arguments replaced."""
    monkeypatch.setattr(samples, "_SIZE", 64)

    def write(step=1, **changes):
        arguments = {name: getattr(debug_model, name) for name in ("spec", "variables", "assets", "config")}
        arguments |= {"folder": tmp_path, "clip": clip} | changes
        samples.write_sample(step=step, **arguments)

    return write


def pictures(path) -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_the_true_and_the_generated_motion_are_side_by_side(write, tmp_path, capsys):
    write(step=1000)
    assert [path.name for path in tmp_path.iterdir()] == ["step-00001000.mp4"]
    video = pictures(tmp_path / "step-00001000.mp4")
    assert video.shape == (60, 64, 128, 3)
    left, right = video[:, :, :64].astype(int), video[:, :, 64:].astype(int)
    assert np.abs(left - right).max() > 50
    assert capsys.readouterr().err == ""


def test_ten_seconds_at_most(write, clip, tmp_path):
    long = dataclasses.replace(clip, audio=np.tile(clip.audio, 6), positions=np.tile(clip.positions, (6, 1, 1)))
    write(clip=long)
    assert len(pictures(tmp_path / "step-00000001.mp4")) == 300


def test_other_weights_move_the_generated_figure_alone_and_compile_nothing(write, debug_model, monkeypatch):
    drawn = []
    monkeypatch.setattr(samples, "write_video", lambda path, motions, *_, **__: drawn.append(motions))
    write(step=1)
    programs: list[Any] = [scan._sample, scan._encode_speech]
    compiled = [program._cache_size() for program in programs]
    write(step=2, variables=jax.tree.map(lambda x: 3 * x, debug_model.variables))
    assert [program._cache_size() for program in programs] == compiled
    first, second = drawn
    assert (list(first), list(second)) == (["true", "step 1"], ["true", "step 2"])
    np.testing.assert_array_equal(first["true"].positions, second["true"].positions)
    assert np.abs(first["step 1"].positions - second["step 2"].positions).max() > 1e-3


def test_weights_that_are_not_finite_are_a_line_and_no_file(write, debug_model, tmp_path, capsys):
    write(step=7, variables=jax.tree.map(lambda x: x * np.nan, debug_model.variables))
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "step 7" in said and "not finite" in said
    assert list(tmp_path.iterdir()) == []

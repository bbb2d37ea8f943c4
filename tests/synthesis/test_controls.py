"""What a user asks of generated motion: a mixed style, poses to start from, smoothing and controls."""

import re
from typing import Any, cast

import numpy as np
import pytest

from ha2g_jax import synthesis
from ha2g_jax.errors import UserError
from ha2g_jax.motion.control import Controls, Pin, Span, rest_pose
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import resample, sample
from ha2g_jax.motion.smoothing import smooth
from ha2g_jax.synthesis import Style

SPEECH = np.random.default_rng(0).normal(0, 0.1, 80000).astype(np.float32)  # 5 s


@pytest.fixture
def waving(debug_model) -> Motion:
    """4 s that end where no start of the model's is."""
    skeleton = debug_model.assets.skeleton
    swing = 0.5 * np.sin(np.arange(60) / 9)[:, None, None] * np.random.default_rng(1).normal(size=(1, 42, 3))
    return Motion.from_directions(skeleton, skeleton.mean_directions + swing, 15)


def test_a_mixture_lies_between_its_speakers(debug_model):
    ada, ben = (debug_model.assets.speakers[name] for name in ("ada", "ben"))
    parts = (debug_model.spec, debug_model.variables, debug_model.assets)
    f_id, described = synthesis.choose_style(*parts, Style(mixture={"ada": 3, "ben": 1}, variation=0))
    np.testing.assert_allclose(f_id, 0.75 * ada + 0.25 * ben, atol=1e-6)
    assert described == {"kind": "mixture", "speakers": {"ada": 0.75, "ben": 0.25}, "variation": 0}
    alone = Style(mixture={"ada": 0.3, "ben": 0}, variation=0)
    np.testing.assert_array_equal(synthesis.choose_style(*parts, alone)[0], ada)


def test_a_mixture_is_read_from_text():
    assert synthesis.read_mixture("ada:0.3, ben:0.7") == {"ada": 0.3, "ben": 0.7}
    assert synthesis.read_mixture("ada,ben") == {"ada": 1, "ben": 1}
    assert synthesis.read_mixture("talk:ada:2,id:x") == {"talk:ada": 2, "id:x": 1}


@pytest.mark.parametrize("text", ["", "ada:0.3,ada:0.7"])
def test_a_mixture_that_is_none_is_one_line(text):
    with pytest.raises(UserError, match=re.escape("A:0.3,B:0.7")):
        synthesis.read_mixture(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"style": Style(mixture={"ada": 1, "eve": 1})}, "no speaker 'eve' in the model; expected one of: ada, ben"),
        ({"style": Style(mixture={"ada": -0.5, "ben": 1})}, "expected numbers of at least 0"),
        ({"style": Style(images=["missing.png"])}, "missing.png cannot be read"),
        ({"style": Style(mixture=cast(Any, ["ada"]))}, "give the weights of speakers"),
        ({"style": Style(mixture=cast(Any, {"ada": "1"}))}, "expected numbers of at least 0"),
        ({"style": Style(speaker=cast(Any, 3))}, "no speaker '3' in the model"),
        ({"style": Style(speaker="ada", variation=cast(Any, "a"))}, "expected 0 to 2"),
        ({"style": Style(values=cast(Any, "abc"))}, "expected 18 finite numbers"),
        ({"fps": float("nan")}, "1 to 240"),
        ({"fps": "30"}, "1 to 240"),
        ({"smoothing": "a"}, "expected 0 to 2"),
        ({"controls": {"energy": 1}}, "give Controls"),
        ({"cues": [3]}, "give a Cue"),
        ({"cues": ["nod"]}, "neither a time nor a word"),
        ({"words": "hello"}, "give words such as Word("),
        ({"controls": Controls(pins=(Pin(6, 7),))}, "after the end of the motion at 5 s"),
        ({"seed_pose": np.full((42, 3), np.nan)}, "not finite"),
    ],
)
def test_a_mistake_is_one_line(debug_model, arguments, message):
    with pytest.raises(UserError, match=re.escape(message)) as caught:
        debug_model.generate(SPEECH, **arguments)
    assert "\n" not in str(caught.value)


def test_a_motion_goes_on_from_the_end_of_another(debug_model, waving, tmp_path):
    waving.save(tmp_path / "wave.npz")
    motion = debug_model.generate(SPEECH, seed_pose=tmp_path / "wave.npz")
    np.testing.assert_allclose(motion.directions[0], waving.directions[-4], atol=1e-5)
    assert motion.meta["seed_pose"] == "wave.npz"
    steps = np.linalg.norm(np.diff(motion.directions[:16], axis=0), axis=-1).mean(axis=1)
    way = np.linalg.norm(motion.directions[15] - waving.directions[-4], axis=-1).mean()
    assert steps.max() < way / 2  # it gets to its own way step by step
    # And what it was given is heard by the model, beyond the frames that are faded.
    other = debug_model.generate(SPEECH)
    assert np.abs(motion.directions[14:34] - other.directions[14:34]).max() > 1e-4
    np.testing.assert_array_equal(
        motion.directions, debug_model.generate(SPEECH, seed_pose=Motion.load(tmp_path / "wave.npz")).directions
    )


@pytest.mark.parametrize("fps", [10, 15, 30, 60])
def test_a_seed_pose_of_any_rate_ends_at_the_end(debug_model, waving, fps):
    directions = resample(waving.directions, 15, fps, 1 + (waving.num_frames - 1) * fps // 15)
    finer = Motion.from_directions(waving.skeleton, directions, fps)
    motion = debug_model.generate(SPEECH, seed_pose=finer)
    moment = (finer.num_frames - 1) / fps - 3 / 15  # four frames of the model end where it ends
    (expected,) = sample(waving.directions, np.array([moment * 15]))
    np.testing.assert_allclose(motion.directions[0], expected, atol=1e-4 if fps % 15 == 0 else 0.02)


def test_a_pose_or_a_motion_that_is_too_short_is_held(debug_model, waving):
    pose = waving.directions[30]
    motions = [debug_model.generate(SPEECH, seed_pose=source).directions for source in (pose, pose[None], 2 * pose)]
    np.testing.assert_allclose(motions[0][0], pose, atol=1e-6)
    for other in motions[1:]:
        np.testing.assert_allclose(other, motions[0], atol=1e-5)


def test_smoothing_is_that_of_the_motion_at_its_rate(debug_model):
    rough, smoothed = (debug_model.generate(SPEECH, fps=30, smoothing=seconds) for seconds in (0, 0.3))
    np.testing.assert_allclose(smoothed.directions, smooth(rough.directions, 30, 0.3), atol=1e-6)
    assert np.abs(smoothed.directions - rough.directions).max() > 1e-4
    assert smoothed.meta["smoothing"] == 0.3
    assert "smoothing" not in rough.meta


@pytest.mark.parametrize("fps", [15, 60])
def test_controls_are_those_of_the_finished_motion(debug_model, fps):
    asked = Controls(extent=1.5, pins=(Pin(1, 2),), mutes=(Span(4, 4.5),))
    motion = debug_model.generate(SPEECH, fps=fps, smoothing=0.2, controls=asked)
    rest = rest_pose(debug_model.assets.skeleton)
    held = motion.directions[fps : 2 * fps + 1]
    np.testing.assert_allclose(held, np.broadcast_to(rest, held.shape), atol=1e-6)
    assert motion.num_frames == 5 * fps
    assert motion.meta["controls"]["extent"] == 1.5
    assert np.abs(motion.directions - rest).max(axis=(1, 2))[3 * fps] > 0.05

"""What a user asks of cues: on a word of a file, and in a stream while it goes on."""

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.motion.control import Controls, Span
from ha2g_jax.motion.cues import MAX_SPEED, MOST, Cue, keyframes
from ha2g_jax.motion.cues.catalogue import limbs

SPEECH = np.random.default_rng(0).normal(0, 0.1, 64000).astype(np.float32)  # 4 s
WORDS = (Word("there", 0.5, 0.9), Word("are", 1.1, 1.3), Word("three", 1.62, 2.0), Word("three", 3.0, 3.4))


def arm(model, side: str = "right") -> list[int]:
    return [bone for part in limbs(model.assets.skeleton)[f"{side}_arm"] for bone in part.bones]


@pytest.mark.parametrize(("fps", "time", "frame"), [(None, None, 24), (60.0, None, 97), (None, 2.0, 45)])
def test_a_stroke_peaks_on_its_word(debug_model, fps, time, frame):
    plain = debug_model.generate(SPEECH, fps=fps)
    motion = debug_model.generate(SPEECH, fps=fps, cues=[Cue("count:3", time, "three")], words=WORDS)
    pose = keyframes(debug_model.assets.skeleton, "count:3").poses["right_arm"][0]
    np.testing.assert_allclose(motion.directions[frame, arm(debug_model)], pose, atol=1e-4)
    others = np.delete(np.arange(42), arm(debug_model))
    np.testing.assert_array_equal(motion.directions[:, others], plain.directions[:, others])
    assert motion.meta["cues"] == [{"cue": "count:3", "time": WORDS[2 + bool(time)].start, "word": "three"}]


@pytest.mark.parametrize("controls", [Controls(handedness="left"), Controls(mutes=(Span(0, 4),)), Controls(extent=0)])
def test_an_arm_at_rest_makes_the_cue_all_the_same(debug_model, controls):
    motion = debug_model.generate(SPEECH, controls=controls, cues=[Cue("stop", 2.0)])
    pose = keyframes(debug_model.assets.skeleton, "stop").poses["right_arm"][0]
    np.testing.assert_allclose(motion.directions[30, arm(debug_model)], pose, atol=1e-4)


@pytest.mark.parametrize(
    ("cue", "message"),
    [
        (Cue("jump", 1.0), "no cue 'jump'; expected nod, shake"),
        (Cue("nod"), "neither a time nor a word"),
        (Cue("nod", 4.1), "after the end of the motion at 4 s"),
        (Cue("nod", word="four"), "'four' of the cue nod is not spoken"),
        (Cue("nod", word=4), "give a Cue"),
        (Cue("clip:nowhere.bvh", 1.0), "nowhere.bvh"),
    ],
)
def test_a_mistake_is_one_line(debug_model, cue, message):
    with pytest.raises(UserError, match=message) as caught:
        debug_model.generate(SPEECH, cues=[cue], words=WORDS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cut", [1000, 64000])
def test_a_stream_makes_a_cue_at_its_time_in_speech_and_in_silence(debug_model, cut):
    """And what the generator is fed back stays without it."""
    skeleton, silence = debug_model.assets.skeleton, np.zeros(64000, np.float32)
    plain, cued = debug_model.stream(), debug_model.stream()
    cued.cue("count:3", 2.0)
    cued.cue(Cue("count:3:left", 7.0))
    frames = []
    for stream in (plain, cued):
        sound = np.concatenate([SPEECH, silence])
        frames.append(np.concatenate([stream.feed(sound[start : start + cut]) for start in range(0, len(sound), cut)]))
    for moment, side in ((30, "right"), (105, "left")):
        [pose] = [poses[0] for poses in keyframes(skeleton, "count:3" + ":left" * (side == "left")).poses.values()]
        np.testing.assert_allclose(frames[1][moment, arm(debug_model, side)], pose, atol=1e-4)
    differs = (frames[0] != frames[1]).any(axis=2)
    assert not differs[:20].any() and not differs[50:90].any() and not differs[20:50, arm(debug_model, "left")].any()


def test_a_stream_makes_a_cue_now(debug_model):
    stream = debug_model.stream()
    first = len(stream.feed(SPEECH))
    stream.cue("stop")
    frames = np.concatenate([stream.feed(SPEECH), stream.flush()])
    pose = keyframes(debug_model.assets.skeleton, "stop").poses["right_arm"][0]
    way = np.linalg.norm(frames[:, arm(debug_model)] - pose, axis=-1).max(axis=1)
    assert 6 <= way.argmin() <= 12 and way.min() < 1e-4 and first > 40
    with pytest.raises(UserError, match="a stream has none"):
        debug_model.stream().cue(Cue("nod", word="three"))


def test_a_limited_number_of_cues_waits_until_they_begin_or_are_cleared(debug_model):
    stream, silence = debug_model.stream(), np.zeros(16000, np.float32)
    for _ in range(2):
        for _ in range(MOST):
            stream.cue("nod", 60.0)
        with pytest.raises(UserError, match="64 cues wait to be made; give shrug when one of them has begun, or clear"):
            stream.cue("shrug")
        stream.clear()
    frames = silence[:0]
    for _ in range(3):  # those that are made at once begin, and make space for others
        for _ in range(MOST):
            stream.cue("nod")
        frames = stream.feed(silence)
    turns = np.linalg.norm(np.diff(frames, axis=0), axis=-1).max() * stream.fps
    assert 0.5 < turns < MAX_SPEED

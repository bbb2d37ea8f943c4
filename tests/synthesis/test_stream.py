"""A stream returns each frame as soon as it is known, with what it was told to add, and can drop speech again."""

import dataclasses
import itertools
import sys
from typing import Any, cast

import jax
import numpy as np
import pytest
from fixtures.streams import speech, streamed
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import ha2g_jax
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.metrics.beats.strokes import stroke_beats, wrist_positions
from ha2g_jax.motion.control import Controls, rest_pose
from ha2g_jax.motion.control.parts import arm_parts, bones_of
from ha2g_jax.synthesis import Style

FPS, HALF_SECOND = 15, 8  # frames


@pytest.mark.parametrize(("look_ahead", "hop"), [(0, 1), (1, 1), (3, 1), (3, 5), (5, 26)])
def test_a_frame_comes_as_soon_as_it_is_known(debug_model, look_ahead, hop):
    """Not later than the latency that the stream states, and not before its samples."""
    stream = debug_model.stream(look_ahead=look_ahead, hop=hop)
    assert stream.latency == max(look_ahead + hop, 1.5) / FPS
    count, piece = 0, 64
    for start in range(0, 5 * SAMPLE_RATE // (1 + (hop < 26)), piece):
        count += len(stream.feed(np.zeros(piece, np.float32)))
        heard = (start + piece) / SAMPLE_RATE * FPS
        due = max(int(heard - look_ahead + 1), 0) // hop * hop
        assert due - 1 <= count <= due  # without any look-ahead, the last one is half a frame later
        assert count == due or (look_ahead == 0 and heard - count <= 0.5)


@pytest.fixture(scope="module")
def at_once(debug_model) -> tuple[np.ndarray, np.ndarray]:
    samples = speech(0.7)
    return samples, streamed(debug_model, samples, hop=2)


@settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(cuts=list(range(11200)))  # one sample at a time
@given(cuts=st.lists(st.integers(0, 11200), max_size=12))
def test_bytes_do_not_depend_on_the_cuts(debug_model, at_once, cuts):
    samples, expected = at_once
    stream = debug_model.stream(hop=2)
    parts = [stream.feed(part) for part in np.split(samples, sorted(cuts))]
    assert np.concatenate([*parts, stream.flush()]).tobytes() == expected.tobytes()


def test_more_than_a_minute_at_once_gives_the_same_bytes(debug_model):
    samples = np.tile(speech(35), 2)
    whole = {"look_ahead": 0, "hop": 26}
    expected = streamed(debug_model, samples, 16001, **whole)
    assert expected.shape == (1050, 42, 3)
    assert streamed(debug_model, samples, **whole).tobytes() == expected.tobytes()


@pytest.mark.parametrize("hop", [13, 26])
def test_the_memory_of_a_stream_does_not_grow(debug_model, held_bytes, hop):
    stream, sizes = debug_model.stream(hop=hop), []
    for _ in range(2):
        stream.feed(speech(64))
        sizes.append(held_bytes(stream))
    assert sizes[0] > 50_000
    assert max(sizes) - min(sizes) < 5_000 + 4 * 42 * 3 * hop  # samples of a column, and frames that are held


@pytest.mark.parametrize(
    ("seconds", "options"),
    [
        *itertools.product([0, 1 / 16000, 0.03, 0.1, 1 / 3, 2.2334, 2.31], [{}]),
        *itertools.product([2.31], [{"look_ahead": 0}, {"look_ahead": 34, "hop": 3}, {"look_ahead": 0, "hop": 26}]),
    ],
)
def test_frames_are_duration_times_fps_rounded(debug_model, seconds, options):
    samples = speech(seconds)
    frames = streamed(debug_model, samples, 700, **options)
    assert frames.shape == (max(1, round(len(samples) / SAMPLE_RATE * FPS)), 42, 3) and frames.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(frames, axis=-1), 1, atol=1e-5)


def test_nothing_is_compiled_or_imported_after_the_start(debug_model, compilations, monkeypatch):
    monkeypatch.delitem(sys.modules, "scipy.spatial.transform", raising=False)
    stream = debug_model.stream(look_ahead=1)
    modules = set(sys.modules)
    with compilations() as compiled:
        stream.feed(speech(1))
        stream.controls, stream.style, stream.muted = Controls(energy=1.2), Style(seed=4), True
        stream.cue("count:3")
        stream.clear()
        stream.cue("stop")
        stream.feed(speech(1), speech(1))
        stream.flush()
    assert not compiled and set(sys.modules) == modules


def test_samples_that_are_no_numbers_are_silence(debug_model):
    samples = speech(1)
    samples[4000:4100] = 0
    damaged = samples.copy()
    damaged[4000:4100:3], damaged[4001:4100:3] = np.nan, np.inf
    np.testing.assert_array_equal(streamed(debug_model, damaged), streamed(debug_model, samples))


def test_a_gap_is_bridged_with_silence(debug_model):
    stream, other = debug_model.stream(), debug_model.stream()
    bridged = np.concatenate([stream.feed(speech(1)), stream.skip(1.5), stream.feed(speech(1)), stream.flush()])
    samples = np.concatenate([speech(1), np.zeros(24000, np.float32), speech(1)])
    np.testing.assert_array_equal(bridged, np.concatenate([other.feed(samples), other.flush()]))


@pytest.fixture(scope="module")
def demo():
    return ha2g_jax.load("demo")


@pytest.mark.parametrize("part", range(4))
def test_a_stream_rests_within_a_second_of_silence(demo, part):
    """Before speech, after it and in noise at -60 dBFS; each speaker has another seed. It is never still."""
    options = [{"look_ahead": 0}, {"look_ahead": 3}, {"look_ahead": 8, "hop": 2}, {"look_ahead": 0, "hop": 26}][part]
    noise = np.random.default_rng(part).normal(0, 1e-3, 2 * SAMPLE_RATE).astype(np.float32)
    sound = np.concatenate([np.zeros(SAMPLE_RATE, np.float32), speech(0.6), noise, speech(0.6)])
    for seed, speaker in list(enumerate(demo.assets.speakers))[part::24]:
        frames = streamed(demo, sound, style=Style(speaker=speaker), seed=seed, **options)
        speeds = movement_speeds(demo.assets.skeleton, frames)
        resting = np.concatenate([speeds[: FPS - 9], speeds[39:45]])
        assert resting.min() > 0 and resting.max() < 0.1 and resting.mean() < 0.05
        assert speeds[FPS:24].max() > 0.05 and speeds[54:].max() > 0.05
        assert np.abs(np.diff(speeds[44:52])).max() < 1.5  # and goes on without a jump


@pytest.mark.parametrize("level", [-20, -50])
def test_a_stream_makes_no_stroke_to_bursts_of_noise(demo, level):
    """Those at -50 dBFS are at the level from which on there is sound, so that it rests between some of them."""
    rng, decay = np.random.default_rng(0), np.exp(-np.arange(SAMPLE_RATE) / 800)
    bursts = np.zeros(10 * SAMPLE_RATE)
    for start in rng.integers(9 * SAMPLE_RATE, size=12):
        bursts[start : start + SAMPLE_RATE] += rng.uniform(0.2, 1) * decay * rng.normal(size=SAMPLE_RATE)
    sound = (bursts / np.sqrt(np.mean(bursts**2)) * 10 ** (level / 20)).astype(np.float32)
    wrists = wrist_positions(demo.assets.skeleton, streamed(demo, np.clip(sound, -1, 1)))
    assert not len(stroke_beats(wrists[FPS:], FPS))


def movement_speeds(skeleton, frames):
    """The greatest speed (T - 1,) of a wrist, in m/s."""
    wrists = wrist_positions(skeleton, frames)
    return FPS * np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max(axis=-1)


def test_a_stream_rests_where_a_file_does(demo):
    style, silence = Style(speaker="speaker-03", variation=0), np.zeros(30 * SAMPLE_RATE, np.float32)
    rest = wrist_positions(demo.assets.skeleton, streamed(demo, silence, style=style))
    file = wrist_positions(demo.assets.skeleton, demo.generate(silence[: 8 * SAMPLE_RATE], style=style).directions[60:])
    assert np.linalg.norm(rest.mean(axis=0) - file.mean(axis=0), axis=-1).max() < 0.03
    assert np.linalg.norm(rest - file.mean(axis=0), axis=-1).max() < 0.12


def test_the_other_is_heard_as_far_as_the_agent_and_changes_no_speech(debug_model):
    """However both sounds are cut, and whether silence is given or left out."""
    own = np.concatenate([np.zeros(4 * SAMPLE_RATE, np.float32), speech(2), np.zeros(SAMPLE_RATE, np.float32)])
    other = np.concatenate([np.zeros(700, np.float32), speech(2.5, seed=3), np.zeros(len(own), np.float32)])[: len(own)]
    alone = streamed(debug_model, own)

    def heard(cuts, other=other):
        stream, frames = debug_model.stream(), []
        for start, end in itertools.pairwise([0, *cuts, len(own)]):
            part = other[start:end]
            frames.append(stream.feed(own[start:end], part if part.any() else None))
        return np.concatenate([*frames, stream.flush()])

    frames = heard(range(1000, len(own), 1000))
    for cuts in ((), (50000, 50001, 90000)):
        np.testing.assert_array_equal(heard(cuts), frames)
    is_speech = slice(4 * FPS + 1, 6 * FPS)
    np.testing.assert_array_equal(frames[is_speech], alone[is_speech])
    end = 2 * SAMPLE_RATE
    later = np.concatenate([other[:end], speech(5, seed=7)])[: len(own)]
    known = end * FPS // SAMPLE_RATE - 8 - 2
    np.testing.assert_array_equal(heard((), later)[:known], frames[:known])
    assert np.abs(frames - alone)[:known].max() > 0.05  # who listens leans ahead


@pytest.fixture(scope="module")
def plain(debug_model) -> np.ndarray:
    return streamed(debug_model, speech(3))


def _changed_at(debug_model, seconds: float, change) -> tuple[np.ndarray, int]:
    """The frames of 3 s of speech with a change of the stream on the way, and how many came before it."""
    stream = debug_model.stream()
    first = stream.feed(speech(3)[: round(seconds * SAMPLE_RATE)])
    change(stream)
    rest = stream.feed(speech(3)[round(seconds * SAMPLE_RATE) :])
    return np.concatenate([first, rest, stream.flush()]), len(first)


CHANGES = {
    "energy": Controls(energy=0.2),
    "extent": Controls(extent=1.5),
    "one hand": Controls(handedness="left"),
    "mirror": Controls(mirror=True),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_control_takes_effect_within_half_a_second(debug_model, plain, name):
    frames, count = _changed_at(debug_model, 1, lambda stream: setattr(stream, "controls", CHANGES[name]))
    always = streamed(debug_model, speech(3), controls=CHANGES[name])
    np.testing.assert_array_equal(frames[:count], plain[:count])
    np.testing.assert_allclose(frames[count + HALF_SECOND :], always[count + HALF_SECOND :], atol=1e-5)
    assert np.abs(frames[count + HALF_SECOND :] - plain[count + HALF_SECOND :]).max() > 0.01
    first, whole = (np.abs(other - plain)[count].max() for other in (frames, always))
    assert 0 < first < 0.1 * whole  # the way there is eased


def test_a_mute_rests_both_arms_until_it_ends(debug_model, plain):
    arms = bones_of(arm_parts(debug_model.assets.skeleton))
    frames, count = _changed_at(debug_model, 1, lambda stream: setattr(stream, "muted", True))
    resting = frames[count + HALF_SECOND :]
    rest = np.broadcast_to(rest_pose(debug_model.assets.skeleton)[arms], resting[:, arms].shape)
    np.testing.assert_allclose(resting[:, arms], rest, atol=1e-5)
    others = np.setdiff1d(np.arange(42), arms)
    np.testing.assert_array_equal(frames[:, others], plain[:, others])


def test_a_style_takes_effect_with_the_next_frames(debug_model):
    plain = streamed(debug_model, speech(3), style=Style(speaker="ada"))
    stream = debug_model.stream(style=Style(speaker="ada"))
    first = stream.feed(speech(3)[:16000])
    stream.style = Style(speaker="ben")
    assert stream.style.speaker == "ben"
    frames = np.concatenate([first, stream.feed(speech(3)[16000:]), stream.flush()])
    np.testing.assert_array_equal(frames[: len(first)], plain[: len(first)])
    assert np.abs(frames[len(first) + HALF_SECOND :] - plain[len(first) + HALF_SECOND :]).max() > 1e-3


def interrupted(model, cuts=(), frame=None, **options) -> np.ndarray:
    """The frames shown of 3 s of speech, a clear, 2.5 s of silence and 2 s of speech, which are cut at some samples."""
    stream = model.stream(**options)
    spoken, then = speech(3), np.concatenate([np.zeros(40000, np.float32), speech(2, 1)])
    before = np.concatenate([stream.feed(part) for part in np.split(spoken, cuts)])
    shown = before[: stream.clear(frame)]
    return np.concatenate([shown, *(stream.feed(part) for part in np.split(then, cuts)), stream.flush()])


@pytest.mark.parametrize(
    ("frame", "options", "is_trained"),
    [
        (None, {}, True),
        (None, {"look_ahead": 0, "hop": 3}, False),
        (4, {"hop": 4}, False),
        (22, {"look_ahead": 3}, True),
        (0, {"hop": 26}, False),
    ],
)
def test_what_was_cleared_is_forgotten_within_eight_frames(debug_model, trained_model, frame, options, is_trained):
    """The motion is that of a stream without it at the same times, and goes on without a step in pose or speed."""
    model = trained_model if is_trained else debug_model
    options = {"reference": 15.0, "controls": Controls(extent=0.8)} | options
    spoken = streamed(model, speech(5), **options)
    frames = interrupted(model, frame=frame, **options)
    first = frame
    if first is None:  # the next sample has the time that it would have had
        first = len(model.stream(**options).feed(speech(3)))
    silence = np.zeros(48000 if frame is None else first * SAMPLE_RATE // FPS, np.float32)
    expected = streamed(model, np.concatenate([silence, np.zeros(40000, np.float32), speech(2, 1)]), **options)
    assert len(frames) == len(expected)
    np.testing.assert_array_equal(frames[:first], spoken[:first])
    np.testing.assert_allclose(frames[first + 7 :], expected[first + 7 :], atol=1e-5)
    steps = np.linalg.norm(np.diff(frames, axis=0), axis=-1).max(axis=-1)
    usual = np.linalg.norm(np.diff(spoken, axis=0), axis=-1).max()
    away = np.linalg.norm(expected[first : first + 8] - spoken[first : first + 8], axis=-1).max()
    assert steps[max(first - 1, 0) : first + 8].max() < usual + 0.3 * away


@pytest.mark.parametrize("frame", [None, 21])
def test_bytes_after_a_clear_do_not_depend_on_the_cuts(debug_model, frame):
    cuts = np.sort(np.random.default_rng(0).integers(0, 48000, 40))
    expected = interrupted(debug_model, frame=frame)
    assert interrupted(debug_model, cuts, frame).tobytes() == expected.tobytes()


def test_a_clear_goes_back_to_the_controls_of_its_frame(debug_model):
    """The running mean about which energy scales is that of the frames that were shown."""
    stream, other = (debug_model.stream(hop=13, controls=Controls(energy=1.5)) for _ in range(2))
    shown = other.feed(speech(3))
    stream.feed(np.concatenate([speech(3), speech(4, 2, 0.3)]))
    assert stream.clear(len(shown)) == len(shown)
    means = [each._layers.controls.copy()._posture(shown[-1]) for each in (stream, other)]
    np.testing.assert_allclose(*means, atol=1e-6)


def test_a_clear_goes_back_a_minute(debug_model):
    stream = debug_model.stream(hop=26)
    count = len(stream.feed(speech(70)))
    for frame in (count - 901, count + 1, -1, count - 0.5):
        with pytest.raises(UserError, match=f"frame {frame} is not remembered; clear one of {count - 900} to {count}"):
            stream.clear(frame)
    assert stream.clear(count - 900) == count - 900
    with pytest.raises(UserError, match=f"clear one of {count - 900} to {count - 900}"):  # nothing before is known
        stream.clear(count - 901)


def test_arguments_are_checked_and_after_the_end_is_no_more(debug_model):
    with pytest.raises(UserError, match="expected 0 to 34 frames"):
        debug_model.stream(look_ahead=35)
    with pytest.raises(UserError, match="expected a number of at least 0"):
        debug_model.stream(reference="a")
    stream = debug_model.stream()
    with pytest.raises(UserError, match="a gap of a s"):
        stream.skip(cast(Any, "a"))
    with pytest.raises(UserError, match="frame True is not remembered"):
        stream.clear(True)
    stream.flush()
    with pytest.raises(UserError, match="the stream has ended"):
        stream.feed(speech(1))


def test_what_a_stream_cannot_take_leaves_it_as_it_was(debug_model, plain):
    stream = debug_model.stream()
    first = stream.feed(speech(3)[:16000])
    with pytest.raises(UserError, match="expected float mono at 16 kHz"):
        stream.feed(np.zeros((100, 2), np.float32))
    with pytest.raises(UserError, match="the energy is"):
        stream.controls = Controls(energy=-1)
    with pytest.raises(UserError, match="expected one of: ada, ben"):
        stream.style = Style(speaker="eve")
    frames = np.concatenate([first, stream.feed(speech(3)[16000:]), stream.flush()])
    np.testing.assert_array_equal(frames, plain)


def test_broken_weights_are_noticed(debug_model):
    broken = dataclasses.replace(debug_model, variables=jax.tree.map(lambda x: x * np.nan, debug_model.variables))
    with pytest.raises(UserError, match="not finite"):
        broken.stream(look_ahead=0).feed(speech(1))
